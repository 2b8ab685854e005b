// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/session_targets.h"

#include <algorithm>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "server/tracking/state_fields.h"

namespace groundlock::tracking {
namespace {

constexpr std::string_view kTargetsMagic = "GLTARGETS";
constexpr std::uint16_t kTargetsVersion = 2;

}  // namespace

template <typename Stream, typename T>
requires base::StateOf<T, SessionTargets::View>
void StateValue(Stream& stream, T& view) {
  StateValue(stream, view.camera);
  StateValue(stream, view.world_from_camera);
  Covariance(stream, "view.covariance", view.pose_covariance);
  StateValue(stream, view.verified);
  StateValue(stream, view.reset_count);
}

template <typename Stream, base::StateOf<PendingTarget> T>
void StateValue(Stream& stream, T& pending) {
  StateValue(stream, pending.id);
  BoxField(stream, "pending.box", pending.box_px);
  StateValue(stream, pending.frame_sequence);
  StateValue(stream, pending.kind);
}

template <typename Stream, base::StateOf<SessionTargets> T>
void StateValue(Stream& stream, T& session) {
  Field(stream, "last_time", session.last_time);
  if constexpr (Stream::kReads) {
    stream.set_last_time(
        session.last_time.value_or(std::chrono::nanoseconds(0)));
  }
  Bounded(stream, "width", session.size_px.width, 0, 65'535);
  Bounded(stream, "height", session.size_px.height, 0, 65'535);
  Field(stream, "view", session.view);
  // Ids of targets that start anew in a later frame are tracks' as well.
  List(stream, "pending", session.pending, kMostOthers);
}

absl::StatusOr<std::string> SaveSessionTargets(
    const SessionTargets& session,
    std::span<const std::unique_ptr<TargetTrack>> tracks,
    const StandingLandmarks* standing,
    const SessionOptions& options) {
  TargetStateWriter writer;
  writer.Bytes(kTargetsMagic);
  Field(writer, "version", kTargetsVersion);
  Field(writer, "tracker", options.tracker.name);
  StateValue(writer, session);
  const bool has_standing = standing != nullptr;
  Field(writer, "standing", has_standing);
  if (has_standing) StateFields::Of(writer, *standing);
  const auto count = static_cast<std::uint32_t>(tracks.size());
  Field(writer, "targets", count);
  for (const auto& track : tracks) {
    if (!StateFields::TrackerOf(*track).IsCarried()) {
      return absl::UnimplementedError(absl::StrCat("the tracker '",
                                                   options.tracker.name,
                                                   "' keeps what it knows of '",
                                                   track->id(),
                                                   "' to itself"));
    }
    StateFields::Save(writer, *track);
    if (writer.bytes().size() > kMostTargetBytes) {
      return absl::ResourceExhaustedError(
          absl::StrCat("what is known of the targets is more than ",
                       kMostTargetBytes,
                       " bytes"));
    }
  }
  return writer.bytes();
}

absl::StatusOr<RestoredTargets> RestoreSessionTargets(
    std::string_view state,
    const SessionOptions& options,
    std::shared_ptr<const ground::GroundSurface> ground,
    const StandingLandmarks* standing) {
  TargetStateReader reader(state, options, std::move(ground));
  reader.Enter("the session's targets");
  if (state.size() > kMostTargetBytes) reader.Fail("are too many bytes");
  if (reader.Bytes(kTargetsMagic.size()) != kTargetsMagic) {
    reader.Fail("are none");
  }
  std::uint16_t version = 0;
  Field(reader, "version", version);
  if (reader.ok() && version != kTargetsVersion) {
    return absl::UnimplementedError(
        absl::StrCat("the session's targets are of version ",
                     version,
                     ", this program reads version ",
                     kTargetsVersion));
  }
  std::string tracker;
  Field(reader, "tracker", tracker);
  if (reader.ok() && tracker != options.tracker.name) {
    return absl::FailedPreconditionError(
        absl::StrCat("the session's targets are followed by another tracker "
                     "than '",
                     options.tracker.name,
                     "'"));
  }
  RestoredTargets restored;
  StateValue(reader, restored.session);
  bool has_standing = false;
  Field(reader, "standing", has_standing);
  if (has_standing != (standing != nullptr)) {
    reader.Fail("is of a session that asks its map for more, or less");
  }
  if (standing != nullptr) {
    restored.standing = *standing;
    StateFields::Of(reader, *restored.standing);
  }
  std::uint32_t count = 0;
  Field(reader, "targets", count);
  if (count > static_cast<std::uint32_t>(options.max_targets)) {
    reader.Fail("are too many");
  }
  for (; count > 0 && reader.ok(); --count) {
    auto track = StateFields::Restore(reader);
    if (track == nullptr) break;
    const bool is_there = std::any_of(
        restored.tracks.begin(), restored.tracks.end(), [&](const auto& other) {
          return other->id() == track->id();
        });
    if (is_there) reader.Fail("has a name that another one has");
    restored.tracks.push_back(std::move(track));
  }
  reader.Enter("the session's targets");
  if (reader.ok() && reader.remaining() > 0) reader.Fail("go on after the end");
  RETURN_IF_ERROR(reader.status());
  return restored;
}

}  // namespace groundlock::tracking
