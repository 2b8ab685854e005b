// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_CLI_TRACK_SUMMARY_H_
#define GROUNDLOCK_CLIENT_CLI_TRACK_SUMMARY_H_

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "client/sdk/types.h"

namespace groundlock::cli {

// Counts the answers of a run. Shares are of the frames that were processed, of
// a target of those in which it was there.
class TrackSummary {
 public:
  void Add(const sdk::FrameReply& reply);

  std::uint64_t processed() const { return processed_; }
  std::uint64_t dropped() const { return dropped_; }
  std::uint64_t failed() const { return failed_; }
  // The last states, for a progress line: "camera TRACKED, car PREDICTED".
  const std::string& last_states() const { return last_states_; }

  // wall_s: how long the run took.
  std::string ToText(double wall_s) const;
  // One JSON object, on one line.
  std::string ToJson(double wall_s, const std::string& session_id) const;

 private:
  struct Target {
    std::uint64_t frames = 0;
    std::uint64_t seen = 0;
    std::string last_state;
  };
  std::uint64_t processed_ = 0;
  std::uint64_t dropped_ = 0;
  std::uint64_t failed_ = 0;
  std::uint64_t camera_tracked_ = 0;
  std::map<std::string, Target> targets_;
  std::vector<double> decode_ms_;
  std::vector<double> localize_ms_;
  std::vector<double> track_ms_;
  std::vector<double> total_ms_;
  // Of runs that look for movers.
  std::map<std::string, std::uint64_t> movers_states_;
  std::set<std::uint64_t> mover_ids_;
  std::vector<double> movers_ms_;
  std::string last_states_;
};

// The middle value (of an even number the mean of both), 0 if there is none.
double Median(std::vector<double> values);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_TRACK_SUMMARY_H_
