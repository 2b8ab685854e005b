// SPDX-License-Identifier: Apache-2.0
// What a photo says of itself: a place on Earth, a lens and which way is up, or
// none of them; and the file in which such readings go to a server.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "map_store/formats/exif.h"
#include "map_store/formats/photo_readings.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const std::string_view jpeg{reinterpret_cast<const char*>(data), size};
  const auto place = groundlock::formats::GpsFromExif(jpeg);
  if (place && !place->Validate().ok()) __builtin_trap();
  const auto lens = groundlock::formats::LensFromExif(jpeg, 640, 480);
  if (lens.focal_px && !(*lens.focal_px > 0.0 && *lens.focal_px < 1e5)) {
    __builtin_trap();
  }
  // As a whole file, and as the packet of one, which chance seldom frames.
  std::string framed = "\xFF\xD8\xFF\xE1";
  const std::string_view packet = jpeg.substr(0, 60'000);
  const std::string header = std::string("http://ns.adobe.com/xap/1.0/") + '\0';
  const std::size_t length = 2 + header.size() + packet.size();
  framed += static_cast<char>(length >> 8U);
  framed += static_cast<char>(length & 0xFFU);
  framed.append(header).append(packet);
  for (const std::string_view photo : {jpeg, std::string_view(framed)}) {
    const auto up = groundlock::formats::UpFromAttitude(photo);
    if (up && !(std::abs(up->norm() - 1.0) < 1e-9)) __builtin_trap();
  }
  const auto readings = groundlock::formats::ParseUpReadings(jpeg, "f");
  if (readings.ok()) {
    const auto again = groundlock::formats::ParseUpReadings(
        groundlock::formats::UpReadingsToJson(*readings), "f");
    if (!again.ok() || again->photos.size() != readings->photos.size()) {
      __builtin_trap();
    }
  }
  return 0;
}
