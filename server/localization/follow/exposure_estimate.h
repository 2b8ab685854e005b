// SPDX-License-Identifier: Apache-2.0
// For how long the camera's frames are exposed, from how blurred moving things
// are in them.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_EXPOSURE_ESTIMATE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_EXPOSURE_ESTIMATE_H_

#include <Eigen/Core>
#include <array>
#include <opencv2/core/mat.hpp>
#include <span>

#include "server/localization/follow/blurred_patch.h"

namespace groundlock::localization {

// A place seen in two images.
struct MovingPatch {
  PatchPair pair;  // its blurs per second of exposure
  Eigen::Vector2d point = Eigen::Vector2d::Zero();  // in the current image
};

// Tries a few exposure times on patches of each frame that moves, and keeps
// what each one leaves unexplained, older frames counting less: automatic
// exposure changes slowly. Not thread-safe.
class ExposureEstimate {
 public:
  static constexpr double kStep_s = 0.004;
  static constexpr int kSteps = 9;

  // Between the times that were tried; 0 before a frame has told something.
  double seconds() const;

  // Only patches of which the current image is moving much faster than the key
  // image tell: equal blurs look the same, whatever the exposure.
  void Observe(const cv::Mat& key,
               const cv::Mat& current,
               std::span<const MovingPatch> patches);
  // Whether a patch tells.
  static bool Tells(const PatchPair& blurs_per_s);

 private:
  friend struct StateFields;

  std::array<double, kSteps> mismatch_{};
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_EXPOSURE_ESTIMATE_H_
