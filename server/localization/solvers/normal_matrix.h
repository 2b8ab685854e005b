// SPDX-License-Identifier: Apache-2.0
// What the refinements by iteratively reweighted Gauss-Newton share.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_NORMAL_MATRIX_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_NORMAL_MATRIX_H_

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <optional>

namespace groundlock::localization {

// Tukey's biweight; 0 beyond the gate.
inline double TukeyWeight(double squared_error, double gate) {
  const double u = squared_error / (gate * gate);
  return u < 1.0 ? (1.0 - u) * (1.0 - u) : 0.0;
}

// Inverse of a normal matrix; nullopt if it leaves a direction open. Metres and
// radians differ in size by orders of magnitude, so the diagonal is scaled
// first: the pivots then compare, whatever the map's unit. Thread-safe.
template <int kSize>
std::optional<Eigen::Matrix<double, kSize, kSize>> InvertNormalMatrix(
    const Eigen::Matrix<double, kSize, kSize>& H) {
  using Matrix = Eigen::Matrix<double, kSize, kSize>;
  // Of the matrix scaled to a unit diagonal: pivots below this are rounding,
  // not information. The weakest geometry of use, a narrow strip of a far wall,
  // leaves 1e-6.
  constexpr double kMinPivot = 1e-11;
  if (!(H.diagonal().minCoeff() > 0.0) || !H.allFinite()) return std::nullopt;
  const Eigen::Matrix<double, kSize, 1> scale =
      H.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LDLT<Matrix> solver(scale.asDiagonal() * H * scale.asDiagonal());
  if (solver.info() != Eigen::Success ||
      !(solver.vectorD().minCoeff() > kMinPivot)) {
    return std::nullopt;
  }
  const Matrix inverse = scale.asDiagonal() * solver.solve(Matrix::Identity()) *
                         scale.asDiagonal();
  if (!inverse.allFinite()) return std::nullopt;
  return inverse;
}

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SOLVERS_NORMAL_MATRIX_H_
