// SPDX-License-Identifier: Apache-2.0
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "server/tracking/tracking_session.h"

namespace groundlock::tracking {

absl::Status SessionOptions::Validate() const {
  RETURN_IF_ERROR(localization.Validate());
  RETURN_IF_ERROR(motion.Validate());
  if (!(confidence_threshold >= 0.0 && confidence_threshold <= 1.0)) {
    return absl::InvalidArgumentError(absl::StrCat("confidence_threshold is ",
                                                   confidence_threshold,
                                                   ", must be in [0, 1]"));
  }
  if (target_lost_after.count() < 0) {
    return absl::InvalidArgumentError("target_lost_after is negative");
  }
  if (max_targets < 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_targets is ", max_targets, ", must be at least 1"));
  }
  if (max_hurried_search_places < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_hurried_search_places is ",
                     max_hurried_search_places,
                     ", must be >= 0"));
  }
  if (max_search_places < 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "max_search_places is ", max_search_places, ", must be >= 0"));
  }
  constexpr int kMostViews = 64;
  if (max_views < 0 || max_views > kMostViews) {
    return absl::InvalidArgumentError(absl::StrCat(
        "max_views is ", max_views, ", must be in [0, ", kMostViews, "]"));
  }
  return absl::OkStatus();
}

}  // namespace groundlock::tracking
