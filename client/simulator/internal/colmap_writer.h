// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_COLMAP_WRITER_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_COLMAP_WRITER_H_

#include <filesystem>

#include "absl/status/status.h"
#include "client/simulator/internal/mapper.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::simulator {

// Writes what COLMAP would: folder/sparse/0/{cameras,images,points3D}.bin and
// folder/database.db with features and descriptors. The model's coordinates
// are p_model, p_world = world_from_model * p_model: structure from motion
// knows neither scale nor up, and an import must be tried on that.
absl::Status WriteColmap(const YardMap& map,
                         const geometry::Similarity3& world_from_model,
                         const std::filesystem::path& folder);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_COLMAP_WRITER_H_
