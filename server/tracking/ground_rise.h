// SPDX-License-Identifier: Apache-2.0
// By how much a body stands higher than the ground is said to be.
#ifndef GROUNDLOCK_SERVER_TRACKING_GROUND_RISE_H_
#define GROUNDLOCK_SERVER_TRACKING_GROUND_RISE_H_

#include <cmath>

namespace groundlock::tracking {

// Where ground varies, its height is known to a few centimetres only. That is
// half a metre of distance where it is seen at a grazing angle, and a body that
// is known looks larger or smaller than it would there. So the error is a
// state: a first-order Gauss-Markov process over the way that the body goes
// (Gelb 1974, "Applied optimal estimation", section 3.8), about zero, as large
// as the surface says. Metres or map units along the vertical. Not thread-safe.
struct GroundRise {
  double mean_m = 0.0;
  double variance_m2 = 0.0;

  //   lengths  how far it went, in lengths over which the error becomes another
  //     one.
  //   height_sigma_m  1 sigma of the ground's height there.
  void GoOn(double lengths, double height_sigma_m) {
    const double stays = std::exp(-lengths);
    mean_m *= stays;
    variance_m2 = stays * stays * variance_m2 +
                  (1.0 - stays * stays) * height_sigma_m * height_sigma_m;
  }
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_GROUND_RISE_H_
