// SPDX-License-Identifier: Apache-2.0
// The words for states and formats, in the results CSV as on the screen.
#ifndef GROUNDLOCK_CLIENT_CLI_NAMES_H_
#define GROUNDLOCK_CLIENT_CLI_NAMES_H_

#include <string>

#include "absl/status/statusor.h"
#include "client/sdk/map_types.h"
#include "client/sdk/types.h"

namespace groundlock::cli {

inline const char* CameraStateName(sdk::CameraState state) {
  switch (state) {
    case sdk::CameraState::kInitializing:
      return "INITIALIZING";
    case sdk::CameraState::kTracked:
      return "TRACKED";
    case sdk::CameraState::kHeld:
      return "HELD";
    case sdk::CameraState::kLost:
      return "LOST";
    case sdk::CameraState::kOdometry:
      return "ODOMETRY";
  }
  return "";
}

inline const char* TargetStateName(sdk::TargetState state) {
  switch (state) {
    case sdk::TargetState::kTracked:
      return "TRACKED";
    case sdk::TargetState::kPredicted:
      return "PREDICTED";
    case sdk::TargetState::kLost:
      return "LOST";
  }
  return "";
}

inline const char* MoversStateName(sdk::MoversState state) {
  switch (state) {
    case sdk::MoversState::kNotAsked:
      return "NOT_ASKED";
    case sdk::MoversState::kWatching:
      return "WATCHING";
    case sdk::MoversState::kStarting:
      return "STARTING";
    case sdk::MoversState::kNoMap:
      return "NO_MAP";
    case sdk::MoversState::kNoGround:
      return "NO_GROUND";
    case sdk::MoversState::kNoPose:
      return "NO_POSE";
    case sdk::MoversState::kPoseContradicted:
      return "POSE_CONTRADICTED";
  }
  return "";
}

inline const char* GroundStateName(sdk::GroundState state) {
  switch (state) {
    case sdk::GroundState::kUnknown:
      return "unknown";
    case sdk::GroundState::kEstimated:
      return "estimated";
    case sdk::GroundState::kMeasured:
      return "measured";
  }
  return "";
}

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_NAMES_H_
