// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/association.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace groundlock::tracking {

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
  return looks * ratio / (looks * ratio + 1.0 - looks);
}

}  // namespace groundlock::tracking
