// SPDX-License-Identifier: Apache-2.0
// groundlock evaluate --trackers
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_TRACKERS_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_TRACKERS_H_

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/cli/verbs.h"

namespace groundlock::cli {

struct TrackersRequest {
  std::filesystem::path folder;       // as ReadOnePassSequences reads it
  std::vector<std::string> only;      // of its sequences; empty = all
  std::vector<std::string> trackers;  // empty = kComparedTrackers
  std::filesystem::path out;          // is there
  std::uint64_t seed = 0;
  std::string machine;
};

// What is measured unless told otherwise: the server's default, the thesis'
// tracker, and two correlation filters of OpenCV.
inline constexpr const char* kComparedTrackers[] = {
    "dcf", "act", "csrt", "kcf"};

// Runs each tracker over each sequence, in sessions without a map, and writes
// trackers.html, trackers.json and SEQUENCE_TRACKER.csv to `out`.
absl::Status EvaluateTrackers(const TrackersRequest& request,
                              VerbContext& context);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_TRACKERS_H_
