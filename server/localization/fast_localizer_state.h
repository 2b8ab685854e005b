// SPDX-License-Identifier: Apache-2.0
// All that a session on "fast" knows of its camera, as plain data: what is not
// in here the next result does not depend on.
//
// Where the camera is, as the frame before left it (Whereabouts), decides what
// the next frame tries, in this order, until something says where the camera is
// (FastLocalizer::Localize):
//
//   Unknown    an anchor anywhere in the map
//   Following  near where it is expected; far from there; far, by how image
//              corners say it turned; an anchor; odometry
//   Odometry   near; odometry; far; far, by the turn; an anchor
//   Coasting   as where it came from
//
// A pose that little agrees with is followed as well, and kept to itself until
// another anchor confirms it (is_tentative); frames are INITIALIZING, HELD or
// LOST until then.
//
// An anchor is sought in the frame itself in lossless sessions, in the
// background in live ones. What verifies the pose makes it Following or, if
// that was odometry, Odometry; a frame without makes it Coasting, and Unknown
// once that has lasted for LocalizerOptions::lost_after.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_STATE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_STATE_H_

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/image/luma_pyramid.h"
#include "server/localization/camera_state.h"
#include "server/localization/follow/exposure_estimate.h"
#include "server/localization/follow/frame_bridge.h"
#include "server/localization/follow/key_frame_follower.h"
#include "server/localization/follow/session_landmarks.h"
#include "server/localization/localizer.h"
#include "server/localization/search/anchor_job.h"
#include "server/localization/search/lens_check.h"
#include "server/localization/window/gyroscope.h"
#include "server/localization/window/pose_filter.h"

namespace groundlock::localization {

// An anchor that was asked for and has not been adopted: its request, which
// gives the same anchor whenever and wherever it is sought, and what was known
// in its frame.
struct PendingAnchor {
  AnchorTask task;
  std::uint64_t frame_index = 0;
  std::chrono::nanoseconds capture_time{0};
  std::shared_ptr<const image::LumaPyramid> pyramid;
  bool is_search = false;          // else it keeps a pose fresh
  std::vector<LandmarkMatch> own;  // the session's own landmarks in it
  // Of the camera, as (dp, dtheta) per second.
  geometry::Vector6d velocity_s = geometry::Vector6d::Zero();
};

// The camera was never found, or is lost.
struct Unknown {};
// The frame before was verified by the map.
struct Following {};
// The frame before was verified where the map ends, by landmarks of the
// session's own.
struct Odometry {
  Eigen::Vector3d left_map_at = Eigen::Vector3d::Zero();  // in world
};
// The frame before was not: the motion alone says where the camera is.
struct Coasting {
  std::optional<Eigen::Vector3d> left_map_at;  // if it came from odometry
};
using Whereabouts = std::variant<Unknown, Following, Odometry, Coasting>;

struct FastLocalizerState {
  FastLocalizerState(const map::Map& map, const LocalizerOptions& options);

  bool HasPose() const { return !std::holds_alternative<Unknown>(where); }
  bool WasVerified() const {
    return std::holds_alternative<Following>(where) ||
           std::holds_alternative<Odometry>(where);
  }
  // Unset while the map is followed.
  std::optional<Eigen::Vector3d> LeftMapAt() const;
  // What is followed from now on is the map.
  void ReturnToMap();

  CameraStateMachine camera_state;
  Whereabouts where;
  // What is followed goes back to one frame whose pose little agreed with
  // (kFalseAlarmsOfSure), and no other has confirmed it: nobody is told.
  bool is_tentative = false;
  // Anchors in a row that contradict what is known, and are not sure either.
  int contradictions = 0;
  PoseFilter filter;  // meaningful unless `where` is Unknown

  SessionLandmarks own;       // as seen from key_frame.world_from_camera
  ExposureEstimate exposure;  // of whatever camera sends the frames
  KeyFrame key_frame;
  int frames_since_key_frame = 0;
  int key_frames_since_anchor = 0;
  // When it was made, or the most that odometry has followed from it.
  std::size_t key_frame_landmarks = 0;

  std::uint64_t frame_index = 0;
  std::optional<PendingAnchor> pending;
  std::chrono::nanoseconds last_anchor_time{0};
  std::uint64_t last_anchor_frame = 0;
  std::vector<std::uint32_t> last_anchor_landmarks;  // sorted
  int failed_searches = 0;                           // in a row
  int failed_refreshes = 0;
  // Since the pending anchor's frame, while none is verified.
  std::optional<FrameBridge> bridge;

  LensCheck lens_check;
  std::optional<Gyroscope> gyroscope;  // unset: there is none
  // Frames in which the camera was found without the gyroscope only, less those
  // of a turn in which it was found with it.
  int gyroscope_contradictions = 0;
  // Of the frame before; unset: there was none.
  std::optional<std::chrono::nanoseconds> last_time;
  std::shared_ptr<const image::LumaPyramid> last_pyramid;
  // How the camera turned to it, as far as that was asked.
  Eigen::Quaterniond last_turn = Eigen::Quaterniond::Identity();
};

// What an anchor's request takes from the session's options.
AnchorOptions AnchorOptionsFor(const LocalizerOptions& options);

// As Localizer::Save and Restore; LoadState gives a state that a session may go
// on with, or an error.
std::string SaveState(const FastLocalizerState& state, const map::Map& map);
absl::StatusOr<FastLocalizerState> LoadState(std::string_view bytes,
                                             const map::Map& map,
                                             const LocalizerOptions& options);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FAST_LOCALIZER_STATE_H_
