// SPDX-License-Identifier: Apache-2.0
// Arbitrary bytes as what a session without a map knows of its camera: they are
// refused, or are what it would save. What a localizer saves after that is
// tried in localizer_state_fuzzer.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "server/tracking/session_camera.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  const auto camera =
      groundlock::tracking::RestoreSessionCamera(bytes, /*localizer=*/nullptr);
  if (!camera.ok()) return 0;
  if (groundlock::tracking::SaveSessionCamera(*camera, nullptr) != bytes) {
    std::abort();
  }
  return 0;
}
