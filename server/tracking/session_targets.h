// SPDX-License-Identifier: Apache-2.0
// What a session knows of its targets, as bytes, so that it can go on
// elsewhere: "GLTARGETS", the version of the format (2 bytes), and the fields
// (state_fields.h), images among them (target_state_stream.h).
#ifndef GROUNDLOCK_SERVER_TRACKING_SESSION_TARGETS_H_
#define GROUNDLOCK_SERVER_TRACKING_SESSION_TARGETS_H_

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/ground_surface.h"
#include "server/tracking/body_kind.h"
#include "server/tracking/standing_landmarks.h"
#include "server/tracking/target_track.h"
#include "server/tracking/tracking_session.h"

namespace groundlock::tracking {

// No message is larger: 16 targets with all their pictures of 8-megapixel
// frames come to half of it.
inline constexpr std::size_t kMostTargetBytes = std::size_t{1} << 29;

// A target that starts in a later frame.
struct PendingTarget {
  std::string id;
  geometry::Box2 box_px;
  std::optional<std::uint64_t> frame_sequence;
  std::optional<BodyKind> kind;
};

// What the session itself knows that its targets' next results depend on.
struct SessionTargets {
  // Of the frame that was processed last; unset before the first.
  std::optional<std::chrono::nanoseconds> last_time;
  cv::Size size_px;  // of that frame; empty before the first
  // From where it saw its targets; unset: as is not known.
  struct View {
    geometry::CameraModel camera;
    geometry::Rigid3 world_from_camera;
    geometry::Matrix6d pose_covariance = geometry::Matrix6d::Zero();
    bool verified = false;
    std::uint64_t reset_count = 0;
  };
  std::optional<View> view;
  std::vector<PendingTarget> pending;
};

//   tracks  none is null.
//   standing  null: the map is not asked for what stands.
// kUnimplemented: the session's tracker keeps its state to itself;
// kResourceExhausted: it would be larger than kMostTargetBytes.
absl::StatusOr<std::string> SaveSessionTargets(
    const SessionTargets& session,
    std::span<const std::unique_ptr<TargetTrack>> tracks,
    const StandingLandmarks* standing,
    const SessionOptions& options);

struct RestoredTargets {
  SessionTargets session;
  std::vector<std::unique_ptr<TargetTrack>> tracks;
  std::optional<StandingLandmarks> standing;
};
//   standing  as the session has begun with it; null if it asks no map.
//   options  outlive the tracks.
// kInvalidArgument names the field; kUnimplemented: of another version;
// kFailedPrecondition: of a session with another tracker. Nobody believes the
// bytes.
absl::StatusOr<RestoredTargets> RestoreSessionTargets(
    std::string_view state,
    const SessionOptions& options,
    std::shared_ptr<const ground::GroundSurface> ground,
    const StandingLandmarks* standing);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_SESSION_TARGETS_H_
