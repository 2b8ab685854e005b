// SPDX-License-Identifier: Apache-2.0
// A tracking session: frames in, results out. The thesis' control logic
// (Robinson 2014, §3.1, §3.7) for any number of targets.
#ifndef GROUNDLOCK_SERVER_TRACKING_TRACKING_SESSION_H_
#define GROUNDLOCK_SERVER_TRACKING_TRACKING_SESSION_H_

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/map/map.h"
#include "server/ground/ground_surface.h"
#include "server/image/frame.h"
#include "server/localization/localizer.h"
#include "server/motion/motion_predictor.h"
#include "server/movers/movers.h"
#include "server/target/target_tracker.h"
#include "server/tracking/body_kind.h"

namespace groundlock::tracking {

enum class TargetState {
  kTracked,    // seen in this frame
  kPredicted,  // hidden, out of view, or not believed: motion model only
  kLost,       // predicted for longer than SessionOptions::target_lost_after
};

struct SessionOptions {
  std::string localizer = "fast";
  localization::LocalizerOptions localization;
  target::TargetTrackerOptions tracker;
  motion::MotionOptions motion;
  // Below it the target counts as not seen (Robinson 2014, §3.7).
  double confidence_threshold = 0.5;
  std::chrono::nanoseconds target_lost_after = std::chrono::seconds(10);
  int max_targets = 16;
  // Places tried beside the predicted one, per target and frame, to find an
  // unseen target again within the prediction's covariance.
  int max_search_places = 4;
  // The same, at most, of a frame that comes late (SetHurried).
  int max_hurried_search_places = 1;
  // From so many sides, evenly spread, a target's looks are remembered where
  // the ground tells from which side it is seen; 0: not at all.
  int max_views = 8;
  // Reasons about what stands between the camera and a target: other targets,
  // and what the map knows. False: for comparison.
  bool reason_about_occlusion = true;
  // Targets are measured, and followed, by points of them.
  bool follow_bodies = true;
  // Reports what else moves by itself over the ground: FrameResult::movers.
  bool report_movers = false;
  std::uint64_t seed = 0;
  absl::Status Validate() const;
};

// Where a frame's time went, wall clock.
struct StageTimes {
  std::chrono::nanoseconds decode{0};
  std::chrono::nanoseconds localize{0};
  std::chrono::nanoseconds track{0};  // all targets, boxes and filters
  std::chrono::nanoseconds movers{0};
  std::chrono::nanoseconds total{0};
};

struct TargetResult {
  std::string id;
  TargetState state = TargetState::kPredicted;
  double confidence = 0.0;  // [0, 1]
  // Seen: the outline of the target's body where, and as large as, it was seen,
  // or the 2D tracker's box without a ground; else the predicted outline, if it
  // projects. Not clipped to the image.
  std::optional<geometry::Box2> box_px;
  // On the ground, if the camera has a pose. world_from_object: x = heading.
  std::optional<geometry::Box3> box_world;
  // Of the centre on the ground, world x and y, m^2.
  Eigen::Matrix2d ground_covariance_m2 = Eigen::Matrix2d::Zero();
  // Standard deviation of the heading, that of any angle while nothing tells
  // it. Where the front is not known, it may as well head the opposite way.
  double heading_sigma_rad = 0.0;
  bool front_known = false;
  // Of box_world's length, width and height.
  Eigen::Matrix3d size_covariance_m2 = Eigen::Matrix3d::Zero();
  Eigen::Vector3d velocity_world_m_s = Eigen::Vector3d::Zero();
  // The name of the kind of body that it is taken for (BodyKinds); empty: none.
  std::string_view body_kind;
  std::chrono::nanoseconds age{0};  // since it was last seen
};

// What other sensors say of a frame.
struct SensorReadings {
  std::optional<localization::PosePrior> prior;  // where the camera was
  // Since the frame before: localization::LocalizationRequest::inertial.
  std::vector<localization::InertialSample> inertial = {};
};

struct FrameResult {
  std::uint64_t sequence = 0;
  std::chrono::nanoseconds capture_time{0};
  localization::LocalizationResult camera;
  std::vector<TargetResult> targets;
  movers::MoversReport movers;
  StageTimes times;
};

// Not thread-safe: the caller runs one frame at a time, in order.
// Without a map (null) there is no camera pose, and targets are tracked in 2D.
class TrackingSession {
 public:
  //   camera             for frames that bring no intrinsics of their own.
  //   run_in_background  see localization::CreateLocalizer.
  static absl::StatusOr<std::unique_ptr<TrackingSession>> Create(
      std::shared_ptr<const map::Map> map,
      const geometry::CameraModel& camera,
      const SessionOptions& options,
      localization::BackgroundRunner run_in_background = {});
  // The same over a given localizer (null: none) and ground, for callers that
  // know the camera by other means; options.localizer is not looked at.
  //   map  what stands before targets; null: not known.
  static absl::StatusOr<std::unique_ptr<TrackingSession>> Create(
      std::unique_ptr<localization::Localizer> localizer,
      std::shared_ptr<const ground::GroundSurface> ground,
      const geometry::CameraModel& camera,
      const SessionOptions& options,
      std::shared_ptr<const map::Map> map = nullptr);
  virtual ~TrackingSession() = default;

  // Marks a target by its box in the frame that is processed next or, if
  // `frame_sequence` is given, in that later one (in the first one processed
  // from there on, should it have been dropped). An existing id is moved there
  // and learnt anew. kInvalidArgument: box not finite or of no size;
  // kResourceExhausted: max_targets reached. A box that lies outside the image
  // of its frame is reported in that frame by ProcessFrame (see there).
  //   body  what is known of it; errors as KindOf. Of use where the camera's
  //         pose and the ground are known.
  virtual absl::Status SetTarget(const std::string& id,
                                 const geometry::Box2& box_px,
                                 std::optional<std::uint64_t> frame_sequence,
                                 const TargetBody& body) = 0;
  // The same of a body of which nothing is known.
  absl::Status SetTarget(const std::string& id,
                         const geometry::Box2& box_px,
                         std::optional<std::uint64_t> frame_sequence) {
    return SetTarget(id, box_px, frame_sequence, TargetBody{});
  }
  // Moves a target without learning anew: where to look in the next frame.
  // kNotFound.
  virtual absl::Status MoveTarget(const std::string& id,
                                  const geometry::Box2& box_px) = 0;
  virtual absl::Status DropTarget(const std::string& id) = 0;
  virtual std::vector<std::string> TargetIds() const = 0;

  // Whether frames wait for this session, which then looks for unseen targets
  // in fewer places and anchors the camera less often. Holds for the frames
  // that follow; false at first.
  virtual void SetHurried(bool hurried) = 0;

  // The same without other sensors.
  absl::StatusOr<FrameResult> ProcessFrame(
      const image::Frame& frame,
      const std::optional<geometry::CameraModel>& camera,
      std::vector<absl::Status>* target_errors) {
    return ProcessFrame(frame, camera, SensorReadings{}, target_errors);
  }
  // kInvalidArgument if the frame's size is not the camera's or, without a
  // localizer, not that of the frames before, or if time runs backwards; the
  // session lives on unchanged. A target whose box cannot be
  // used in this frame appears in `target_errors`, and is dropped.
  //   camera  intrinsics of this frame alone, if given.
  virtual absl::StatusOr<FrameResult> ProcessFrame(
      const image::Frame& frame,
      const std::optional<geometry::CameraModel>& camera,
      const SensorReadings& sensors,
      std::vector<absl::Status>* target_errors) = 0;

  // All that the session knows of its camera, so that it can go on elsewhere:
  // bytes of a versioned format, most of them the localizer's
  // (localization::Localizer::Save). Targets are no part of it (SaveTargets),
  // nor are movers, which are found anew.
  virtual std::string SaveCamera() const;
  // Goes on from there, where SaveCamera was called on a session of the same
  // map, camera and options: the camera's results, and those of targets that
  // are marked from then on, are the same to the bit as if it had never moved,
  // unless it is live. The bytes may be anybody's: what is not such a state is
  // an error, after which all is as it was. kInvalidArgument names the field;
  // kUnimplemented: of another version; kFailedPrecondition: of another
  // localizer or map, or this session has processed a frame. By default there
  // is nothing to know, and no bytes say so.
  virtual absl::Status RestoreCamera(std::string_view state);

  // The same of its targets, of those as well that start in a later frame:
  // bytes of a versioned format, some MB for each. kUnimplemented names the
  // session's tracker, if that keeps to itself what it knows ("act" and "dcf"
  // do not); kResourceExhausted: more than can be taken in again.
  virtual absl::StatusOr<std::string> SaveTargets() const;
  // Goes on from there, after RestoreCamera with what SaveCamera gave at the
  // same time: the targets' results, too, are the same to the bit from then on.
  // The bytes may be anybody's; what is an error leaves all as it was.
  // kInvalidArgument names the field; kUnimplemented: of another version;
  // kFailedPrecondition: of another tracker, or of another frame than the
  // camera, or this session has targets. By default there is nothing to know,
  // and no bytes say so.
  virtual absl::Status RestoreTargets(std::string_view state);
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_TRACKING_SESSION_H_
