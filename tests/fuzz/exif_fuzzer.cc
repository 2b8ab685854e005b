// SPDX-License-Identifier: Apache-2.0
// A photo's EXIF data: a place on Earth and a lens, or none.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "map_store/formats/exif.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const std::string_view jpeg{reinterpret_cast<const char*>(data), size};
  const auto place = groundlock::formats::GpsFromExif(jpeg);
  if (place && !place->Validate().ok()) __builtin_trap();
  const auto lens = groundlock::formats::LensFromExif(jpeg, 640, 480);
  if (lens.focal_px && !(*lens.focal_px > 0.0 && *lens.focal_px < 1e5)) {
    __builtin_trap();
  }
  return 0;
}
