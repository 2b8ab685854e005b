// SPDX-License-Identifier: Apache-2.0
// A frame's colour, converted to BGR where somebody looks at it. A video frame
// is mostly looked at in gray: the few pixels around a target are a tenth of
// the conversion's cost. Internal to the room: see frame.h.
#ifndef GROUNDLOCK_SERVER_IMAGE_COLOUR_PICTURE_H_
#define GROUNDLOCK_SERVER_IMAGE_COLOUR_PICTURE_H_

#include <array>
#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>
#include <vector>

#include "server/image/ycc_to_bgr.h"

namespace groundlock::image {

// Not thread-safe. Pixels given are shared, not copied, and only read.
class ColourPicture {
 public:
  // A picture that is there already: CV_8UC3 BGR, or CV_8UC1 (gray).
  explicit ColourPicture(const cv::Mat& bgr_or_gray);
  // JPEG's planes (JFIF: BT.601, full range), CV_8UC1 each. `cb` and `cr` have
  // the luma's size divided by one of 1, 2, 4 along either axis, rounded up,
  // and each chroma sample lies in the middle of the luma samples it is for.
  ColourPicture(const cv::Mat& luma, const cv::Mat& cb, const cv::Mat& cr);

  // CV_8UC3 of the picture's size, halved (rounded down) as often as asked for,
  // at most kMaxHalvings times. Pixels within `region_px`, which counts in the
  // halved picture, and within those asked for before are there; others hold
  // anything. A halved pixel is the mean of those it covers.
  static constexpr int kMaxHalvings = 3;
  const cv::Mat& Bgr(const cv::Rect& region_px, int halvings = 0);

 private:
  struct Level {
    cv::Mat bgr;
    std::vector<cv::Rect> converted_px;
  };

  cv::Size size_px() const;
  void Convert(const cv::Rect& region_px, int halvings, cv::Mat target) const;
  // What is of `plane` in the region, at least.
  ChromaSamples Chroma(const cv::Mat& plane,
                       const cv::Rect& region_px,
                       int halvings) const;

  cv::Mat luma_, cb_, cr_;
  std::array<Level, kMaxHalvings + 1> levels_;
};

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_COLOUR_PICTURE_H_
