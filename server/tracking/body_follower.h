// SPDX-License-Identifier: Apache-2.0
// Points of a target: corners within its outline, followed from frame to frame.
// As long as the target may be at rest they are triangulated from the camera's
// poses; of one that moves they are tracks, for ground::SolveBodyMotion.
#ifndef GROUNDLOCK_SERVER_TRACKING_BODY_FOLLOWER_H_
#define GROUNDLOCK_SERVER_TRACKING_BODY_FOLLOWER_H_

#include <Eigen/Core>
#include <chrono>
#include <cstddef>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/body_fit.h"
#include "server/ground/body_motion.h"
#include "server/ground/body_pose.h"
#include "server/image/frame.h"
#include "server/image/luma_pyramid.h"
#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

// What is known of a target's body in a frame.
struct BodyState {
  geometry::Box3 box_world;
  // It rests: points told its body, and it has not moved since.
  bool rests = false;
  bool moves = false;  // it has moved since it was marked
  // Its heading is that of its motion.
  bool heading_known = false;
  // The ground where it stands, as one knew it beforehand, and how well: the
  // sigmas of its height and of its tilt about each axis, 0 if it is known.
  geometry::Plane ground_world = {};
  Eigen::Vector3d ground_sigmas = Eigen::Vector3d::Zero();
};

// Where a body is expected in a frame, on the ground, and where it would have
// been in the frame before.
struct ExpectedMotion {
  geometry::Rigid3 world_from_body;
  geometry::Rigid3 world_from_body_before;
};

// Not thread-safe.
class BodyFollower {
 public:
  // Follows the points into a frame, in which the target is expected at
  // `outline_px`.
  void Follow(const image::Frame& frame,
              const CameraView& camera,
              const geometry::Box2& outline_px,
              const ExpectedMotion& motion);
  // Are the body's points seen where they are if it rests? Then it does, and is
  // seen, whatever it looks like by now.
  bool IsSeenAtRest(const geometry::Box3& body_world) const;
  // The target is seen in that frame, whole: looks for further points of it.
  // True if what is seen is kept as a view: it has turned or come nearer.
  //   outline_px  there, as far as it is known; `silhouette`, as it was
  //     measured.
  bool Observe(const image::Frame& frame,
               const CameraView& camera,
               const geometry::Box2& outline_px,
               const std::optional<ground::SeenOutline>& silhouette,
               const BodyState& body);
  // The body's outline in the frame last observed, as it is known by now.
  void SetOutline(const geometry::Box2& outline_px) {
    last_outline_px_ = outline_px;
  }
  // When points of it last stayed behind, on what hides it; nullopt: never.
  std::optional<std::chrono::nanoseconds> last_hidden() const {
    return last_hidden_;
  }
  // The target is not seen, or not as a whole: what was followed ends, what was
  // triangulated stays.
  void Lose();
  // Nothing is followed any more: what would be seen from now on hangs not
  // together with how the target was drawn.
  void End();
  // Has the target been seen from enough other sides, or from so much nearer,
  // that the points tell more than when this was last asked and true? Of a body
  // in motion of which few points are known each view does.
  bool HasNews();
  // Of a target at rest: a point whose pixels no place at rest explains is none
  // of them.
  ground::BodyPoints Points() const;
  // Of one that moves: not more views than a fit needs, the first one and the
  // last one among them, and what was followed through them.
  struct Tracks {
    std::vector<ground::BodyView> views;
    std::vector<ground::BodyTrack> tracks;
    std::vector<std::size_t> view_numbers;  // for Refine
    std::vector<std::size_t> point_numbers;
    // Where each was known to be on the body.
    std::vector<std::optional<Eigen::Vector3d>> known_body;
  };
  Tracks TracksOfMotion() const;
  // Takes the poses and points of the body that were found, and forgets what
  // did not go with it.
  struct Found {
    std::vector<geometry::Rigid3> world_from_body;  // in each view
    std::vector<std::size_t> tracks;                // those of the body
    std::vector<Eigen::Vector3d> points_body;       // of each
  };
  void Refine(const Tracks& tracks, const Found& found);
  // The body's frame is another one: what is known of its points is at other
  // places there, and the body at others in the views in which these are.
  void ShiftPoints(const Eigen::Vector3d& by_m);
  // Its known points, as seen in the frame last followed into.
  std::vector<ground::BodySighting> SightingsInMotion() const;
  // Follows no further those of the last SightingsInMotion that are not where
  // the body has them: they went over to what hides it.
  void KeepAgreeing(const std::vector<bool>& agrees);

 private:
  friend struct StateFields;

  // Of a point that is where it would be at rest.
  static constexpr double kMaxRestError_px = 1.2;
  // Fewer tell nothing of a point.
  static constexpr std::size_t kMinObservations = 4;
  using Observation = ground::BodyTrack::Observation;
  struct Point {
    Eigen::Vector2d pixel_px;  // in the last frame
    bool followed = true;
    bool is_known = false;
    bool moves = false;  // no place at rest explains its pixels
    std::optional<Eigen::Vector3d> p_body;  // of a body that moves
    // How far it should have gone with the body, and went, beyond what rests
    // there, since that was last looked at.
    Eigen::Vector2d expected_way_px = Eigen::Vector2d::Zero();
    Eigen::Vector2d way_px = Eigen::Vector2d::Zero();
    // Whether it went as it would at rest, into the last frame; nullopt: it was
    // not followed there, or its place is not known.
    std::optional<bool> at_rest;
    std::vector<Observation> observations;
    std::optional<ground::BodyPoint> place;
    cv::Mat look;  // of one that moves, in the last view; empty: in none
  };
  struct View {
    geometry::CameraModel camera;
    geometry::Rigid3 camera_from_world;
    geometry::Rigid3 world_from_body = {};
    double side_m = 1.0;
    bool heading_known = false;
    geometry::Plane ground_world = {};
    Eigen::Vector3d ground_sigmas = Eigen::Vector3d::Zero();
    std::optional<ground::SeenOutline> silhouette = std::nullopt;
  };

  void TakeView(const CameraView& camera,
                const std::optional<ground::SeenOutline>& silhouette,
                const BodyState& body);
  void TriangulatePoints(const geometry::Plane& ground_world,
                         const BodyState& body);
  // Ends points that no longer look as they did in the last view: what came
  // before them carried them away.
  void EndCarriedAway(const image::Frame& frame);
  // Points that are neither followed nor triangulated.
  void EraseUnknown();
  // Are few known points of a body in motion still followed?
  bool KnowsFew() const;
  // It has moved: its points are no longer where they were.
  void BeginMoving();
  // How far a point at rest goes in the image; nullopt if it is not in both.
  static std::optional<Eigen::Vector2d> MotionAtRest_px(
      const View& before, const View& now, const Eigen::Vector3d& p_world);
  // Does a known point of a body that moves stay behind, on what hides it?
  bool StaysBehind(Point& point,
                   const View& now,
                   const Eigen::Vector2d& before_px,
                   const ExpectedMotion& motion) const;
  // False: no place at rest explains what was observed.
  bool Triangulate(Point& point) const;
  void FindCorners(const image::Frame& frame,
                   const CameraView& camera,
                   const geometry::Box2& outline_px);

  std::shared_ptr<const image::LumaPyramid> last_pyramid_;
  std::optional<View> last_view_;
  geometry::Box2 last_outline_px_;
  std::optional<std::chrono::nanoseconds> last_hidden_;
  std::vector<View> views_;
  std::vector<Point> points_;
  bool moves_ = false;
  bool is_over_ = false;  // it moved and was lost: what would be followed from
                          // then on hangs not together with how it was drawn
  // From the target to the camera, where views were last taken and news told;
  // of a target that moves in its own axes, for it turns as well.
  std::optional<Eigen::Vector3d> viewed_from_m_;
  std::optional<Eigen::Vector3d> told_from_m_;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_BODY_FOLLOWER_H_
