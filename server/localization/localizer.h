// SPDX-License-Identifier: Apache-2.0
// Finds the camera in the map, frame by frame.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_LOCALIZER_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_LOCALIZER_H_

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/image/frame.h"
#include "server/localization/fast_localizer_options.h"
#include "server/localization/search/pose_prior.h"
#include "server/localization/window/gyroscope.h"

namespace groundlock::localization {

enum class CameraState {
  kInitializing,  // never localised yet, or not surely
  kTracked,       // the pose is verified in this frame
  kHeld,          // not verified in this frame; the last or predicted pose
  kLost,          // held for longer than LocalizerOptions::lost_after
  // "fast" only: where the map ends, the pose goes on by what else there is to
  // follow; its error grows with the way.
  kOdometry,
};

struct LandmarkMatch {
  std::uint32_t landmark = 0;  // index into Map::landmarks
  Eigen::Vector2d pixel_px;    // where it was seen
};

struct LocalizationRequest {
  const image::Frame* frame = nullptr;
  geometry::CameraModel camera;  // of this frame
  // Boxes of moving things: features on them are left out.
  std::vector<geometry::Box2> masks_px;
  // Where other sensors say the camera was.
  std::optional<PosePrior> prior = std::nullopt;
  // Frames come faster than they are worked on: what can wait does.
  bool hurried = false;
  // What an inertial measurement unit said since the frame before, up to this
  // one; may go beyond either. Of use with LocalizerOptions::imu. "fast" only.
  std::span<const InertialSample> inertial = {};
};

// By which the pictures were taken with another lens than the session's.
struct LensContradiction {
  double focal_ratio = 1.0;  // the focal length seen over the given one
  // What the lens's distortion leaves unexplained in the image's corner, as a
  // share of its distance from the principal point.
  double corner_share = 0.0;
};

// What a frame cost; times are wall clock, the rest is deterministic.
struct LocalizationReport {
  int num_features = 0;
  int num_matches = 0;  // correspondences of the view tried last
  int views_tried = 0;
  int ransac_iterations = 0;
  std::chrono::nanoseconds features_time{0};
  std::chrono::nanoseconds matching_time{0};
  std::chrono::nanoseconds ransac_time{0};
  std::chrono::nanoseconds refinement_time{0};
};

struct LocalizationResult {
  CameraState state = CameraState::kInitializing;
  // Unset before the first success and when lost.
  std::optional<geometry::Rigid3> world_from_camera;
  // Of (dp, dtheta) as rigid3.h says; meaningful when world_from_camera is set.
  geometry::Matrix6d covariance = geometry::Matrix6d::Zero();
  // Raised whenever the pose does not continue from the one before: the first
  // pose, the first after kLost, where a search of the map contradicted the
  // pose that was followed, and where it ended kOdometry.
  std::uint64_t reset_count = 0;
  int num_inliers = 0;  // those of kOdometry are not all in the map
  double mean_reprojection_error_px = 0.0;  // of the inliers
  std::vector<LandmarkMatch> inliers;       // those in the map
  // The images contradict the gyroscope again and again: it is not looked at
  // any more. Its axes or its clock are other than was said.
  bool ignores_gyroscope = false;
  // "fast" only: set once frames agree on it; from then on in each result.
  std::optional<LensContradiction> lens_contradiction;
  LocalizationReport report;
};

struct LocalizerOptions {
  std::uint64_t seed = 0;
  int min_inliers = 100;      // Robinson 2014, §3.4
  double ratio_test = 0.8;    // d1/d2, §3.4
  double max_error_px = 2.0;  // inlier gate, §3.4
  double ransac_confidence = 0.9999;
  int ransac_max_iterations = 1'000;
  int min_landmark_views = 3;  // §3.3
  int max_features = 12'000;   // SIFT features per frame
  double sift_contrast_threshold = 0.02;
  std::chrono::nanoseconds lost_after = std::chrono::seconds(2);
  // "fast" only. True: results do not depend on how fast the machine is; a
  // frame without a pose waits for its anchor, and background anchors are
  // adopted at a fixed frame. False: the frame path never waits.
  bool wait_for_anchor = true;
  // "fast" only. True: a photograph that no frame follows. A pose that another
  // frame would have to confirm is then given as it is.
  bool is_single_frame = false;
  // "fast" only. The frames' inertial samples are of this unit; unset: they are
  // not looked at.
  std::optional<ImuModel> imu = std::nullopt;
  FastLocalizerOptions fast = {};
  absl::Status Validate() const;  // names field, value and bound
};

// kInvalidArgument: no frame, a frame whose size is not the camera's, masks
// that are not finite. For implementations of Localizer.
absl::Status ValidateRequest(const LocalizationRequest& request);

// One per session; not thread-safe. Deterministic: the same frames and options
// give the same results.
class Localizer {
 public:
  virtual ~Localizer() = default;
  // Errors only for requests that cannot be processed (a frame whose size is
  // not the camera's) and for a map that was found to be damaged meanwhile
  // (kDataLoss); a lost camera is a result.
  virtual absl::StatusOr<LocalizationResult> Localize(
      const LocalizationRequest& request) = 0;
  // Forgets the previous pose.
  virtual void Reset() = 0;
  // All that the session knows of its camera, as bytes of a versioned format
  // (state_message.h); the key frame's image and a few others are most of it,
  // some three times the pixels of a frame. An anchor under way is in it as its
  // request, and goes on.
  virtual std::string Save() const;
  // Goes on from there, where Save was called on a localizer of the same name,
  // map and options: results are the same to the bit as if it had never
  // stopped. The bytes may be anybody's: what is not such a state is an error,
  // after which all is as it was. kInvalidArgument names the field;
  // kUnimplemented: of another version; kFailedPrecondition: of another
  // localizer or map. By default there is nothing to know, and no bytes say so.
  virtual absl::Status Restore(std::string_view state);
};

enum class Urgency {
  kNow,    // a frame, or a camera without a pose, waits for it
  kLater,  // gives way to frames
};
using BackgroundRunner =
    std::function<void(Urgency, std::function<void()> task)>;

// `name`: "fast" (frame to frame, fast_localizer.h) or "baseline" (the thesis'
// method, §3.4). kInvalidArgument lists the names; kFailedPrecondition if the
// map has no descriptors.
//   run_in_background  "fast" only: runs work off the frame path, on a thread
//                      that no frame path occupies; empty = run it at once.
absl::StatusOr<std::unique_ptr<Localizer>> CreateLocalizer(
    std::string_view name,
    std::shared_ptr<const map::Map> map,
    const LocalizerOptions& options,
    BackgroundRunner run_in_background = {});
std::vector<std::string> LocalizerNames();

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_LOCALIZER_H_
