// SPDX-License-Identifier: Apache-2.0
#include "server/localization/state_message.h"

#include <algorithm>
#include <cstddef>
#include <opencv2/core/mat.hpp>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::localization {
namespace {

constexpr std::string_view kMagic = "GLCAMERA";
constexpr std::uint16_t kVersion = 4;

void WriteImage(const cv::Mat& luma, base::StateWriter& writer) {
  const auto width_px = static_cast<std::uint16_t>(luma.cols);
  const auto height_px = static_cast<std::uint16_t>(luma.rows);
  StateValue(writer, width_px);
  StateValue(writer, height_px);
  for (int y = 0; y < luma.rows; ++y) {
    writer.Bytes({luma.ptr<char>(y), static_cast<std::size_t>(luma.cols)});
  }
}

}  // namespace

std::uint8_t StateMessageWriter::IndexOf(
    const std::shared_ptr<const image::LumaPyramid>& pyramid) {
  // Frames and key frames share images, but not always what is made of them.
  const auto same = [&](const auto& other) {
    return other->levels.front().data == pyramid->levels.front().data;
  };
  const auto found = std::find_if(pyramids_.begin(), pyramids_.end(), same);
  if (found != pyramids_.end()) {
    return static_cast<std::uint8_t>(found - pyramids_.begin());
  }
  pyramids_.push_back(pyramid);
  return static_cast<std::uint8_t>(pyramids_.size() - 1);
}

std::string StateMessageWriter::Message(std::string_view localizer,
                                        const map::Map& map) const {
  StateWriter writer;
  writer.Bytes(kMagic);
  StateValue(writer, kVersion);
  const auto length = static_cast<std::uint8_t>(localizer.size());
  StateValue(writer, length);
  writer.Bytes(localizer);
  writer.Bytes(map.info().content_hash);
  const auto count = static_cast<std::uint8_t>(pyramids_.size());
  StateValue(writer, count);
  for (const auto& pyramid : pyramids_) {
    WriteImage(pyramid->levels.front(), writer);
  }
  writer.Bytes(bytes());
  return writer.bytes();
}

absl::Status StateMessageReader::Open(std::string_view localizer,
                                      const map::Map& map) {
  Enter("the camera's state");
  if (Bytes(kMagic.size()) != kMagic) Fail("is none");
  std::uint16_t version = 0;
  StateValue(*this, version);
  if (ok() && version != kVersion) {
    return absl::UnimplementedError(
        absl::StrCat("the camera's state is of version ",
                     version,
                     ", this program reads version ",
                     kVersion));
  }
  std::uint8_t length = 0;
  StateValue(*this, length);
  const std::string_view name = Bytes(length);
  const std::string_view hash = Bytes(map.info().content_hash.size());
  RETURN_IF_ERROR(status());
  if (name != localizer) {
    return absl::FailedPreconditionError(
        absl::StrCat("the camera's state is of another localizer than '",
                     base::Abseil(localizer),
                     "'"));
  }
  if (hash != map.info().content_hash) {
    return absl::FailedPreconditionError(
        "the camera's state is of another map");
  }
  Enter("images");
  std::uint8_t count = 0;
  StateValue(*this, count);
  for (; count > 0 && ok(); --count) ReadImage();
  return status();
}

void StateMessageReader::ReadImage() {
  std::uint16_t width_px = 0;
  std::uint16_t height_px = 0;
  StateValue(*this, width_px);
  StateValue(*this, height_px);
  const std::size_t size = std::size_t{width_px} * height_px;
  if (size == 0) Fail("have one without pixels");
  // All of it is there before anything is allocated.
  const std::string_view pixels = Bytes(size);
  if (pixels.empty()) return;
  cv::Mat luma(height_px, width_px, CV_8UC1);
  std::copy(pixels.begin(), pixels.end(), luma.ptr<char>());
  pyramids_.push_back(image::BuildPyramid(luma));
}

std::shared_ptr<const image::LumaPyramid> StateMessageReader::PyramidAt(
    std::uint8_t index) {
  if (index < pyramids_.size()) return pyramids_[index];
  Fail("has no image");
  return nullptr;
}

absl::Status StateMessageReader::Close() {
  Enter("the camera's state");
  if (ok() && remaining() > 0) Fail("goes on after its end");
  return status();
}

}  // namespace groundlock::localization
