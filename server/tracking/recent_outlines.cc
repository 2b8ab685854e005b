// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/recent_outlines.h"

#include <algorithm>
#include <vector>

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using ground::SeenOutline;

// Silhouettes of a second err alike (kSilhouetteTime_s).
constexpr std::chrono::milliseconds kTogether{1000};

// Left, upper, right, lower.
Eigen::Vector4d OutFrom(const Eigen::Vector2d& center_px, const Box2& box_px) {
  Eigen::Vector4d out_px;
  out_px << center_px - box_px.min_px, box_px.max_px - center_px;
  return out_px;
}

Box2 BoxAbout(const Eigen::Vector2d& center_px, const Eigen::Vector4d& out_px) {
  return {center_px - out_px.head<2>(), center_px + out_px.tail<2>()};
}

}  // namespace

SeenOutline RecentOutlines::Add(const SeenOutline& outline,
                                const Eigen::Vector2d& center_px,
                                double px_per_m,
                                std::chrono::nanoseconds time) {
  while (!recent_.empty() && time - recent_.front().time >= kTogether) {
    recent_.pop_front();
  }
  recent_.push_back({OutFrom(center_px, outline.sure_px) / px_per_m,
                     OutFrom(center_px, outline.possible_px) / px_per_m,
                     px_per_m,
                     time});
  const std::size_t count = recent_.size();
  // Of an even number, the one that bounds less.
  const auto median = [&](Eigen::Vector4d Recent::*edges, int edge, bool less) {
    std::vector<double> values;
    for (const Recent& recent : recent_) {
      values.push_back((recent.*edges)[edge]);
    }
    const auto middle =
        values.begin() +
        static_cast<std::ptrdiff_t>(less ? (count - 1) / 2 : count / 2);
    std::nth_element(values.begin(), middle, values.end());
    return *middle;
  };
  Recent steady = recent_.back();
  for (int edge = 0; edge < 4; ++edge) {
    if (outline.is_seen[edge]) continue;
    steady.sure_m[edge] =
        std::min(steady.sure_m[edge], median(&Recent::sure_m, edge, true));
    steady.possible_m[edge] = std::max(
        steady.possible_m[edge], median(&Recent::possible_m, edge, false));
  }
  SeenOutline result = outline;
  result.sure_px = BoxAbout(center_px, px_per_m * steady.sure_m);
  result.possible_px = BoxAbout(center_px, px_per_m * steady.possible_m);
  return result;
}

void RecentOutlines::Shift(const Eigen::Vector2d& by_px) {
  for (Recent& recent : recent_) {
    Eigen::Vector4d out_m;
    out_m << by_px, -by_px;
    out_m /= recent_.back().px_per_m;
    recent.sure_m += out_m;
    recent.possible_m += out_m;
  }
}

}  // namespace groundlock::tracking
