// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/association.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace groundlock::tracking {
namespace {

constexpr double kFreedom = 4.0;
// What stays behind is found to this share of the target's side.
constexpr double kRestSigma = 0.06;
// From frame to frame the boxes of the 19 flights and sequences that are at
// hand move by 0.02 to 0.31 of their sides, root mean square along either axis,
// 0.14 in the mean.
constexpr double kSeenSigma = 0.14;

// Student's t of two dimensions.
double Density(const Eigen::Vector2d& offset_px, double sigma_px) {
  const double squared = offset_px.squaredNorm() / (sigma_px * sigma_px);
  return std::pow(1.0 + squared / kFreedom, -0.5 * kFreedom - 1.0) /
         (2.0 * std::numbers::pi * sigma_px * sigma_px);
}

}  // namespace

double AssociationProbability(double looks,
                              const Innovation& innovation,
                              double reach_px2) {
  const double places =
      reach_px2 / (2.0 * std::numbers::pi * innovation.sigma_px2);
  if (!(places > 0.0) || !(innovation.surprise >= 0.0)) return looks;
  // Of a Gaussian the share 1 - exp(-places) lies within an ellipse of its own
  // shape of that area: the density there, against an even one's.
  const double ratio = std::min(
      1.0,
      std::exp(-0.5 * innovation.surprise) * places / -std::expm1(-places));
  return Associate(looks, ratio);
}

double Associate(double looks, double ratio) {
  return looks * ratio / (looks * ratio + 1.0 - looks);
}

double Likelihood(const Innovation& innovation) {
  return std::exp(-0.5 * innovation.surprise) /
         (2.0 * std::numbers::pi * innovation.sigma_px2);
}

double SeenLikelihood(const geometry::Box2& seen_px,
                      const Eigen::Vector2d& found_px) {
  const Eigen::Vector2d sigma_px = kSeenSigma * seen_px.size_px();
  return Likelihood({.surprise = (found_px - seen_px.center_px())
                                     .cwiseQuotient(sigma_px)
                                     .squaredNorm(),
                     .sigma_px2 = sigma_px.prod()});
}

double MotionRatio(const MotionEvidence& motion) {
  if (!motion.left_behind_px) return 1.0;
  const double target =
      Density(motion.found_px - motion.predicted_px, motion.sigma_px);
  const double left_behind =
      Density(motion.found_px - *motion.left_behind_px,
              std::max(kRestSigma * motion.side_px, motion.sigma_px));
  if (!(target >= 0.0) || !(left_behind > 0.0)) return 1.0;
  return std::min(1.0, target / left_behind);
}

double LogOdds(double probability) {
  const double p = std::clamp(probability, 1e-6, 1.0 - 1e-6);
  return std::log(p / (1.0 - p));
}

}  // namespace groundlock::tracking
