// SPDX-License-Identifier: Apache-2.0
// Bundler's bundle.out, its list and Lowe's .key text, packed or not: the first
// byte chooses.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "map_store/formats/internal/bundler_model.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using namespace groundlock::formats::internal;  // NOLINT: a fuzzer's main
  if (size == 0) return 0;
  const std::string_view input(reinterpret_cast<const char*>(data) + 1,
                               size - 1);
  switch (data[0] % 4) {
    case 0: {
      const auto model = ParseBundler(input, "bundle.out");
      if (!model.ok()) break;
      for (const BundlerObservation& o : model->observations) {
        if (o.camera >= model->cameras.size() ||
            o.point >= model->points.size()) {
          __builtin_trap();
        }
      }
      break;
    }
    case 1:
      (void)ParseBundlerList(input, "list.txt");
      break;
    case 2: {
      const auto keys = ParseKeyFile(input, "a.key");
      if (keys.ok() && keys->xy_px.size() != keys->descriptors.size()) {
        __builtin_trap();
      }
      break;
    }
    default: {
      const auto text = Gunzip(input, 1 << 20, "a.key.gz");
      if (text.ok() && text->size() > 1 << 20) __builtin_trap();
    }
  }
  return 0;
}
