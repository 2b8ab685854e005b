// SPDX-License-Identifier: Apache-2.0
// Whether what a 2D tracker found is what it follows.
#ifndef GROUNDLOCK_SERVER_TRACKING_ASSOCIATION_H_
#define GROUNDLOCK_SERVER_TRACKING_ASSOCIATION_H_

namespace groundlock::tracking {

// A detection farther from the prediction than this (squared Mahalanobis
// distance; chi-square, 2 degrees, 99.9 %) is another thing.
inline constexpr double kGate = 13.8;

// How far from its prediction something was found.
struct Innovation {
  // Squared Mahalanobis distance, 2 dimensions.
  double surprise = 0.0;
  // Square root of the determinant of the innovation's covariance.
  double sigma_px2 = 1.0;
};

// The probability that the found is the predicted, which looks like it with
// probability `looks`: the target lies about its prediction as the innovation's
// covariance says, whatever else is taken for it anywhere within the tracker's
// reach (an ellipse of so many square pixels). Never more than `looks`, which
// was fitted to targets that are followed: a prediction that holds is no news.
// Thread-safe.
// Source: Bar-Shalom, Daum, Huang 2009, "The probabilistic data association
// filter", the association probabilities, where there is always one measurement
// (docs/method.md, "Looks and prediction together").
double AssociationProbability(double looks,
                              const Innovation& innovation,
                              double reach_px2);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_ASSOCIATION_H_
