// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/internal/polynomial.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace groundlock::geometry::internal {
namespace {

// A root between low and high, where the polynomial has different signs.
double Bisect(std::span<const double> c, double low, double high) {
  const bool low_positive = EvaluatePolynomial(c, low) > 0.0;
  for (;;) {
    const double middle = 0.5 * (low + high);
    if (middle <= low || middle >= high) return low;
    if ((EvaluatePolynomial(c, middle) > 0.0) == low_positive) {
      low = middle;
    } else {
      high = middle;
    }
  }
}

// All sign changes in (0, upper), rising: between two neighbouring extrema the
// polynomial is monotone, and the extrema are sign changes of the derivative.
std::vector<double> SignChanges(std::span<const double> c, double upper) {
  if (c.size() < 2) return {};
  std::vector<double> derivative(c.size() - 1);
  for (std::size_t i = 1; i < c.size(); ++i) {
    derivative[i - 1] = static_cast<double>(i) * c[i];
  }
  std::vector<double> ends = SignChanges(derivative, upper);
  ends.push_back(upper);
  std::vector<double> changes;
  double low = 0.0;
  for (const double high : ends) {
    if ((EvaluatePolynomial(c, low) > 0.0) !=
        (EvaluatePolynomial(c, high) > 0.0)) {
      changes.push_back(Bisect(c, low, high));
    }
    low = high;
  }
  return changes;
}

}  // namespace

double EvaluatePolynomial(std::span<const double> c, double x) {
  double value = 0.0;
  for (std::size_t i = c.size(); i-- > 0;) value = value * x + c[i];
  return value;
}

std::optional<double> FirstSignChange(std::span<const double> c, double upper) {
  const std::vector<double> changes = SignChanges(c, upper);
  if (changes.empty()) return std::nullopt;
  return changes.front();
}

std::optional<double> SolveIncreasing(const std::array<double, 5>& c,
                                      double high,
                                      double value) {
  const auto function = [&c](double x) {
    return x * EvaluatePolynomial(c, x * x);
  };
  std::array<double, 5> derivative{};
  for (std::size_t i = 0; i < c.size(); ++i) {
    derivative.at(i) = static_cast<double>(2 * i + 1) * c.at(i);
  }
  if (std::isinf(high)) {
    high = std::max(1.0, value);
    for (int i = 0; i < 64 && function(high) < value; ++i) high *= 2.0;
  }
  if (!(function(high) >= value)) return std::nullopt;
  double low = 0.0;
  double x = std::min(value, high);
  for (int i = 0; i < 200; ++i) {
    const double error = function(x) - value;
    if (error == 0.0) return x;
    (error > 0.0 ? high : low) = x;
    const double slope = EvaluatePolynomial(derivative, x * x);
    double next = x - error / slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    // The last bits: neither Newton nor bisection can move any more.
    if (std::abs(next - x) <= 1e-16 * std::abs(x) || next <= low ||
        next >= high) {
      return next;
    }
    x = next;
  }
  return x;
}

}  // namespace groundlock::geometry::internal
