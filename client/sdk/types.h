// SPDX-License-Identifier: Apache-2.0
// What the service speaks of, as plain structs: no protobuf, no gRPC. Meaning,
// units and frames are those of proto/groundlock/v1.
#ifndef GROUNDLOCK_CLIENT_SDK_TYPES_H_
#define GROUNDLOCK_CLIENT_SDK_TYPES_H_

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "client/sdk/map_types.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::sdk {

// Sessions ------------------------------------------------------------------

enum class FlowMode {
  kLossless,  // the sender is held back
  kLive,      // the oldest waiting frame is dropped and answered so
};

// An inertial measurement unit that is fixed to the camera.
struct ImuModel {
  // Turns the camera's axes into the unit's.
  Eigen::Quaterniond imu_from_camera = Eigen::Quaterniond::Identity();
  // Of the gyroscope; unset: those of a phone's.
  std::optional<double> gyroscope_noise_rad_s_sqrt_hz;
  std::optional<double> gyroscope_walk_rad_s2_sqrt_hz;
  std::optional<double> gyroscope_bias_rad_s;
};

struct SessionOptions {
  std::string localizer;  // empty = the server's default
  std::string tracker;    // empty = the server's default
  FlowMode flow_mode = FlowMode::kLossless;
  std::optional<double> confidence_threshold;
  std::optional<double> target_lost_after_s;
  std::optional<double> camera_lost_after_s = std::nullopt;  // in [0, 86400]
  std::uint64_t seed = 0;
  bool report_matches = false;
  // What moves by itself over the ground: FrameResult::movers.
  bool report_movers = false;
  // That Frame::inertial comes from.
  std::optional<ImuModel> imu = std::nullopt;
};

struct SessionSpec {
  std::string session_id;         // empty = the server makes one up
  std::string map_name;           // empty = no map: targets in 2D only
  std::uint64_t map_version = 0;  // 0 = newest
  // Unset = the map's lens; without a map none is needed.
  std::optional<geometry::CameraModel> camera;
  SessionOptions options;
};

struct SessionInfo {
  SessionSpec spec;  // as the server filled it in
  std::chrono::system_clock::time_point create_time;
  std::uint64_t next_sequence = 0;
  std::uint64_t frames_processed = 0;
  std::uint64_t frames_dropped = 0;
  std::uint64_t frames_failed = 0;
  std::vector<std::string> target_ids;
  bool streaming = false;
  std::string owner;  // who has created it: Caller::name
};

// Who this client is for the server, and what it may do.
struct Caller {
  // The server wants nothing of its callers: everybody may do everything.
  bool open_to_all = false;
  std::string name;    // of the token or certificate, or "jwt:" and a subject
  std::string tenant;  // whose maps and sessions there are; empty = the one
                       // without a name
  std::vector<std::string> scopes;  // "sessions:own", ..., implied ones, too
};

// Frames --------------------------------------------------------------------

enum class ImageEncoding { kAuto, kJpeg, kPng, kRawGray8, kRawBgr8, kRawRgb8 };

struct Image {
  ImageEncoding encoding = ImageEncoding::kAuto;
  std::string bytes;
  int width_px = 0;   // raw encodings only
  int height_px = 0;  // raw encodings only
};

// What other sensors say about where the camera is.
struct PosePrior {
  // Of the camera's centre or, with an arm, of the sensor: in world, or on the
  // Earth if the map has an origin; not both. The standard deviation, per axis,
  // is above 0.
  std::optional<Eigen::Vector3d> position_world;
  std::optional<geometry::GeodeticPosition> geodetic_position;
  double position_sigma_m = 0.0;
  // From the camera's centre to the sensor of the position (the antenna), along
  // the camera's axes: x right, y down, z forward. Goes with a position.
  std::optional<Eigen::Vector3d> position_arm_camera_m = std::nullopt;
  std::optional<Eigen::Quaterniond> rotation;  // world_from_camera
  double rotation_sigma_rad = 0.0;             // about each axis, above 0
};

// What an inertial measurement unit measures, along its own axes.
struct InertialSample {
  std::chrono::nanoseconds time{0};  // of the clock of Frame::capture_time
  Eigen::Vector3d angular_rate_rad_s = Eigen::Vector3d::Zero();
  // Specific force: at rest it points up, with 9.8.
  Eigen::Vector3d acceleration_m_s2 = Eigen::Vector3d::Zero();
};

struct Frame {
  std::uint64_t sequence = 0;  // strictly increasing; gaps are allowed
  std::chrono::nanoseconds capture_time{0};  // monotone clock, >= 0
  Image image;
  // Intrinsics of this frame alone; unset = the session's.
  std::optional<geometry::CameraModel> camera;
  std::optional<PosePrior> prior;
  // Since the frame before, up to capture_time or a little beyond; times
  // ascend. Of use with SessionOptions::imu.
  std::vector<InertialSample> inertial = {};
};

enum class CameraState { kInitializing, kTracked, kHeld, kLost, kOdometry };
enum class TargetState { kTracked, kPredicted, kLost };

// By which the frames were taken with another lens than the session's.
struct LensContradiction {
  double focal_ratio = 1.0;  // the focal length seen over the given one
  // How much farther out than the lens says the image's corner is, as a share
  // of its distance from the principal point.
  double corner_share = 0.0;
};

struct CameraResult {
  CameraState state = CameraState::kInitializing;
  std::optional<geometry::Rigid3> world_from_camera;
  // Of (dp, dtheta) in world, m and rad; set with the pose.
  std::optional<geometry::Matrix6d> covariance;
  // Raised whenever the pose does not continue from the one before.
  std::uint64_t reset_count = 0;
  // The images contradict the gyroscope, which is not looked at any more.
  bool ignores_gyroscope = false;
  // Set once frames agree on it, and in each result from then on.
  std::optional<LensContradiction> lens_contradiction;
  int num_inliers = 0;
  double mean_reprojection_error_px = 0.0;
  // If SessionOptions::report_matches; they run in parallel.
  std::vector<Eigen::Vector2f> match_xy_px;
  std::vector<Eigen::Vector3f> match_xyz_world;
};

// What is known of a target's body.
struct TargetBody {
  std::string kind;  // one of BodyKinds(); empty = not known
  // Length, width and height, in metres or map units; unset = as its kind is.
  std::optional<Eigen::Vector3d> size_m = std::nullopt;
};
// "car", "van", …
const std::vector<std::string>& BodyKinds();

struct TargetResult {
  std::string id;
  TargetState state = TargetState::kPredicted;
  double confidence = 0.0;
  std::optional<geometry::Box2> box_px;
  std::optional<geometry::Box3> box_world;
  std::optional<Eigen::Vector3d> ground_center_world;
  double heading_rad = 0.0;
  std::optional<Eigen::Matrix2d> ground_covariance_m2;
  Eigen::Vector3d velocity_world_m_s = Eigen::Vector3d::Zero();
  double age_s = 0.0;
  // Standard deviation of heading_rad; pi / sqrt(3) while nothing tells it.
  double heading_sigma_rad = 0.0;
  // False: it may as well head the opposite way.
  bool front_known = false;
  // Of box_world's length, width and height.
  std::optional<Eigen::Matrix3d> size_covariance_m2;
  // What it is taken for: one of BodyKinds(); empty: none.
  std::string body_kind;
};

struct TargetError {
  std::string id;
  std::string message;
};

// Whether movers are looked for in a frame and, if not, why.
enum class MoversState {
  kNotAsked,          // SessionOptions::report_movers is off
  kWatching,          // movers are all that were found
  kStarting,          // too few frames so far
  kNoMap,             // the session has none
  kNoGround,          // the map does not know it, or the camera is below it
  kNoPose,            // the camera is neither kTracked nor kOdometry
  kPoseContradicted,  // by so much of the picture that the pose is doubted
};

// What moves by itself over the ground: a suggestion for SetTarget.
struct Mover {
  std::uint64_t id = 0;  // stays with it from frame to frame
  geometry::Box2 box_px;
  Eigen::Vector3d ground_center_world = Eigen::Vector3d::Zero();
  // In world x and y.
  Eigen::Matrix2d ground_covariance_m2 = Eigen::Matrix2d::Zero();
  Eigen::Vector3d velocity_world_m_s = Eigen::Vector3d::Zero();
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Zero();
  double confidence = 0.0;  // the probability that it exists
};

struct StageTimes {  // wall clock, milliseconds
  double queue_ms = 0.0;
  double decode_ms = 0.0;
  double localize_ms = 0.0;
  double track_ms = 0.0;
  double total_ms = 0.0;
  double movers_ms = 0.0;
};

struct FrameResult {
  std::uint64_t sequence = 0;
  std::chrono::nanoseconds capture_time{0};
  CameraResult camera;
  std::vector<TargetResult> targets;
  std::uint64_t map_version = 0;
  StageTimes times;
  std::vector<TargetError> target_errors;
  // The surest first; empty unless kWatching.
  std::vector<Mover> movers = {};
  MoversState movers_state = MoversState::kNotAsked;
};

// A frame that could not be processed, and why; the session lives on.
struct FrameError {
  std::uint64_t sequence = 0;
  absl::Status status;
};

struct FrameDropped {
  enum class Reason { kUnknown, kOverload, kShutdown };
  std::uint64_t sequence = 0;
  Reason reason = Reason::kUnknown;
};

// The one answer to a frame.
using FrameReply = std::variant<FrameResult, FrameError, FrameDropped>;

inline std::uint64_t SequenceOf(const FrameReply& reply) {
  return std::visit([](const auto& r) { return r.sequence; }, reply);
}

struct LocalizeSpec {
  std::string map_name;
  std::uint64_t map_version = 0;                // 0 = newest
  std::optional<geometry::CameraModel> camera;  // unset = the map's lens
  Image image;
  std::string localizer;  // empty = the server's default
  std::uint64_t seed = 0;
  std::optional<PosePrior> prior;
};

struct LocalizeReport {
  CameraResult camera;  // state kTracked or kLost
  std::uint64_t map_version = 0;
  StageTimes times;
};

struct WatchUpdate {
  FrameResult result;
  std::optional<Image> image;
  std::uint64_t skipped = 0;  // results left out since the last update
};

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_TYPES_H_
