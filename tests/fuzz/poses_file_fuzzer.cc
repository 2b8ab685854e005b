// SPDX-License-Identifier: Apache-2.0
// Known poses of photos, as users have them. The first byte chooses between CSV
// and JSON; what is taken must be usable.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "map_store/build/internal/poses_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  namespace internal = groundlock::build::internal;
  if (size == 0) return 0;
  const std::string text(reinterpret_cast<const char*>(data) + 1, size - 1);
  const auto poses = data[0] == 'c' ? internal::ParsePosesCsv(text)
                                    : internal::ParsePosesJson(text);
  if (!poses.ok()) return 0;
  for (const groundlock::build::PosedImage& image : *poses) {
    const auto& pose = image.world_from_camera;
    if (image.name.empty() || !pose.translation.allFinite() ||
        !(std::abs(pose.rotation.norm() - 1.0) < 1e-6)) {
      __builtin_trap();
    }
  }
  return 0;
}
