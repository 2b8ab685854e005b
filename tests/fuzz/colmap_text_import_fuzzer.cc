// SPDX-License-Identifier: Apache-2.0
// COLMAP's text model: the three files, with a form feed between them.
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
  const std::string_view input(reinterpret_cast<const char*>(data), size);
  const std::size_t first = std::min(input.find('\f'), input.size());
  const std::size_t second =
      std::min(input.find('\f', std::min(first + 1, size)), input.size());
  const std::string_view images =
      second > first ? input.substr(first + 1, second - first - 1) : "";
  const std::string_view points = second < size ? input.substr(second + 1) : "";
  ColmapModel model;
  if (!ParseColmapCamerasText(input.substr(0, first), "c", &model).ok() ||
      !ParseColmapImagesText(images, "i", &model).ok() ||
      !ParseColmapPointsText(points, "p", &model).ok()) {
    return 0;
  }
  std::vector<std::string> warnings;
  const auto linked = LinkColmapModel(std::move(model), &warnings);
  // What links must be a map.
  if (linked.ok() && !linked->data.Validate().ok()) __builtin_trap();
  return 0;
}
