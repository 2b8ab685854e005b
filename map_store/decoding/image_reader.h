// SPDX-License-Identifier: Apache-2.0
// Image files of strangers, decoded in a cage (decoder.h).
#ifndef GROUNDLOCK_MAP_STORE_DECODING_IMAGE_READER_H_
#define GROUNDLOCK_MAP_STORE_DECODING_IMAGE_READER_H_

#include <filesystem>
#include <memory>
#include <opencv2/core.hpp>

#include "absl/status/statusor.h"
#include "map_store/decoding/decoder.h"

namespace groundlock::decoding {

// Thread-safe: reads at the same time have a decoder each. Decoders are started
// when needed (a quarter of a second) and kept for the next image until the
// reader is destroyed.
class ImageReader {
 public:
  explicit ImageReader(const DecoderOptions& options = {});
  ~ImageReader();
  ImageReader(const ImageReader&) = delete;
  ImageReader& operator=(const ImageReader&) = delete;

  // CV_8UC3 or CV_8UC1, without the rotation that EXIF may ask for: the lens'
  // centre belongs to the pixels as they are stored. Formats: those of
  // base::ReadImageHeader. kNotFound; kInvalidArgument: not an image, or its
  // decoder crashed or hung; kResourceExhausted: more than
  // base::kMaxPhotoPixels or the decoder's memory. Messages name the file.
  absl::StatusOr<cv::Mat> ReadColour(const std::filesystem::path& path);
  absl::StatusOr<cv::Mat> ReadLuma(const std::filesystem::path& path);

 private:
  class Pool;
  std::unique_ptr<Pool> pool_;
};

}  // namespace groundlock::decoding

#endif  // GROUNDLOCK_MAP_STORE_DECODING_IMAGE_READER_H_
