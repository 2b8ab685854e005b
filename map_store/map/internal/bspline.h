// SPDX-License-Identifier: Apache-2.0
// Quadratic B-splines over knots at the whole numbers.
#ifndef GROUNDLOCK_MAP_STORE_MAP_INTERNAL_BSPLINE_H_
#define GROUNDLOCK_MAP_STORE_MAP_INTERNAL_BSPLINE_H_

#include <array>
#include <cmath>
#include <cstddef>

namespace groundlock::map::internal {

// The three quadratic B-splines that are not zero at `t` knots from the first
// one's middle, and the first one's index.
struct Basis {
  std::ptrdiff_t first = 0;
  std::array<double, 3> value{};
  std::array<double, 3> slope{};  // per knot
};

inline Basis BasisAt(double t) {
  const double middle = std::floor(t + 0.5);
  const double x = t - middle;  // in [-0.5, 0.5)
  Basis basis;
  basis.first = static_cast<std::ptrdiff_t>(middle) - 1;
  basis.value = {
      0.5 * (0.5 - x) * (0.5 - x), 0.75 - x * x, 0.5 * (0.5 + x) * (0.5 + x)};
  basis.slope = {x - 0.5, -2.0 * x, x + 0.5};
  return basis;
}

}  // namespace groundlock::map::internal

#endif  // GROUNDLOCK_MAP_STORE_MAP_INTERNAL_BSPLINE_H_
