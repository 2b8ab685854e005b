// SPDX-License-Identifier: Apache-2.0
// What users write for the command line: align.json, control points, points of
// a map. The first byte chooses.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "client/cli/control_points.h"
#include "client/cli/parse.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using namespace groundlock::cli;  // NOLINT: a fuzzer's main
  if (size == 0) return 0;
  const std::string_view input(reinterpret_cast<const char*>(data) + 1,
                               size - 1);
  switch (data[0] % 4) {
    case 0: {
      const auto similarity = SimilarityFromJson(input);
      if (similarity.ok() &&
          (!similarity->IsFinite() || !(similarity->scale > 0.0))) {
        __builtin_trap();
      }
      break;
    }
    case 1:
      (void)ControlPointsFromJson(input);
      break;
    case 2:
      (void)ParseMapPoint(input);
      break;
    default: {
      (void)ParseGeodetic(input);
      groundlock::sdk::AlignRequest request;
      (void)ParseGround(input, &request);
    }
  }
  return 0;
}
