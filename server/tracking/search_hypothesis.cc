// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/search_hypothesis.h"

#include <Eigen/Cholesky>

#include "server/tracking/association.h"

namespace groundlock::tracking {
namespace {

// Frames in a row must together leave no more doubt than this. Two frames of
// 0.91, three of 0.83.
constexpr double kError = 0.01;
// What is less sure gets no more looks than this: seven of 0.66 would do. Not
// measured apart from the runs in docs/method.md.
constexpr int kMostUnsureLooks = 8;

bool HasMoved(const GroundSighting& before, const GroundSighting& now) {
  const Eigen::Vector2d way_m = now.place_m - before.place_m;
  const Eigen::Matrix2d covariance_m2 =
      now.covariance_m2 + before.covariance_m2;
  return way_m.dot(covariance_m2.ldlt().solve(way_m)) > kGate;
}

}  // namespace

std::optional<SearchHypothesis> SearchHypothesis::Begin(const Sight& sight,
                                                        const Bounds& bounds) {
  SearchHypothesis hypothesis;
  hypothesis.box_px_ = sight.box_px;
  hypothesis.is_sure_ = sight.sureness >= bounds.sure;
  const double sureness =
      hypothesis.is_sure_ ? sight.sureness : sight.least_sureness;
  if (sureness < bounds.threshold) return std::nullopt;
  hypothesis.evidence_ = LogOdds(sureness);
  hypothesis.first_sighting_ = sight.sighting;
  return hypothesis;
}

SearchHypothesis::Verdict SearchHypothesis::See(const Sight& sight,
                                                const Bounds& bounds) {
  is_sure_ = is_sure_ || sight.sureness >= bounds.sure;
  const double sureness = is_sure_ ? sight.sureness : sight.least_sureness;
  if (sureness < bounds.threshold) return Verdict::kRefuted;
  box_px_ = sight.box_px;
  evidence_ += LogOdds(sureness);
  ++looks_;
  has_moved_ = has_moved_ || (first_sighting_ && sight.sighting &&
                              HasMoved(*first_sighting_, *sight.sighting));
  if (evidence_ >= -LogOdds(kError) && (is_sure_ || has_moved_)) {
    return Verdict::kBelieved;
  }
  if (is_sure_ || looks_ < kMostUnsureLooks) return Verdict::kOpen;
  return has_moved_ ? Verdict::kRefuted : Verdict::kStoodStill;
}

}  // namespace groundlock::tracking
