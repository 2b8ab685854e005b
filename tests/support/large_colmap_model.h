// SPDX-License-Identifier: Apache-2.0
// A COLMAP reconstruction of any size, as COLMAP writes one: binary model, and
// a database in which most features observe nothing.
#ifndef GROUNDLOCK_TESTS_SUPPORT_LARGE_COLMAP_MODEL_H_
#define GROUNDLOCK_TESTS_SUPPORT_LARGE_COLMAP_MODEL_H_

#include <cstdint>
#include <filesystem>

#include "absl/status/status.h"

namespace groundlock::test_support {

struct LargeModelOptions {
  std::uint32_t num_landmarks = 1'000'000;
  std::uint32_t num_views = 5'000;
  std::uint32_t observations_per_landmark = 5;
  // Features of each view that observe no landmark.
  std::uint32_t loose_features_per_view = 1'000;
  std::uint64_t seed = 1;
};

// Writes cameras.bin, images.bin, points3D.bin and database.db into `folder`,
// which must be there. Cameras fly over bumpy ground and look straight down;
// each landmark is seen where it projects, up to half a pixel of noise, by
// neighbouring cameras, and its descriptors are alike. kInvalidArgument: fewer
// views than observations per landmark.
absl::Status WriteLargeColmapModel(const LargeModelOptions& options,
                                   const std::filesystem::path& folder);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_LARGE_COLMAP_MODEL_H_
