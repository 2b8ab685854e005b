// SPDX-License-Identifier: Apache-2.0
// An image's header: never less than what the decoder makes of it.
#include <cstddef>
#include <cstdint>
#include <opencv2/imgcodecs.hpp>
#include <string_view>

#include "map_store/base/image_header.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const auto header = groundlock::base::ReadImageHeader(
      {reinterpret_cast<const char*>(data), size});
  constexpr std::uint64_t kDecoded = 1 << 16;
  if (!header ||
      std::uint64_t{header->width_px} * header->height_px > kDecoded) {
    return 0;
  }
  try {
    const cv::Mat encoded(
        1, static_cast<int>(size), CV_8UC1, const_cast<std::uint8_t*>(data));
    const cv::Mat image = cv::imdecode(
        encoded, cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION);
    if (image.total() > std::uint64_t{header->width_px} * header->height_px) {
      __builtin_trap();
    }
  } catch (const cv::Exception&) {
    // Damaged, which is not the header's business.
  }
  return 0;
}
