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

// What lies under `region_px` of the picture halved so often, halved.
cv::Mat Halved(const cv::Mat& plane, const cv::Rect& region_px, int halvings) {
  cv::Mat half = plane(cv::Rect(region_px.x << halvings,
                                region_px.y << halvings,
                                region_px.width << halvings,
                                region_px.height << halvings));
  for (int i = 0; i < halvings; ++i) {
    cv::Mat out;
    cv::resize(
        half, out, {half.cols / 2, half.rows / 2}, 0.0, 0.0, cv::INTER_AREA);
    half = out;
  }
  return half;
}

}  // namespace

ColourPicture::ColourPicture(const cv::Mat& bgr_or_gray) {
  if (bgr_or_gray.channels() == 3) {
    levels_[0].bgr = bgr_or_gray;
    levels_[0].converted_px.emplace_back(cv::Point(), bgr_or_gray.size());
  } else {
    luma_ = bgr_or_gray;
  }
}

ColourPicture::ColourPicture(const cv::Mat& luma,
                             const cv::Mat& cb,
                             const cv::Mat& cr)
    : luma_(luma), cb_(cb), cr_(cr) {}

cv::Size ColourPicture::size_px() const {
  return luma_.empty() ? levels_[0].bgr.size() : luma_.size();
}

const cv::Mat& ColourPicture::Bgr(const cv::Rect& region_px, int halvings) {
  Level& level = levels_.at(halvings);
  if (level.bgr.empty()) {
    level.bgr.create(
        size_px().height >> halvings, size_px().width >> halvings, CV_8UC3);
  }
  const cv::Rect inside_px =
      region_px & cv::Rect(cv::Point(), level.bgr.size());
  if (inside_px.empty()) return level.bgr;
  const bool is_there =
      std::any_of(level.converted_px.begin(),
                  level.converted_px.end(),
                  [&](const cv::Rect& converted_px) {
                    return (converted_px & inside_px) == inside_px;
                  });
  if (!is_there) {
    Convert(inside_px, halvings, level.bgr(inside_px));
    level.converted_px.push_back(inside_px);
  }
  return level.bgr;
}

ChromaSamples ColourPicture::Chroma(const cv::Mat& plane,
                                    const cv::Rect& region_px,
                                    int halvings) const {
  // Samples of the halved picture that share one of the plane, or, below one,
  // the plane's that make one of the picture.
  const int share = 1 << halvings;
  const int ratio_x = Ratio(luma_.cols, plane.cols);
  const int ratio_y = Ratio(luma_.rows, plane.rows);
  const int shrink_x = std::max(1, share / ratio_x);
  const int shrink_y = std::max(1, share / ratio_y);
  ChromaSamples chroma;
  chroma.share_x = std::max(1, ratio_x / share);
  chroma.share_y = std::max(1, ratio_y / share);
  const cv::Range columns = ChromaRange(region_px.x,
                                        region_px.x + region_px.width,
                                        chroma.share_x,
                                        plane.cols / shrink_x);
  const cv::Range rows = ChromaRange(region_px.y,
                                     region_px.y + region_px.height,
                                     chroma.share_y,
                                     plane.rows / shrink_y);
  chroma.origin_px = {region_px.x - columns.start * chroma.share_x,
                      region_px.y - rows.start * chroma.share_y};
  chroma.samples =
      plane(cv::Range(rows.start * shrink_y, rows.end * shrink_y),
            cv::Range(columns.start * shrink_x, columns.end * shrink_x));
  cv::Size size = chroma.samples.size();
  if (shrink_x > 1 || shrink_y > 1) size = {columns.size(), rows.size()};
  // Rare ones are brought to the picture's resolution here.
  if (chroma.share_x > 2 || chroma.share_y > 2) {
    size = {columns.size() * chroma.share_x, rows.size() * chroma.share_y};
    chroma.share_x = chroma.share_y = 1;
  }
  if (size != chroma.samples.size()) {
    cv::Mat resized;
    cv::resize(
        chroma.samples,
        resized,
        size,
        0.0,
        0.0,
        size.width < chroma.samples.cols || size.height < chroma.samples.rows
            ? cv::INTER_AREA
            : cv::INTER_LINEAR);
    chroma.samples = resized;
  }
  return chroma;
}

void ColourPicture::Convert(const cv::Rect& region_px,
                            int halvings,
                            cv::Mat target) const {
  if (luma_.empty()) {
    Halved(levels_[0].bgr, region_px, halvings).copyTo(target);
    return;
  }
  const cv::Mat luma = Halved(luma_, region_px, halvings);
  if (cb_.empty()) {
    cv::cvtColor(luma, target, cv::COLOR_GRAY2BGR);
    return;
  }
  YccToBgr(luma,
           Chroma(cb_, region_px, halvings),
           Chroma(cr_, region_px, halvings),
           target);
}

}  // namespace groundlock::image
