// SPDX-License-Identifier: Apache-2.0
#include "server/motion/motion_predictor.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "server/motion/constant_acceleration.h"

namespace groundlock::motion {
namespace {

constexpr std::string_view kConstantAcceleration = "constant-acceleration";

}  // namespace

std::vector<std::string> MotionPredictorNames() {
  return {std::string(kConstantAcceleration)};
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
        std::pair{"jerk_density", jerk_density},
        std::pair{"initial_speed_sigma", initial_speed_sigma},
        std::pair{"initial_acceleration_sigma", initial_acceleration_sigma},
        std::pair{"unseen_acceleration_decay_s", unseen_acceleration_decay_s},
        std::pair{"unseen_velocity_decay_s", unseen_velocity_decay_s},
        std::pair{"steady_velocity_s", steady_velocity_s}}) {
    if (!(value > 0.0) || !std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "motion.", field, " is ", value, ", must be positive and finite"));
    }
  }
  for (const auto& [field, value] :
       {std::pair{"unseen_after_s", unseen_after_s},
        std::pair{"unseen_velocity_hold_s", unseen_velocity_hold_s},
        std::pair{"standing_gate", standing_gate}}) {
    if (!(value >= 0.0) || !std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "motion.", field, " is ", value, ", must be finite and >= 0"));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<MotionPredictor>> CreateMotionPredictor(
    const MotionOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  return std::make_unique<ConstantAcceleration>(options);
}

}  // namespace groundlock::motion
