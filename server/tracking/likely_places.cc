// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/likely_places.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// Between two places of a grid the target is looked for at thirds.
constexpr double kPart = 1.0 / 3.0;

struct Likely {
  double excess = 0.0;
  Eigen::Vector2d center_px;
  Eigen::Vector2d half_px;
};

}  // namespace

ColourMap::ColourMap(const cv::Mat& probability, double scale) : scale_(scale) {
  cv::integral(probability, integral_, CV_64F);
}

double ColourMap::Sum(const Box2& box) const {
  const auto at = [](double value, int end) {
    return static_cast<int>(std::lround(std::clamp(value, 0.0, 1.0 * end)));
  };
  const int left = at(box.min_px.x(), integral_.cols - 1);
  const int right = at(box.max_px.x(), integral_.cols - 1);
  const int top = at(box.min_px.y(), integral_.rows - 1);
  const int bottom = at(box.max_px.y(), integral_.rows - 1);
  return integral_.at<double>(bottom, right) -
         integral_.at<double>(top, right) - integral_.at<double>(bottom, left) +
         integral_.at<double>(top, left);
}

double ColourMap::Excess(const Box2& box_px) const {
  const Eigen::Vector2d center = scale_ * box_px.center_px();
  // At least a pixel.
  const Eigen::Vector2d size = (scale_ * box_px.size_px()).cwiseMax(1.0);
  const double inside = Sum(Box2::FromCenter(center, size));
  const double with_around = Sum(Box2::FromCenter(center, 2.0 * size));
  return (inside - (with_around - inside) / 3.0) / std::sqrt(size.prod());
}

std::vector<Eigen::Vector2d> LikelyPlaces(
    const ColourMap& colours,
    std::span<const Eigen::Vector2d> places_px,
    const BoxAt& box_at,
    const std::function<Eigen::Vector2d(const Box2&)>& step_of,
    std::size_t most) {
  std::vector<Likely> all;
  all.reserve(places_px.size());
  for (const Eigen::Vector2d& place_px : places_px) {
    const auto box = box_at(place_px);
    if (!box || !box->min_px.allFinite() || !box->max_px.allFinite()) continue;
    const Eigen::Vector2d part_px = kPart * step_of(*box);
    Likely best{-1.0, place_px, 0.5 * box->size_px()};
    for (int j = -1; j <= 1; ++j) {
      for (int i = -1; i <= 1; ++i) {
        const Eigen::Vector2d center_px =
            place_px + part_px.cwiseProduct(Eigen::Vector2d(i, j));
        const double excess =
            colours.Excess(Box2::FromCenter(center_px, box->size_px()));
        if (excess > best.excess) {
          best.excess = excess;
          best.center_px = center_px;
        }
      }
    }
    all.push_back(best);
  }
  std::stable_sort(all.begin(), all.end(), [](const auto& a, const auto& b) {
    return a.excess > b.excess;
  });
  std::vector<Likely> chosen;
  for (const Likely& one : all) {
    if (chosen.size() == most || !(one.excess > 0.0)) break;
    const bool is_taken = std::any_of(
        chosen.begin(), chosen.end(), [&one](const Likely& likelier) {
          return ((one.center_px - likelier.center_px).cwiseAbs().array() <
                  likelier.half_px.array())
              .all();
        });
    if (!is_taken) chosen.push_back(one);
  }
  std::vector<Eigen::Vector2d> result;
  for (const Likely& one : chosen) result.push_back(one.center_px);
  return result;
}

}  // namespace groundlock::tracking
