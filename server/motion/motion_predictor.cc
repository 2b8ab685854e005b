// SPDX-License-Identifier: Apache-2.0
#include "server/motion/motion_predictor.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "server/motion/interacting_models.h"

namespace groundlock::motion {
namespace {

constexpr std::string_view kInteractingModels = "interacting-models";

}  // namespace

std::vector<std::string> MotionPredictorNames() {
  return {std::string(kInteractingModels)};
}

absl::Status MotionOptions::Validate() const {
  const std::vector<std::string> names = MotionPredictorNames();
  if (std::find(names.begin(), names.end(), name) == names.end()) {
    return absl::InvalidArgumentError(absl::StrCat("motion.name is '",
                                                   name,
                                                   "', known are: ",
                                                   absl::StrJoin(names, ", ")));
  }
  for (const auto& [field, value] :
       {std::pair{"target_size_m", target_size_m},
        std::pair{"speed_sigma", speed_sigma},
        std::pair{"start_speed_sigma", start_speed_sigma},
        std::pair{"turn_sigma_rad_s", turn_sigma_rad_s},
        std::pair{"turn_time_s", turn_time_s},
        std::pair{"steady_density", steady_density},
        std::pair{"manoeuvre_density", manoeuvre_density},
        std::pair{"standing_density", standing_density},
        std::pair{"stands_s", stands_s},
        std::pair{"steady_s", steady_s},
        std::pair{"steady_until_stop_s", steady_until_stop_s},
        std::pair{"manoeuvre_s", manoeuvre_s},
        std::pair{"manoeuvre_until_stop_s", manoeuvre_until_stop_s}}) {
    if (!(value > 0.0) || !std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "motion.", field, " is ", value, ", must be positive and finite"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<MotionPredictor>> CreateMotionPredictor(
    const MotionOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  return std::make_unique<InteractingModels>(options);
}

}  // namespace groundlock::motion
