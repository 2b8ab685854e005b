// SPDX-License-Identifier: Apache-2.0
// What a correlation filter's response tells: how sure it is, and where.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_RESPONSE_PEAKS_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_RESPONSE_PEAKS_H_

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>

#include "server/target/internal/spectrum.h"

namespace groundlock::target::internal {

// Responses are square, periodic, CV_32F.

// Average peak-to-correlation energy: M. Wang, Y. Liu, Z. Huang, "Large margin
// object tracking with circulant feature maps", CVPR 2017, equation 9. 0 where
// the response is flat.
double PeakToEnergy(const cv::Mat& response);

// The peak over the standard deviation outside 11 x 11 cells around it: D.
// Bolme, J. Beveridge, B. Draper, Y. Lui, "Visual object tracking using
// adaptive correlation filters", CVPR 2010, section 3.5.
double PeakToSidelobe(const cv::Mat& response, const Peak& peak);

// Where the target is expected, and how its image lies in the response.
struct PeakExpectation {
  Eigen::Vector2d offset_px;    // of the response's centre from there
  Eigen::Matrix2d information;  // the expectation's covariance, inverted
  Eigen::Vector2d cell_px;
  Eigen::Vector2d target_cells;
};

// The highest of the response's maxima, unless it lies where the target is not
// expected; then, of those that rival it, the likeliest.
Peak FindExpectedPeak(const cv::Mat& response,
                      const PeakExpectation& expectation);

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_RESPONSE_PEAKS_H_
