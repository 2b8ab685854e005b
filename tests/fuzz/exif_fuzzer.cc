// SPDX-License-Identifier: Apache-2.0
// A photo's EXIF data: a place on Earth or none.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "map_store/formats/exif.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const auto place = groundlock::formats::GpsFromExif(
      {reinterpret_cast<const char*>(data), size});
  if (place && !place->Validate().ok()) __builtin_trap();
  return 0;
}
