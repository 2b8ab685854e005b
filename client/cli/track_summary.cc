// SPDX-License-Identifier: Apache-2.0
#include "client/cli/track_summary.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <variant>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/names.h"

namespace groundlock::cli {
namespace {

double Share(std::uint64_t part, std::uint64_t whole) {
  return whole == 0 ? 0.0 : static_cast<double>(part) / whole;
}

}  // namespace

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

void TrackSummary::Add(const sdk::FrameReply& reply) {
  if (std::holds_alternative<sdk::FrameDropped>(reply)) {
    ++dropped_;
    return;
  }
  if (std::holds_alternative<sdk::FrameError>(reply)) {
    ++failed_;
    return;
  }
  const auto& result = std::get<sdk::FrameResult>(reply);
  ++processed_;
  if (result.camera.state == sdk::CameraState::kTracked) ++camera_tracked_;
  last_states_ = absl::StrCat("camera ", CameraStateName(result.camera.state));
  for (const sdk::TargetResult& target : result.targets) {
    Target& counts = targets_[target.id];
    ++counts.frames;
    if (target.state == sdk::TargetState::kTracked) ++counts.seen;
    counts.last_state = TargetStateName(target.state);
    absl::StrAppend(&last_states_, ", ", target.id, " ", counts.last_state);
  }
  if (result.movers_state != sdk::MoversState::kNotAsked) {
    ++movers_states_[MoversStateName(result.movers_state)];
    for (const sdk::Mover& mover : result.movers) mover_ids_.insert(mover.id);
    movers_ms_.push_back(result.times.movers_ms);
  }
  decode_ms_.push_back(result.times.decode_ms);
  localize_ms_.push_back(result.times.localize_ms);
  track_ms_.push_back(result.times.track_ms);
  total_ms_.push_back(result.times.total_ms);
}

std::string TrackSummary::ToText(double wall_s) const {
  std::string text = absl::StrFormat(
      "frames       %d processed, %d dropped, %d failed, in %.1f s "
      "(%.1f frames/s)\n"
      "camera       tracked in %.1f %% of them\n",
      processed_,
      dropped_,
      failed_,
      wall_s,
      wall_s > 0.0 ? processed_ / wall_s : 0.0,
      100.0 * Share(camera_tracked_, processed_));
  for (const auto& [id, target] : targets_) {
    absl::StrAppendFormat(&text,
                          "%-12s seen in %.1f %% of %d frames, at the end %s\n",
                          id,
                          100.0 * Share(target.seen, target.frames),
                          target.frames,
                          target.last_state);
  }
  if (!movers_states_.empty()) {
    absl::StrAppendFormat(&text, "movers       %d; frames:", mover_ids_.size());
    for (const auto& [state, frames] : movers_states_) {
      absl::StrAppendFormat(&text, " %s %d", state, frames);
    }
    text += '\n';
  }
  absl::StrAppendFormat(&text,
                        "median time  decode %.1f, localize %.1f, track %.1f, "
                        "total %.1f ms\n",
                        Median(decode_ms_),
                        Median(localize_ms_),
                        Median(track_ms_),
                        Median(total_ms_));
  return text;
}

std::string TrackSummary::ToJson(double wall_s,
                                 const std::string& session_id) const {
  nlohmann::json targets = nlohmann::json::object();
  for (const auto& [id, target] : targets_) {
    targets[id] = {{"frames", target.frames},
                   {"seen_share", Share(target.seen, target.frames)},
                   {"last_state", target.last_state}};
  }
  nlohmann::json summary = {
      {"session_id", session_id},
      {"frames",
       {{"processed", processed_}, {"dropped", dropped_}, {"failed", failed_}}},
      {"camera_tracked_share", Share(camera_tracked_, processed_)},
      {"targets", targets},
      {"median_ms",
       {{"decode", Median(decode_ms_)},
        {"localize", Median(localize_ms_)},
        {"track", Median(track_ms_)},
        {"total", Median(total_ms_)}}},
      {"wall_s", wall_s},
      {"frames_per_s", wall_s > 0.0 ? processed_ / wall_s : 0.0}};
  if (!movers_states_.empty()) {
    summary["movers"] = {{"count", mover_ids_.size()},
                         {"frames_by_state", movers_states_}};
    summary["median_ms"]["movers"] = Median(movers_ms_);
  }
  return summary.dump();
}

}  // namespace groundlock::cli
