// SPDX-License-Identifier: Apache-2.0
// How a target moves in the image where nothing is known of the ground.
#ifndef GROUNDLOCK_SERVER_TRACKING_IMAGE_MOTION_H_
#define GROUNDLOCK_SERVER_TRACKING_IMAGE_MOTION_H_

#include <Eigen/Core>
#include <chrono>
#include <optional>

#include "map_store/geometry/box.h"
#include "server/tracking/background_motion.h"

namespace groundlock::tracking {

// Constant velocity, in the image and against the background, each as well
// known as it has predicted so far; whichever has predicted better says where
// the target will be. Who films keeps the target in the picture, so that some
// move steadily there; most things on the ground move steadily over it. Pixels.
// Not thread-safe.
class ImageMotion {
 public:
  // Starts at rest, uncertain by a quarter of the box's side.
  void Restart(const geometry::Box2& box_px, std::chrono::nanoseconds time);
  // The background moved so since the frame before; nullopt: as is not known.
  void Carry(const std::optional<ImageAffinity>& background);
  // Where it was seen, later than before. `by_looks`: by what it looks like,
  // not by its motion alone.
  void Update(const geometry::Box2& box_px,
              std::chrono::nanoseconds time,
              double trust = 1.0,
              bool by_looks = true);

  struct Prediction {
    Eigen::Vector2d center_px = Eigen::Vector2d::Zero();
    Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Identity();
  };
  Prediction Predict(std::chrono::nanoseconds time) const;
  // Where in the picture it has been of late: whoever films brings it back
  // there.
  Prediction UsualPlace() const;
  // Where what it was last seen before is now; nullopt: not known.
  std::optional<Eigen::Vector2d> LeftBehind_px() const;
  // Has it predicted better than that the target stays where it is in the
  // image?
  bool IsBetterThanRest() const;
  // How it moves over the background.
  Eigen::Vector2d OverBackground_px_s() const {
    return on_background_.velocity_px_s;
  }
  // How what looks like it moves over the background, wherever its motion alone
  // has put it since; and how well either axis of that is known.
  struct Velocity {
    Eigen::Vector2d px_s = Eigen::Vector2d::Zero();
    double sigma_px_s = 0.0;
  };
  Velocity LooksOverBackground() const { return VelocityOf(looks_); }
  // The same if that is seen there now.
  Velocity LooksOverBackground(const Eigen::Vector2d& center_px,
                               std::chrono::nanoseconds time) const;
  double side_px() const { return side_px_; }

 private:
  friend struct StateFields;

  // Constant velocity in one frame of reference.
  struct Model {
    Eigen::Vector2d last_px =
        Eigen::Vector2d::Zero();  // where it was last seen
    Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();
    double innovation_px2 = 1.0;  // mean square of one axis, per step
    int steps = 0;                // that it is the mean of
    double life_s = 0.0;          // of the velocity, unseen
    Prediction Predict(double age_s, double step_s, double side_px) const;
    void Update(const Eigen::Vector2d& center_px,
                double step_s,
                double rate,
                double trust);
  };
  const Model& Better() const;
  Velocity VelocityOf(const Model& model) const;

  Model in_image_, on_background_;
  Model looks_;  // on the background, of looks alone
  bool background_since_look_ = false;
  std::chrono::nanoseconds looked_{0};
  bool background_known_ = false;  // since it was last seen
  // The background's way in the image where the target was, a frame's; the mean
  // square of one axis of how that changes, and what more it has changed since
  // the target was last seen.
  Eigen::Vector2d camera_way_px_ = Eigen::Vector2d::Zero();
  double usual_change_px2_ = 0.0;
  double unusual_change_px2_ = 0.0;
  Eigen::Vector2d usual_px_ = Eigen::Vector2d::Zero();
  double usual_spread_px2_ = 0.0;  // mean square of one axis
  double way_px2_ = 0.0;  // mean square of one axis in the image, per step
  double side_px_ = 1.0;
  double step_s_ = 0.04;  // between sightings
  std::chrono::nanoseconds time_{0};
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_IMAGE_MOTION_H_
