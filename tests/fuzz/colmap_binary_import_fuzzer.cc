// SPDX-License-Identifier: Apache-2.0
// COLMAP's binary model: the input is cut into the three files by two 16-bit
// sizes at its start.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "map_store/formats/internal/colmap_model.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using namespace groundlock::formats::internal;  // NOLINT: a fuzzer's main
  std::string_view input(reinterpret_cast<const char*>(data), size);
  if (input.size() < 4) return 0;
  const std::size_t first = data[0] | (data[1] << 8);
  const std::size_t second = data[2] | (data[3] << 8);
  input.remove_prefix(4);
  const std::string_view cameras = input.substr(0, first);
  input.remove_prefix(cameras.size());
  const std::string_view images = input.substr(0, second);
  input.remove_prefix(images.size());
  ColmapModel model;
  if (!ParseColmapCamerasBinary(cameras, "cameras.bin", &model).ok() ||
      !ParseColmapImagesBinary(images, "images.bin", &model).ok() ||
      !ParseColmapPointsBinary(input, "points3D.bin", &model).ok()) {
    return 0;
  }
  std::vector<std::string> warnings;
  const auto linked = LinkColmapModel(std::move(model), &warnings);
  // What links must be a map.
  if (linked.ok() && !linked->data.Validate().ok()) __builtin_trap();
  return 0;
}
