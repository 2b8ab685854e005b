// SPDX-License-Identifier: Apache-2.0
#include "server/target/internal/colour_outline.h"

#include <cmath>

namespace groundlock::target::internal {
namespace {

using geometry::Box2;

// So many samples say what one of its own would: neighbours are alike, and
// histograms of earlier frames do not hold quite. With 40 small targets on
// water gain half as much.
constexpr double kSamplesAsOne = 20.0;
// How far the likeliest box is sought, as a standard deviation: a tenth of the
// target's sides.
constexpr double kNear = 0.1;
// By how much the tracker's box goes astray from frame to frame: centre, size,
// aspect. Twice as much for the centre costs what colours do not tell well.
const Eigen::Vector4d kWalk(0.01, 0.01, 0.005, 0.002);
// No frame corrects more than half of what is seen, nor what is farther off.
constexpr double kMostGain = 0.5;
constexpr double kMostSurprise = 0.1;
// Means over 50 and over 20 learnt frames.
constexpr double kUsualRate = 0.02;
constexpr double kVarianceRate = 0.05;

}  // namespace

Box2 ColourOutline::Moved(const Box2& box, const Offset& offset) {
  const Eigen::Vector2d size = box.size_px();
  return Box2::FromCenter(
      box.center_px() + offset.head<2>().cwiseProduct(size),
      size.cwiseProduct(Eigen::Vector2d(std::exp(offset[2] + offset[3]),
                                        std::exp(offset[2] - offset[3]))));
}

ColourOutline::Offset ColourOutline::LikeliestOffset(
    const ColourHistogram& colours, const Box2& box_samples, Offset& variance) {
  const auto evidence = [&](const Offset& offset) {
    return colours.BoxEvidence(Moved(box_samples, offset)) / kSamplesAsOne;
  };
  // Size and aspect together are those of two sides.
  const auto score = [&](const Offset& offset) {
    return evidence(offset) - (0.5 * offset.head<2>().squaredNorm() +
                               offset.tail<2>().squaredNorm()) /
                                  (kNear * kNear);
  };
  // Axis by axis, in ever smaller steps: the evidence has corners, and is read
  // from an integral image.
  Offset best = Offset::Zero();
  double best_score = score(best);
  for (const double step : {0.05, 0.025, 0.01, 0.005}) {
    constexpr int kRounds = 4;
    bool improved = true;
    for (int round = 0; round < kRounds && improved; ++round) {
      improved = false;
      for (int axis = 0; axis < 4; ++axis) {
        for (const double by : {-step, step}) {
          Offset tried = best;
          tried[axis] += by;
          const double of_tried = score(tried);
          if (of_tried <= best_score) continue;
          best = tried;
          best_score = of_tried;
          improved = true;
        }
      }
    }
  }
  constexpr double kHalf = 0.05;
  const double at_best = evidence(best);
  for (int axis = 0; axis < 4; ++axis) {
    Offset less = best;
    Offset more = best;
    less[axis] -= kHalf;
    more[axis] += kHalf;
    const double curvature =
        (2.0 * at_best - evidence(less) - evidence(more)) / (kHalf * kHalf);
    variance[axis] = curvature > 1.0 ? 1.0 / curvature : 1.0;
  }
  return best;
}

void ColourOutline::Start(const ColourHistogram& colours,
                          const Box2& box_samples) {
  Offset unused;
  usual_ = LikeliestOffset(colours, box_samples, unused);
  variance_.setConstant(0.25 * kNear * kNear);
  surprise_.setZero();
}

Box2 ColourOutline::Correct(const ColourHistogram& colours,
                            const Box2& box_samples) {
  Offset variance;
  surprise_ = LikeliestOffset(colours, box_samples, variance) - usual_;
  // Of a random walk that is measured in each frame the gain is nearly the
  // ratio of the step's standard deviation to the measurement's.
  const Offset gain =
      kWalk.cwiseQuotient(variance.cwiseMax(variance_).cwiseSqrt())
          .cwiseMin(kMostGain);
  return Moved(box_samples,
               gain.cwiseProduct(
                   surprise_.cwiseMax(-kMostSurprise).cwiseMin(kMostSurprise)));
}

void ColourOutline::Learn() {
  usual_ += kUsualRate * surprise_;
  variance_ += kVarianceRate * (surprise_.cwiseAbs2() - variance_);
  surprise_.setZero();
}

}  // namespace groundlock::target::internal
