// SPDX-License-Identifier: Apache-2.0
// Points of a target at rest: corners within its outline, followed from frame
// to frame and triangulated from the camera's poses.
#ifndef GROUNDLOCK_SERVER_TRACKING_BODY_FOLLOWER_H_
#define GROUNDLOCK_SERVER_TRACKING_BODY_FOLLOWER_H_

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/body_fit.h"
#include "server/image/frame.h"
#include "server/image/luma_pyramid.h"
#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

// A point whose pixels no place at rest explains is none of a body at rest, and
// is forgotten: of a target that moves there are hardly any. Not thread-safe.
class BodyFollower {
 public:
  // Follows the points into a frame, in which the target is expected at
  // `outline_px`.
  void Follow(const image::Frame& frame,
              const CameraView& camera,
              const geometry::Box2& outline_px);
  // Are the body's points seen where they are if it rests? Then it does, and is
  // seen, whatever it looks like by now.
  bool IsSeenAtRest(const geometry::Box3& body_world) const;
  // The target is seen in that frame, whole: looks for further points of it.
  //   outline_px  there.
  //   center_world  about the middle of the target.
  void Observe(const image::Frame& frame,
               const CameraView& camera,
               const geometry::Box2& outline_px,
               const Eigen::Vector3d& center_world);
  // The target is not seen, or not as a whole: what was followed ends, what was
  // triangulated stays.
  void Lose();
  // Has the target been seen from enough other sides, or from so much nearer,
  // that the points tell more than when this was last asked and true?
  bool HasNews();
  ground::BodyPoints Points() const;

 private:
  struct Observation {
    std::size_t view = 0;
    Eigen::Vector2d pixel_px;
  };
  struct Point {
    Eigen::Vector2d pixel_px;  // in the last frame
    bool followed = true;
    bool is_known = false;
    // Whether it went as it would at rest, into the last frame; nullopt: it was
    // not followed there, or its place is not known.
    std::optional<bool> at_rest;
    std::vector<Observation> observations;
    std::optional<ground::BodyPoint> place;
  };
  struct View {
    geometry::CameraModel camera;
    geometry::Rigid3 camera_from_world;
  };

  void TakeView(const CameraView& camera, const Eigen::Vector3d& center_world);
  // Points that are neither followed nor triangulated.
  void EraseUnknown();
  // How far a point at rest goes in the image; nullopt if it is not in both.
  static std::optional<Eigen::Vector2d> MotionAtRest_px(
      const View& before, const View& now, const Eigen::Vector3d& p_world);
  // False: no place at rest explains what was observed.
  bool Triangulate(Point& point) const;
  void FindCorners(const image::Frame& frame,
                   const CameraView& camera,
                   const geometry::Box2& outline_px);

  std::shared_ptr<const image::LumaPyramid> last_pyramid_;
  std::optional<View> last_view_;
  geometry::Box2 last_outline_px_;
  std::vector<View> views_;
  std::vector<Point> points_;
  // From the target to the camera, where views were last taken and news told.
  std::optional<Eigen::Vector3d> viewed_from_m_;
  std::optional<Eigen::Vector3d> told_from_m_;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_BODY_FOLLOWER_H_
