// SPDX-License-Identifier: Apache-2.0
// What moves against its background near a target.
#ifndef GROUNDLOCK_SERVER_TRACKING_MOTION_SALIENCY_H_
#define GROUNDLOCK_SERVER_TRACKING_MOTION_SALIENCY_H_

#include <Eigen/Core>
#include <chrono>
#include <deque>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "server/image/frame.h"
#include "server/tracking/background_motion.h"

namespace groundlock::tracking {

// Differences from two earlier pictures, each brought to where the background
// is now: what differs from both is there now and was not before (three-frame
// differencing: Lipton, Fujiyoshi, Patil 1998, "Moving target classification
// and tracking from real-time video"). How a target looks does not matter: it
// is told from a kerb, a palm or a lamp that it passes, which looks tell badly.
// Shares of the box's area that differ say how much of a target moves; they are
// compared with what the same target showed while it was seen. Pixels of the
// whole image, the first one's centre at (0.5, 0.5). Not thread-safe.
class MotionSaliency {
 public:
  // What is marked: whether it moves, later pictures tell.
  void Restart(const image::Frame& frame, const geometry::Box2& box_px);
  // The next frame. `background`: its motion since the last one; nullopt:
  // nothing is known until there are new pictures. `expected_px` and `last_px`:
  // about where ShareAt will be asked of.
  void Add(const image::Frame& frame,
           const std::optional<ImageSimilarity>& background,
           const geometry::Box2& expected_px,
           const geometry::Box2& last_px);

  struct Spot {
    geometry::Box2 box_px;
    double share = 0.0;  // of its area that moves
    Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();  // on background
  };
  // Where what moved in the target's box has gone, followed by nothing but its
  // motion. nullopt: it has stopped, or the target is not known to move.
  std::optional<Spot> spot() const;
  // Which share of the box moves; nullopt: as is not known.
  std::optional<double> ShareAt(const geometry::Box2& box_px) const;
  // The target was found there in the frame last added.
  void Learn(const geometry::Box2& box_px);

 private:
  // A part of a picture, blurred.
  struct Picture {
    cv::Mat luma;
    Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();  // its first corner
    double scale = 1.0;  // its pixels per pixel of the image
    std::chrono::nanoseconds time{0};
    ImageSimilarity to_now;
  };
  // How much each pixel of a part of a picture moves, from 0 to 1.
  struct Saliency {
    cv::Mat_<float> values;
    cv::Mat_<double> sums;  // of all above and left of a corner of pixels
    Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();
    double scale = 1.0;
  };
  static Picture Take(const image::Frame& frame, const geometry::Box2& box_px);
  static std::optional<Saliency> Compare(
      const Picture& at,
      const std::vector<const Picture*>& others,
      const geometry::Box2& around_px);
  static double ShareIn(const Saliency& saliency, const geometry::Box2& box_px);
  // Does more move in the box than about it?
  static bool StandsOut(const Saliency& saliency, const geometry::Box2& box_px);
  // Of what moves in the box, that near its middle most.
  static std::optional<Eigen::Vector2d> MiddleOf(const Saliency& saliency,
                                                 const geometry::Box2& box_px,
                                                 double near_px);
  // Does what was marked move? Told by what has come to where it was.
  void JudgeFirst(const Picture& now);
  // What moves like the target, no farther than `reach_px` from where its box
  // is expected.
  std::optional<Spot> FindNear(const geometry::Box2& expected_px,
                               double reach_px) const;
  void FollowTrace(const geometry::Box2& last_px);
  void Note(double share,
            const std::optional<Eigen::Vector2d>& middle_px,
            const geometry::Box2& box_px,
            double rate);

  struct Trace {
    Spot spot;
    std::chrono::nanoseconds time{0};  // when it was last found
  };

  std::deque<Picture> pictures_;  // the oldest first
  std::optional<Picture> first_;
  geometry::Box2 first_box_px_;
  std::optional<Saliency> now_;
  std::optional<Trace> trace_;
  std::chrono::nanoseconds time_{0};
  std::chrono::nanoseconds learnt_{0};
  // Of the target while it is seen.
  double share_ = 0.0;
  // From the middle of its box to that of what moves, in sides.
  Eigen::Vector2d offset_sides_ = Eigen::Vector2d::Zero();
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_MOTION_SALIENCY_H_
