// SPDX-License-Identifier: Apache-2.0
// What a session knows of its camera, as bytes, so that it can go on elsewhere:
// "GLSESSION", the version of the format (2 bytes), the fields, and then what
// its localizer saves.
#ifndef GROUNDLOCK_SERVER_TRACKING_SESSION_CAMERA_H_
#define GROUNDLOCK_SERVER_TRACKING_SESSION_CAMERA_H_

#include <chrono>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "server/localization/localizer.h"

namespace groundlock::tracking {

// What the session itself knows, beside its localizer.
struct SessionCamera {
  // Of the frame that was processed last; unset before the first.
  std::optional<std::chrono::nanoseconds> last_time;
  bool hurried = false;
};

//   localizer  null: the session has none.
std::string SaveSessionCamera(const SessionCamera& camera,
                              const localization::Localizer* localizer);

// The localizer goes on from there. An error leaves it as it was:
// kInvalidArgument names the field; kUnimplemented: of another version;
// kFailedPrecondition: of another localizer or map. Nobody believes the bytes.
absl::StatusOr<SessionCamera> RestoreSessionCamera(
    std::string_view state, localization::Localizer* localizer);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_SESSION_CAMERA_H_
