// SPDX-License-Identifier: Apache-2.0
// Adjusts poses and landmarks of a map to its observations; lenses stay.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_BUNDLE_ADJUSTMENT_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_BUNDLE_ADJUSTMENT_H_

#include <functional>
#include <vector>

#include "absl/status/status.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// What is known of a view's pose beforehand.
struct PosePrior {
  bool is_fixed = false;
  // Else: how far it may be off where it is now (1 sigma); 0 = nothing known.
  double sigma_m = 0.0;
  double sigma_rad = 0.0;
};

struct AdjustmentOptions {
  double sigma_px = 1.0;   // of an observation
  double robust_px = 2.0;  // Cauchy's scale
  int max_iterations = 30;
  int threads = 1;
  // Per landmark; empty = all move.
  std::vector<bool> landmark_is_fixed;
  std::function<bool()> is_cancelled;
};

// priors: one per view. kCancelled; kInternal if no solution was usable.
// Source: Triggs et al. 1999; Ceres Solver's documentation.
absl::Status AdjustMap(std::span<const PosePrior> priors,
                       const AdjustmentOptions& options,
                       map::MapData* data);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_BUNDLE_ADJUSTMENT_H_
