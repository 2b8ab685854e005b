// SPDX-License-Identifier: Apache-2.0
// JPEG's luma and chroma to BGR, the chroma upsampled on the way.
#ifndef GROUNDLOCK_SERVER_IMAGE_YCC_TO_BGR_H_
#define GROUNDLOCK_SERVER_IMAGE_YCC_TO_BGR_H_

#include <opencv2/core/mat.hpp>

namespace groundlock::image {

// Chroma samples of which each is for `share_x` x `share_y` pixels of a
// picture, each 1 or 2, and lies in their middle.
struct ChromaSamples {
  cv::Mat samples;  // CV_8UC1
  int share_x = 1;
  int share_y = 1;
  // Of the picture's first pixel among those that the samples are for.
  cv::Point origin_px;
};

// `luma`: CV_8UC1; `bgr`: CV_8UC3 of its size, written. Between samples chroma
// is linear; beyond the outermost it stays as they are. `cb` and `cr` have the
// same shares and origins. Within 1 of exact conversion. Thread-safe.
// Source: JFIF 1.02 (ITU-R BT.601, full range).
void YccToBgr(const cv::Mat& luma,
              const ChromaSamples& cb,
              const ChromaSamples& cr,
              cv::Mat& bgr);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_YCC_TO_BGR_H_
