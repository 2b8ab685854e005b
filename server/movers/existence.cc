// SPDX-License-Identifier: Apache-2.0
#include "server/movers/existence.h"

#include <algorithm>
#include <cmath>

namespace groundlock::movers {
namespace {

// The paper's update with delta = P_D P_G (1 - the sum of likelihood ratios).
double Update(double existence, double delta) {
  return (1.0 - delta) * existence / (1.0 - delta * existence);
}

}  // namespace

double PredictExistence(const ExistenceModel& model,
                        double existence,
                        double step_s) {
  return existence * std::exp(-step_s / model.lifetime_s);
}

double NotFound(const ExistenceModel& model, double existence) {
  return Update(existence, model.detection);
}

double Found(const ExistenceModel& model,
             double existence,
             double likelihood_ratio) {
  const double ratio =
      std::clamp(likelihood_ratio, 0.0, model.max_likelihood_ratio);
  return Update(existence, model.detection * (1.0 - ratio));
}

}  // namespace groundlock::movers
