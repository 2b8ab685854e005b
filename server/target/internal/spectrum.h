// SPDX-License-Identifier: Apache-2.0
// Two-dimensional Fourier transforms of real squares, and the few products that
// correlation filters need.
#ifndef GROUNDLOCK_SERVER_TARGET_INTERNAL_SPECTRUM_H_
#define GROUNDLOCK_SERVER_TARGET_INTERNAL_SPECTRUM_H_

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <vector>

namespace groundlock::target::internal {

// The full complex spectrum (CV_32FC2) of a real CV_32F matrix.
void ForwardTransform(const cv::Mat& real, cv::Mat& spectrum);
// The real matrix of a spectrum with Hermitian symmetry, scaled by 1/N.
void InverseTransform(const cv::Mat& spectrum, cv::Mat& real);
// sum += a * conj(b), element by element. All of one size, CV_32FC2.
void AddConjugateProduct(const cv::Mat& a, const cv::Mat& b, cv::Mat& sum);

// Where a response sampled on a periodic grid has its maximum, between cells.
struct Peak {
  // From cell (0, 0), in [-size/2, size/2).
  Eigen::Vector2d shift_cells = Eigen::Vector2d::Zero();
  double value = 0.0;  // of the largest cell
};
// `response` is CV_32F. A parabola through the largest cell and its neighbours
// in each axis places the maximum between the cells.
Peak FindPeak(const cv::Mat& response);

// A Gaussian of the given standard deviation in cells, centred on cell (0, 0)
// and periodic.
cv::Mat PeriodicGaussian(int size, double sigma_cells);
// Raised cosine that is zero at both ends: 0.5 (1 - cos(2 pi i / (size - 1))).
std::vector<float> HannWindow(int size);

}  // namespace groundlock::target::internal

#endif  // GROUNDLOCK_SERVER_TARGET_INTERNAL_SPECTRUM_H_
