// SPDX-License-Identifier: Apache-2.0
// Roots of the polynomials that lens distortion is made of.
#ifndef GROUNDLOCK_MAP_STORE_GEOMETRY_INTERNAL_POLYNOMIAL_H_
#define GROUNDLOCK_MAP_STORE_GEOMETRY_INTERNAL_POLYNOMIAL_H_

#include <array>
#include <optional>
#include <span>

namespace groundlock::geometry::internal {

// c[0] + c[1] x + c[2] x^2 + ...
double EvaluatePolynomial(std::span<const double> c, double x);

// The smallest x in (0, upper) where the polynomial, positive at 0, becomes
// negative; nullopt if it does not. A root that it only touches is none.
std::optional<double> FirstSignChange(std::span<const double> c, double upper);

// Solves x (1 + c[1] x^2 + c[2] x^4 + ...) = value, value >= 0, for x in
// [0, high] (high may be infinite), where the left side increases. nullopt if
// it does not reach `value`. Newton's method, kept inside a shrinking bracket.
std::optional<double> SolveIncreasing(const std::array<double, 5>& c,
                                      double high,
                                      double value);

}  // namespace groundlock::geometry::internal

#endif  // GROUNDLOCK_MAP_STORE_GEOMETRY_INTERNAL_POLYNOMIAL_H_
