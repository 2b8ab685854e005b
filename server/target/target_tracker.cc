// SPDX-License-Identifier: Apache-2.0
#include "server/target/target_tracker.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "server/target/act_tracker.h"
#include "server/target/dcf_tracker.h"
#include "server/target/model_trackers.h"
#include "server/target/open_cv_tracker.h"

namespace groundlock::target {

std::vector<std::string> TargetTrackerNames() {
  std::vector<std::string> names = {"act", "dcf"};
  for (const OpenCvTrackerKind& kind : OpenCvTrackerKinds()) {
    names.push_back(kind.name);
  }
  return names;
}

std::vector<std::string> ModelTrackerNames() {
  std::vector<std::string> names;
  for (const ModelTrackerKind& kind : ModelTrackerKinds()) {
    names.push_back(kind.name);
  }
  return names;
}

std::vector<std::string> AllTrackerNames() {
  std::vector<std::string> names = TargetTrackerNames();
  for (std::string& name : ModelTrackerNames()) names.push_back(name);
  return names;
}

absl::StatusOr<std::unique_ptr<TargetTracker>> CreateTargetTracker(
    const TargetTrackerOptions& options) {
  if (options.name == "act") return std::make_unique<ActTracker>();
  if (options.name == "dcf") return std::make_unique<DcfTracker>();
  for (const OpenCvTrackerKind& kind : OpenCvTrackerKinds()) {
    if (kind.name == options.name) {
      return std::make_unique<OpenCvTracker>(kind.name, kind.start);
    }
  }
  for (const ModelTrackerKind& kind : ModelTrackerKinds()) {
    if (kind.name != options.name) continue;
    ASSIGN_OR_RETURN(OpenCvStart start, StartModel(kind, options.models));
    return std::make_unique<OpenCvTracker>(kind.name, std::move(start));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("tracker '",
                   options.name,
                   "' is not known; there are ",
                   absl::StrJoin(AllTrackerNames(), ", ")));
}

}  // namespace groundlock::target
