// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/spectrum.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>

namespace groundlock::target::internal {
namespace {

// The maximum of the parabola through (-1, left), (0, middle), (1, right).
double ParabolaVertex(double left, double middle, double right) {
  const double curvature = left - 2.0 * middle + right;
  if (curvature >= 0.0) return 0.0;
  return std::clamp(0.5 * (left - right) / curvature, -0.5, 0.5);
}

}  // namespace

void ForwardTransform(const cv::Mat& real, cv::Mat& spectrum) {
  cv::dft(real, spectrum, cv::DFT_COMPLEX_OUTPUT);
}

void InverseTransform(const cv::Mat& spectrum, cv::Mat& real) {
  cv::dft(
      spectrum, real, cv::DFT_INVERSE | cv::DFT_REAL_OUTPUT | cv::DFT_SCALE);
}

void AddConjugateProduct(const cv::Mat& a, const cv::Mat& b, cv::Mat& sum) {
  const int count = static_cast<int>(a.total()) * 2;
  const float* __restrict pa = a.ptr<float>();
  const float* __restrict pb = b.ptr<float>();
  float* __restrict ps = sum.ptr<float>();
  for (int i = 0; i < count; i += 2) {
    ps[i] += pa[i] * pb[i] + pa[i + 1] * pb[i + 1];
    ps[i + 1] += pa[i + 1] * pb[i] - pa[i] * pb[i + 1];
  }
}

Peak FindPeak(const cv::Mat& response) {
  double maximum = 0.0;
  cv::Point at;
  cv::minMaxLoc(response, nullptr, &maximum, nullptr, &at);
  const int width = response.cols;
  const int height = response.rows;
  const auto value = [&](int x, int y) {
    return static_cast<double>(
        response.at<float>((y + height) % height, (x + width) % width));
  };
  const double dx =
      ParabolaVertex(value(at.x - 1, at.y), maximum, value(at.x + 1, at.y));
  const double dy =
      ParabolaVertex(value(at.x, at.y - 1), maximum, value(at.x, at.y + 1));
  const int x = at.x >= width / 2 ? at.x - width : at.x;
  const int y = at.y >= height / 2 ? at.y - height : at.y;
  return {{x + dx, y + dy}, maximum};
}

cv::Mat PeriodicGaussian(int size, double sigma_cells) {
  cv::Mat result(size, size, CV_32F);
  for (int y = 0; y < size; ++y) {
    const double dy = std::min(y, size - y);
    for (int x = 0; x < size; ++x) {
      const double dx = std::min(x, size - x);
      result.at<float>(y, x) = static_cast<float>(
          std::exp(-0.5 * (dx * dx + dy * dy) / (sigma_cells * sigma_cells)));
    }
  }
  return result;
}

std::vector<float> HannWindow(int size) {
  std::vector<float> window(size);
  for (int i = 0; i < size; ++i) {
    window[i] = static_cast<float>(
        0.5 * (1.0 - std::cos(2.0 * std::numbers::pi * i / (size - 1))));
  }
  return window;
}

}  // namespace groundlock::target::internal
