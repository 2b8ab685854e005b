// SPDX-License-Identifier: Apache-2.0
#include "server/localization/fast_localizer_state.h"

#include <algorithm>
#include <limits>
#include <span>
#include <utility>

#include "map_store/base/status.h"
#include "server/localization/state_fields.h"
#include "server/localization/state_message.h"

namespace groundlock::localization {
namespace {

// The acceleration of a camera whose map has no scale, relative to the spread
// of the map's cameras.
constexpr double kAccelerationOverSpread_s2 = 0.3;
PoseFilterOptions MotionOptionsFor(const map::Map& map,
                                   const LocalizerOptions& localizer) {
  PoseFilterOptions options;
  options.imu = localizer.imu;
  if (map.info().metric || map.num_views() == 0) return options;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < map.num_views(); ++i) {
    mean += map.view(i).center_world;
  }
  mean /= static_cast<double>(map.num_views());
  double spread = 0.0;
  for (std::size_t i = 0; i < map.num_views(); ++i) {
    spread += (map.view(i).center_world - mean).norm();
  }
  spread /= static_cast<double>(map.num_views());
  options.acceleration_s2 = std::max(1e-9, kAccelerationOverSpread_s2 * spread);
  options.initial_velocity_s = options.acceleration_s2;
  return options;
}

constexpr std::string_view kName = "fast";

// Of what is named for more than its place in a list.
bool AreIn(std::span<const LandmarkMatch> matches,
           const std::shared_ptr<const image::LumaPyramid>& pyramid) {
  return std::all_of(
      matches.begin(), matches.end(), [&](const LandmarkMatch& match) {
        return pyramid != nullptr &&
               match.pixel_px.x() < pyramid->size_px.width &&
               match.pixel_px.y() < pyramid->size_px.height;
      });
}

bool AreOwn(std::span<const LandmarkMatch> matches,
            const SessionLandmarks& own) {
  return std::all_of(
      matches.begin(), matches.end(), [&](const LandmarkMatch& match) {
        return own.Owns(match.landmark);
      });
}

// What the fields of a state must be together.
template <typename Stream>
void CheckState(const FastLocalizerState& state, Stream& stream) {
  const KeyFrame& key_frame = state.key_frame;
  stream.Enter("key_frame");
  if (state.HasPose() && key_frame.pyramid == nullptr) {
    stream.Fail("is missing");
  }
  const std::vector<LandmarkMatch> followed = MatchesOf(key_frame.landmarks);
  if (std::any_of(
          followed.begin(), followed.end(), [&](const LandmarkMatch& match) {
            return state.own.Owns(match.landmark);
          })) {
    stream.Fail("has landmarks that the map has not");
  }
  if (!AreOwn(key_frame.own, state.own) ||
      !AreOwn(key_frame.own_seen, state.own)) {
    stream.Fail("has landmarks of the map for the session's own");
  }
  if (!AreIn(followed, key_frame.pyramid) ||
      !AreIn(key_frame.own, key_frame.pyramid)) {
    stream.Fail("has landmarks outside its image");
  }
  stream.Enter("pending");
  if (!state.pending) return;
  const PendingAnchor& pending = *state.pending;
  if (pending.pyramid == nullptr || pending.frame_index > state.frame_index ||
      pending.task.request.camera.width_px() !=
          pending.pyramid->size_px.width ||
      pending.task.request.camera.height_px() !=
          pending.pyramid->size_px.height) {
    stream.Fail("is of no frame of its camera");
  } else if (!AreOwn(pending.own, state.own) ||
             !AreIn(pending.own, pending.pyramid)) {
    stream.Fail("has landmarks that are not the session's own");
  }
}

// Counts of frames or of what was in vain.
template <typename Stream, typename T>
void Count(Stream& stream, std::string_view field, T& count) {
  Field(stream, field, count);
  if (count < 0 || count > std::numeric_limits<int>::max() / 2) {
    stream.Fail("is no count");
  }
}

}  // namespace

template <typename Stream, base::StateOf<Whereabouts> T>
void StateValue(Stream& stream, T& where) {
  auto kind = static_cast<std::uint8_t>(where.index());
  Field(stream, "where", kind);
  if constexpr (Stream::kReads) {
    switch (kind) {
      case 0:
        where = Unknown();
        break;
      case 1:
        where = Following();
        break;
      case 2:
        where = Odometry();
        break;
      case 3:
        where = Coasting();
        break;
      default:
        stream.Fail("is none");
    }
  }
  if (auto* odometry = std::get_if<Odometry>(&where)) {
    StateValue(stream, odometry->left_map_at);
  } else if (auto* coasting = std::get_if<Coasting>(&where)) {
    StateValue(stream, coasting->left_map_at);
  }
}

// What does not follow from the session's options. The image is the pending
// anchor's.
template <typename Stream, base::StateOf<AnchorTask> T>
void StateValue(Stream& stream, T& task) {
  Field(stream, "pending.camera", task.request.camera);
  List(stream, "pending.masks_px", task.request.masks_px, kMostListed);
  Field(stream, "pending.predicted", task.request.prior_world_from_camera);
  Field(stream, "pending.prior", task.request.prior);
  Field(stream, "pending.seed", task.request.seed);
  Field(stream, "pending.wants_lens", task.request.wants_lens_matches);
  Field(stream, "pending.is_photograph", task.options.is_photograph);
  Field(stream, "pending.search_anywhere", task.options.search_anywhere);
  Field(stream, "pending.probe_focal_ratio", task.probe_focal_ratio);
}

template <typename Stream, base::StateOf<PendingAnchor> T>
void StateValue(Stream& stream, T& pending) {
  StateValue(stream, pending.task);
  Field(stream, "pending.frame_index", pending.frame_index);
  Field(stream, "pending.capture_time", pending.capture_time);
  Field(stream, "pending.image", pending.pyramid);
  Field(stream, "pending.is_search", pending.is_search);
  List(stream, "pending.own", pending.own, kMostListed);
  Field(stream, "pending.velocity_s", pending.velocity_s);
  if constexpr (Stream::kReads) {
    if (pending.pyramid != nullptr) {
      pending.task.request.luma = pending.pyramid->levels.front();
    }
  }
}

template <typename Stream, base::StateOf<FastLocalizerState> T>
void StateValue(Stream& stream, T& state) {
  StateValue(stream, state.camera_state);
  StateValue(stream, state.filter);
  StateValue(stream, state.where);
  Field(stream, "is_tentative", state.is_tentative);
  Count(stream, "contradictions", state.contradictions);
  StateValue(stream, state.own);
  StateValue(stream, state.exposure);
  StateValue(stream, state.key_frame);
  Count(stream, "frames_since_key_frame", state.frames_since_key_frame);
  Count(stream, "key_frames_since_anchor", state.key_frames_since_anchor);
  Field(stream, "key_frame_landmarks", state.key_frame_landmarks);
  if (state.key_frame_landmarks > kMostListed) stream.Fail("is no count");
  Field(stream, "frame_index", state.frame_index);
  if (state.frame_index > kMostCounted) stream.Fail("is no count");
  Field(stream, "pending", state.pending);
  Field(stream, "last_anchor_time", state.last_anchor_time);
  Field(stream, "last_anchor_frame", state.last_anchor_frame);
  if (state.last_anchor_frame > state.frame_index) stream.Fail("is to come");
  List(stream,
       "last_anchor_landmarks",
       state.last_anchor_landmarks,
       kMostListed);
  Count(stream, "failed_searches", state.failed_searches);
  Count(stream, "failed_refreshes", state.failed_refreshes);
  Field(stream, "bridge", state.bridge);
  StateValue(stream, state.lens_check);
  bool has_gyroscope = state.gyroscope.has_value();
  Field(stream, "gyroscope", has_gyroscope);
  if constexpr (Stream::kReads) {
    if (has_gyroscope && !state.gyroscope) stream.Fail("was not announced");
    if (!has_gyroscope) state.gyroscope.reset();
  }
  if (state.gyroscope) StateValue(stream, *state.gyroscope);
  Count(stream, "gyroscope_contradictions", state.gyroscope_contradictions);
  Field(stream, "last_time", state.last_time);
  Field(stream, "last_image", state.last_pyramid);
  Field(stream, "last_turn", state.last_turn);
  CheckState(state, stream);
}

FastLocalizerState::FastLocalizerState(const map::Map& map,
                                       const LocalizerOptions& options)
    : camera_state(options.lost_after, HoldModel()),
      filter(MotionOptionsFor(map, options)),
      own(static_cast<std::uint32_t>(map.landmarks().size())) {
  if (options.imu) gyroscope.emplace(*options.imu);
}

std::optional<Eigen::Vector3d> FastLocalizerState::LeftMapAt() const {
  if (const auto* odometry = std::get_if<Odometry>(&where)) {
    return odometry->left_map_at;
  }
  const auto* coasting = std::get_if<Coasting>(&where);
  return coasting != nullptr ? coasting->left_map_at : std::nullopt;
}

void FastLocalizerState::ReturnToMap() {
  if (std::holds_alternative<Odometry>(where)) where = Following();
  if (std::holds_alternative<Coasting>(where)) where = Coasting();
}

AnchorOptions AnchorOptionsFor(const LocalizerOptions& options) {
  AnchorOptions anchor;
  anchor.min_landmark_views = options.min_landmark_views;
  anchor.sift_contrast_threshold = options.sift_contrast_threshold;
  anchor.max_features = std::min(anchor.max_features, options.max_features);
  return anchor;
}

std::string SaveState(const FastLocalizerState& state, const map::Map& map) {
  StateMessageWriter writer;
  StateValue(writer, state);
  return writer.Message(kName, map);
}

absl::StatusOr<FastLocalizerState> LoadState(std::string_view bytes,
                                             const map::Map& map,
                                             const LocalizerOptions& options) {
  StateMessageReader reader(bytes);
  RETURN_IF_ERROR(reader.Open(kName, map));
  FastLocalizerState state(map, options);
  StateValue(reader, state);
  RETURN_IF_ERROR(reader.Close());
  if (state.pending) {
    AnchorOptions anchor = AnchorOptionsFor(options);
    anchor.is_photograph = state.pending->task.options.is_photograph;
    anchor.search_anywhere = state.pending->task.options.search_anywhere;
    state.pending->task.options = anchor;
  }
  return state;
}

}  // namespace groundlock::localization
