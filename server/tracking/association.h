// SPDX-License-Identifier: Apache-2.0
// Whether what a 2D tracker found is what it follows.
#ifndef GROUNDLOCK_SERVER_TRACKING_ASSOCIATION_H_
#define GROUNDLOCK_SERVER_TRACKING_ASSOCIATION_H_

#include <Eigen/Core>
#include <optional>

#include "map_store/geometry/box.h"

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

// The density, per square pixel, of finding the predicted there.
// Thread-safe.
double Likelihood(const Innovation& innovation);

// The density, per square pixel, of finding at `found_px` a target that was
// seen in `seen_px` in this frame or the one before: of two targets that look
// alike, what is found is the one that it is likelier of, and one detection is
// never both (joint association: Fortmann, Bar-Shalom, Scheffe 1983, "Sonar
// tracking of multiple targets using joint probabilistic data association",
// the feasible events). Thread-safe.
double SeenLikelihood(const geometry::Box2& seen_px,
                      const Eigen::Vector2d& found_px);

// Where something was found, against where motion in the image puts the target.
struct MotionEvidence {
  Eigen::Vector2d found_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d predicted_px = Eigen::Vector2d::Zero();
  double sigma_px = 1.0;  // of the prediction, either axis
  // The place of the background where the target was last seen; nullopt: not
  // known.
  std::optional<Eigen::Vector2d> left_behind_px;
  double side_px = 1.0;  // of the target
};

// How much likelier it is, at most 1, to find the target there than what stays
// behind when the target goes on: an occluder that stood before it, or the
// background in its box, which a tracker that learns takes for it. Of a target
// that moves too little or too unsteadily for the two to be told apart it is 1.
// Both have heavy tails (Student's t with 4 degrees of freedom): a target may
// brake, a tracker slide. Thread-safe.
double MotionRatio(const MotionEvidence& motion);
// The probability `looks`, whose odds change by `ratio`.
double Associate(double looks, double ratio);
// Finite for any probability.
double LogOdds(double probability);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_ASSOCIATION_H_
