// SPDX-License-Identifier: Apache-2.0
// COLMAP's mapper leaves several models where a walk falls apart: which one is
// the map, and what to tell the user about the rest.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_SUB_MODELS_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_SUB_MODELS_H_

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::build::internal {

struct SubModel {
  std::filesystem::path path;
  std::vector<std::string> images;  // names
  std::size_t num_landmarks = 0;
};

// The sub-models in COLMAP's output folder (0, 1, ...), those without images
// left out.
absl::StatusOr<std::vector<SubModel>> ReadSubModels(
    const std::filesystem::path& folder);

// Index of the one with the most images, then the most landmarks, then the
// lowest index. `models` must not be empty.
std::size_t ChooseSubModel(std::span<const SubModel> models);

// Which images did not make it into `models[chosen]`, as stretches of the walk;
// empty if all did.
//   images  all names, in the order of time
std::vector<std::string> DescribeGaps(std::span<const std::string> images,
                                      std::span<const SubModel> models,
                                      std::size_t chosen);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_SUB_MODELS_H_
