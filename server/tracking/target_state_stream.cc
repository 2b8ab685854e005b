// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/target_state_stream.h"

#include <algorithm>
#include <opencv2/core.hpp>

namespace groundlock::tracking {
namespace {

constexpr std::uint16_t kNoImage = 65'535;

bool AreSame(const cv::Mat& a, const cv::Mat& b) {
  return a.data == b.data && a.size() == b.size() && a.type() == b.type();
}

}  // namespace

void TargetStateWriter::WritePixels(const cv::Mat& image) {
  for (int y = 0; y < image.rows; ++y) {
    Bytes({image.ptr<char>(y), image.cols * image.elemSize()});
  }
}

void TargetStateWriter::WriteImage(const cv::Mat& image) {
  const auto found =
      std::find_if(images_.begin(), images_.end(), [&](const cv::Mat& other) {
        return AreSame(image, other);
      });
  const auto number = image.empty()
                          ? kNoImage
                          : static_cast<std::uint16_t>(found - images_.begin());
  StateValue(*this, number);
  if (image.empty() || found != images_.end()) return;
  images_.push_back(image);
  const auto width_px = static_cast<std::uint16_t>(image.cols);
  const auto height_px = static_cast<std::uint16_t>(image.rows);
  const auto channels = static_cast<std::uint8_t>(image.channels());
  StateValue(*this, width_px);
  StateValue(*this, height_px);
  StateValue(*this, channels);
  WritePixels(image);
}

cv::Mat TargetStateReader::ReadPixels(cv::Size size, int type) {
  const auto pixel_bytes = static_cast<std::size_t>(CV_ELEM_SIZE(type));
  // All of it is there before anything is allocated.
  const std::string_view pixels =
      Bytes(pixel_bytes * static_cast<std::size_t>(size.width) *
            static_cast<std::size_t>(size.height));
  if (pixels.empty()) return {};
  cv::Mat image(size, type);
  std::copy(pixels.begin(), pixels.end(), image.ptr<char>());
  return image;
}

TargetStateReader::Image* TargetStateReader::ReadNumbered(int type) {
  std::uint16_t number = 0;
  StateValue(*this, number);
  if (!ok() || number == kNoImage) return nullptr;
  if (number > images_.size()) {
    Fail("has no image");
    return nullptr;
  }
  if (number == images_.size()) {
    std::uint16_t width_px = 0;
    std::uint16_t height_px = 0;
    std::uint8_t channels = 0;
    StateValue(*this, width_px);
    StateValue(*this, height_px);
    StateValue(*this, channels);
    if (width_px == 0 || height_px == 0) Fail("has an image without pixels");
    if (channels != CV_MAT_CN(type)) Fail("has other colours");
    if (!ok()) return nullptr;
    const cv::Mat pixels = ReadPixels(cv::Size(width_px, height_px), type);
    if (pixels.empty()) return nullptr;
    images_.push_back({pixels, nullptr});
  }
  if (images_[number].pixels.type() != type) {
    Fail("has other colours");
    return nullptr;
  }
  return &images_[number];
}

cv::Mat TargetStateReader::ReadImage(int type) {
  const Image* image = ReadNumbered(type);
  return image != nullptr ? image->pixels : cv::Mat();
}

std::shared_ptr<const image::LumaPyramid> TargetStateReader::ReadPyramid() {
  Image* image = ReadNumbered(CV_8UC1);
  if (image == nullptr) return nullptr;
  if (image->pyramid == nullptr) {
    image->pyramid = image::BuildPyramid(image->pixels);
  }
  return image->pyramid;
}

}  // namespace groundlock::tracking
