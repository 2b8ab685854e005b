// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/ground_relief.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "map_store/map/internal/bspline.h"

namespace groundlock::map {

using Eigen::Vector2d;
using internal::Basis;
using internal::BasisAt;

std::optional<GroundRelief::Height> GroundRelief::At(
    const Vector2d& p_plane) const {
  if (empty()) return std::nullopt;
  const Vector2d t = (p_plane - origin_plane) / step;
  // Also false where a number is none.
  if (!(t.x() >= 0.5 && t.x() < static_cast<double>(columns) - 1.5 &&
        t.y() >= 0.5 && t.y() < static_cast<double>(rows()) - 1.5)) {
    return std::nullopt;
  }
  const Basis x = BasisAt(t.x());
  const Basis y = BasisAt(t.y());
  const auto first = static_cast<std::size_t>(y.first) * columns +
                     static_cast<std::size_t>(x.first);
  Height result;
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t i = 0; i < 3; ++i) {
      const Knot& knot = knots[first + j * columns + i];
      const double coefficient = knot.coefficient;
      result.height += x.value[i] * y.value[j] * coefficient;
      result.slope.x() += x.slope[i] * y.value[j] * coefficient;
      result.slope.y() += x.value[i] * y.slope[j] * coefficient;
    }
  }
  result.slope /= step;
  result.sigma = knots[first + columns + 1].sigma;
  if (!std::isfinite(result.sigma)) return std::nullopt;
  return result;
}

double GroundRelief::Range() const {
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (std::size_t row = 1; row + 1 < rows(); ++row) {
    for (std::size_t column = 1; column + 1 < columns; ++column) {
      const auto known =
          At(origin_plane + step * Vector2d(static_cast<double>(column),
                                            static_cast<double>(row)));
      if (!known) continue;
      low = std::min(low, known->height);
      high = std::max(high, known->height);
    }
  }
  return std::max(0.0, high - low);
}

absl::Status GroundRelief::Validate() const {
  if (empty()) return absl::OkStatus();
  if (knots.size() > kMaxKnots || columns < kMinSide || rows() < kMinSide ||
      columns * rows() != knots.size() || !origin_plane.allFinite() ||
      !(step > 0.0) || !std::isfinite(step)) {
    return absl::InvalidArgumentError("the relief's grid is out of range");
  }
  for (const Knot& knot : knots) {
    if (!std::isfinite(knot.coefficient) || !(knot.sigma >= 0.0F)) {
      return absl::InvalidArgumentError(
          "the relief holds a value out of range");
    }
  }
  return absl::OkStatus();
}

}  // namespace groundlock::map
