// SPDX-License-Identifier: Apache-2.0
// OpenCV's trackers that are networks, whose models are files.
#ifndef GROUNDLOCK_SERVER_TARGET_MODEL_TRACKERS_H_
#define GROUNDLOCK_SERVER_TARGET_MODEL_TRACKERS_H_

#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "server/target/open_cv_tracker.h"

namespace groundlock::target {

struct ModelTrackerKind {
  std::string name;
  std::vector<std::string> files;  // names in the models' folder
  // From the paths of those files, in that order.
  std::function<OpenCvStart(const std::vector<std::string>& paths)> start;
};
const std::vector<ModelTrackerKind>& ModelTrackerKinds();

// How such a tracker starts with the models in `folder`. kFailedPrecondition:
// no folder; kNotFound names the file that is not there.
absl::StatusOr<OpenCvStart> StartModel(const ModelTrackerKind& kind,
                                       const std::string& folder);

}  // namespace groundlock::target

#endif  // GROUNDLOCK_SERVER_TARGET_MODEL_TRACKERS_H_
