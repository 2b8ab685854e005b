// SPDX-License-Identifier: Apache-2.0
#include "server/image/colour_picture.h"

#include <algorithm>
#include <array>
#include <opencv2/imgproc.hpp>

namespace groundlock::image {
namespace {

// How many luma samples share one of `chroma_size` samples along an axis.
int Ratio(int luma_size, int chroma_size) {
  return (luma_size + chroma_size - 1) / chroma_size;
}

// The samples along one axis that interpolation reads for luma samples
// [begin, end): one more on either side than those they lie in.
cv::Range ChromaRange(int begin, int end, int ratio, int chroma_size) {
  return {std::max(0, begin / ratio - 1),
          std::min(chroma_size, (end + ratio - 1) / ratio + 1)};
}

}  // namespace

ColourPicture::ColourPicture(const cv::Mat& bgr_or_gray) {
  if (bgr_or_gray.channels() == 3) {
    bgr_ = bgr_or_gray;
    converted_px_.emplace_back(cv::Point(), bgr_.size());
  } else {
    luma_ = bgr_or_gray;
  }
}

ColourPicture::ColourPicture(const cv::Mat& luma,
                             const cv::Mat& cb,
                             const cv::Mat& cr)
    : luma_(luma), cb_(cb), cr_(cr) {}

const cv::Mat& ColourPicture::Bgr(const cv::Rect& region_px) {
  if (bgr_.empty()) bgr_ = cv::Mat::zeros(luma_.size(), CV_8UC3);
  const cv::Rect inside_px = region_px & cv::Rect(cv::Point(), bgr_.size());
  if (inside_px.empty()) return bgr_;
  const bool is_there =
      std::any_of(converted_px_.begin(),
                  converted_px_.end(),
                  [&](const cv::Rect& converted_px) {
                    return (converted_px & inside_px) == inside_px;
                  });
  if (!is_there) {
    Convert(inside_px);
    converted_px_.push_back(inside_px);
  }
  return bgr_;
}

void ColourPicture::Convert(const cv::Rect& region_px) {
  cv::Mat target = bgr_(region_px);
  const cv::Mat luma = luma_(region_px);
  if (cb_.empty()) {
    cv::cvtColor(luma, target, cv::COLOR_GRAY2BGR);
    return;
  }
  const int ratio_x = Ratio(luma_.cols, cb_.cols);
  const int ratio_y = Ratio(luma_.rows, cb_.rows);
  std::array<cv::Mat, 3> planes = {luma, {}, {}};  // OpenCV's order: Y, Cr, Cb
  if (ratio_x == 1 && ratio_y == 1) {
    planes[1] = cr_(region_px);
    planes[2] = cb_(region_px);
  } else {
    const cv::Range columns = ChromaRange(
        region_px.x, region_px.x + region_px.width, ratio_x, cb_.cols);
    const cv::Range rows = ChromaRange(
        region_px.y, region_px.y + region_px.height, ratio_y, cb_.rows);
    const cv::Rect within(region_px.x - columns.start * ratio_x,
                          region_px.y - rows.start * ratio_y,
                          region_px.width,
                          region_px.height);
    const cv::Size enlarged(columns.size() * ratio_x, rows.size() * ratio_y);
    const auto enlarge = [&](const cv::Mat& chroma) {
      cv::Mat out;
      cv::resize(
          chroma(rows, columns), out, enlarged, 0.0, 0.0, cv::INTER_LINEAR);
      return out(within);
    };
    planes[1] = enlarge(cr_);
    planes[2] = enlarge(cb_);
  }
  cv::Mat merged;
  cv::merge(planes.data(), planes.size(), merged);
  cv::cvtColor(merged, target, cv::COLOR_YCrCb2BGR);
}

}  // namespace groundlock::image
