// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/session_camera.h"

#include <cstdint>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/state_stream.h"
#include "map_store/base/status.h"

namespace groundlock::tracking {
namespace {

constexpr std::string_view kMagic = "GLSESSION";
constexpr std::uint16_t kVersion = 1;

template <typename Stream, base::StateOf<SessionCamera> T>
void StateValue(Stream& stream, T& camera) {
  Field(stream, "last_time", camera.last_time);
  Field(stream, "hurried", camera.hurried);
}

}  // namespace

std::string SaveSessionCamera(const SessionCamera& camera,
                              const localization::Localizer* localizer) {
  base::StateWriter writer;
  writer.Bytes(kMagic);
  Field(writer, "version", kVersion);
  StateValue(writer, camera);
  if (localizer != nullptr) writer.Bytes(localizer->Save());
  return writer.bytes();
}

absl::StatusOr<SessionCamera> RestoreSessionCamera(
    std::string_view state, localization::Localizer* localizer) {
  base::StateReader reader(state);
  reader.Enter("the session's camera");
  if (reader.Bytes(kMagic.size()) != kMagic) reader.Fail("is none");
  std::uint16_t version = 0;
  Field(reader, "version", version);
  if (reader.ok() && version != kVersion) {
    return absl::UnimplementedError(
        absl::StrCat("the session's camera is of version ",
                     version,
                     ", this program reads version ",
                     kVersion));
  }
  SessionCamera camera;
  StateValue(reader, camera);
  RETURN_IF_ERROR(reader.status());
  const std::string_view of_localizer = reader.Bytes(reader.remaining());
  if (localizer != nullptr) {
    RETURN_IF_ERROR(localizer->Restore(of_localizer));
  } else if (!of_localizer.empty()) {
    return absl::FailedPreconditionError(
        "the session's camera is of a session with a map");
  }
  return camera;
}

}  // namespace groundlock::tracking
