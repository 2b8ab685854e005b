// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/response_peaks.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

namespace groundlock::target::internal {
namespace {

// A second place is worth a thought if the best lies farther from where the
// target is expected than this (squared Mahalanobis distance; chi-square, 2
// degrees, 95 %), and the second looks this much like it and lies so many
// target sides apart from it: the response's lobes are no second target.
constexpr double kSurprise = 6.0;
constexpr double kRivalShare = 0.7;
constexpr double kRivalApart = 0.5;

// Whether no neighbour of a cell is higher.
bool IsMaximum(const cv::Mat& response, int x, int y) {
  const int n = response.rows;
  const float value = response.at<float>(y, x);
  for (int k = 0; k < 9; ++k) {
    if (value <
        response.at<float>((y + k / 3 - 1 + n) % n, (x + k % 3 - 1 + n) % n)) {
      return false;
    }
  }
  return true;
}

}  // namespace

double PeakToEnergy(const cv::Mat& response) {
  double low = 0.0;
  double high = 0.0;
  cv::minMaxLoc(response, &low, &high);
  double sum = 0.0;
  for (int y = 0; y < response.rows; ++y) {
    const auto* row = response.ptr<float>(y);
    for (int x = 0; x < response.cols; ++x) {
      sum += (row[x] - low) * (row[x] - low);
    }
  }
  const double mean = sum / static_cast<double>(response.total());
  return mean > 0.0 ? (high - low) * (high - low) / mean : 0.0;
}

double PeakToSidelobe(const cv::Mat& response, const internal::Peak& peak) {
  constexpr int kHalf = 5;
  const int n = response.rows;
  const auto distance = [n](int at, double center) {
    const int d = std::abs(at - static_cast<int>(std::lround(center)));
    return std::min(d, std::abs(n - d));
  };
  double sum = 0.0;
  double squares = 0.0;
  int count = 0;
  for (int y = 0; y < n; ++y) {
    const auto* row = response.ptr<float>(y);
    const bool near = distance(y, peak.shift_cells.y()) <= kHalf;
    for (int x = 0; x < n; ++x) {
      if (near && distance(x, peak.shift_cells.x()) <= kHalf) continue;
      sum += row[x];
      squares += row[x] * row[x];
      ++count;
    }
  }
  const double mean = sum / count;
  const double variance = squares / count - mean * mean;
  return variance > 0.0 ? (peak.value - mean) / std::sqrt(variance) : 0.0;
}

Peak FindExpectedPeak(const cv::Mat& response,
                      const PeakExpectation& expectation) {
  Peak best = FindPeak(response);
  const Peak highest = best;
  const auto surprise = [&](const Eigen::Vector2d& shift_cells) {
    const Eigen::Vector2d d =
        expectation.offset_px + expectation.cell_px.cwiseProduct(shift_cells);
    return d.dot(expectation.information * d);
  };
  const double highest_surprise = surprise(highest.shift_cells);
  if (highest_surprise <= kSurprise) return best;
  double best_score =
      std::log(static_cast<double>(highest.value)) - 0.5 * highest_surprise;
  const Eigen::Vector2d apart_cells = kRivalApart * expectation.target_cells;
  const int n = response.rows;
  for (int y = -n / 2; y < n / 2; ++y) {
    const int row_at = y < 0 ? y + n : y;
    const auto* row = response.ptr<float>(row_at);
    for (int x = -n / 2; x < n / 2; ++x) {
      const int at = x < 0 ? x + n : x;
      const float value = row[at];
      if (!(value > 0.0F) || value < kRivalShare * highest.value) continue;
      const Eigen::Vector2d shift(x, y);
      if (((shift - highest.shift_cells).cwiseAbs() - apart_cells).maxCoeff() <
          0.0) {
        continue;
      }
      if (!IsMaximum(response, at, row_at)) continue;
      const double score =
          std::log(static_cast<double>(value)) - 0.5 * surprise(shift);
      if (score <= best_score) continue;
      best_score = score;
      best = {shift, value};
    }
  }
  return best;
}

}  // namespace groundlock::target::internal
