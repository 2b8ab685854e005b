// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/input_check.h"

#include "absl/strings/str_cat.h"

namespace groundlock::target::internal {

namespace {
// Beyond this a box is no statement about an image any more.
constexpr double kLargestCoordinatePx = 1e6;
constexpr double kSmallestSidePx = 1e-3;
}  // namespace

absl::Status CheckImage(const cv::Mat& image) {
  if (image.empty() || image.dims != 2) {
    return absl::InvalidArgumentError("image: empty");
  }
  if (image.type() != CV_8UC3 && image.type() != CV_8UC1) {
    return absl::InvalidArgumentError(absl::StrCat("image: type ",
                                                   image.type(),
                                                   ", expected 8-bit BGR (",
                                                   CV_8UC3,
                                                   ") or gray (",
                                                   CV_8UC1,
                                                   ")"));
  }
  return absl::OkStatus();
}

absl::Status CheckStartBox(const cv::Mat& image, const geometry::Box2& box_px) {
  const auto text = [&box_px] {
    return absl::StrCat("box ",
                        box_px.x(),
                        ",",
                        box_px.y(),
                        " ",
                        box_px.width(),
                        "x",
                        box_px.height());
  };
  if (!IsUsable(box_px)) {
    return absl::InvalidArgumentError(
        absl::StrCat(text(), ": not finite, of no size or out of bounds"));
  }
  if (!Touches(image, box_px)) {
    return absl::InvalidArgumentError(absl::StrCat(
        text(), ": outside the ", image.cols, "x", image.rows, " image"));
  }
  return absl::OkStatus();
}

bool IsUsable(const geometry::Box2& box_px) {
  return box_px.IsFinite() && box_px.width() >= kSmallestSidePx &&
         box_px.height() >= kSmallestSidePx &&
         box_px.min_px.minCoeff() >= -kLargestCoordinatePx &&
         box_px.max_px.maxCoeff() <= kLargestCoordinatePx;
}

bool Touches(const cv::Mat& image, const geometry::Box2& box_px) {
  return box_px.min_px.x() < image.cols && box_px.min_px.y() < image.rows &&
         box_px.max_px.x() > 0.0 && box_px.max_px.y() > 0.0;
}

}  // namespace groundlock::target::internal
