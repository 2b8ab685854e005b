// SPDX-License-Identifier: Apache-2.0
// A truth of boxes: what is read is finite or not there, and has an area.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "client/cli/evaluate/one_pass.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using groundlock::geometry::Box2;
  const auto boxes = groundlock::cli::BoxesFromText(
      {reinterpret_cast<const char*>(data), size});
  if (!boxes.ok()) return 0;
  const bool seen = std::any_of(
      boxes->begin(), boxes->end(), [](const Box2& b) { return b.IsFinite(); });
  const auto score = groundlock::cli::Rate(*boxes, *boxes);
  if (!seen || !(score.Auc() >= 0.0) || score.PrecisionAt20px() < 0.9) {
    __builtin_trap();
  }
  return 0;
}
