// SPDX-License-Identifier: Apache-2.0
// OpenMVG's sfm_data.json, .feat and .desc: the first byte chooses.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "map_store/formats/internal/openmvg_model.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using namespace groundlock::formats::internal;  // NOLINT: a fuzzer's main
  if (size == 0) return 0;
  const std::string_view input(reinterpret_cast<const char*>(data) + 1,
                               size - 1);
  if (data[0] % 4 == 1) {
    (void)ParseFeatFile(input, "a.feat");
    return 0;
  }
  if (data[0] % 4 == 2) {
    const auto descriptors = ParseDescFile(input, "a.desc");
    if (!descriptors.ok()) return 0;
    for (const auto& descriptor : *descriptors) {
      // Turning it over twice changes nothing.
      if (ReorderOpenMvgDescriptor(ReorderOpenMvgDescriptor(descriptor)) !=
          descriptor) {
        __builtin_trap();
      }
    }
    return 0;
  }
  const auto model = ParseOpenMvg(input, "sfm_data.json");
  if (!model.ok()) return 0;
  for (const OpenMvgView& view : model->views) {
    if (view.camera >= model->cameras.size()) __builtin_trap();
  }
  for (const OpenMvgObservation& o : model->observations) {
    if (o.view >= model->views.size() || o.point >= model->points.size()) {
      __builtin_trap();
    }
  }
  return 0;
}
