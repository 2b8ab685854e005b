// SPDX-License-Identifier: Apache-2.0
// A truth CSV: what is read is finite, and its frames rise.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "client/cli/evaluate/truth_csv.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const auto rows = groundlock::cli::TruthFromCsv(
      {reinterpret_cast<const char*>(data), size});
  if (!rows.ok()) return 0;
  for (std::size_t i = 0; i < rows->size(); ++i) {
    const groundlock::cli::TruthRow& row = (*rows)[i];
    if (!row.world_from_camera.translation.allFinite() ||
        !row.world_from_camera.rotation.coeffs().allFinite() ||
        (row.visible_box_px && !row.visible_box_px->IsFinite()) ||
        (i > 0 && row.frame <= (*rows)[i - 1].frame)) {
      __builtin_trap();
    }
  }
  return 0;
}
