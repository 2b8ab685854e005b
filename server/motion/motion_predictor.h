// SPDX-License-Identifier: Apache-2.0
// How a target moves on the ground while it is seen and while it is not.
#ifndef GROUNDLOCK_SERVER_MOTION_MOTION_PREDICTOR_H_
#define GROUNDLOCK_SERVER_MOTION_MOTION_PREDICTOR_H_

#include <Eigen/Core>
#include <chrono>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::motion {

// On the ground, in two axes spanning it: metres, metres per second.
struct GroundState {
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();
  Eigen::Vector2d acceleration_m_s2 = Eigen::Vector2d::Zero();
  Eigen::Matrix2d position_covariance_m2 = Eigen::Matrix2d::Identity();
};

struct GroundMeasurement {
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance_m2 = Eigen::Matrix2d::Identity();
};

// One per target; not thread-safe. Times are capture times; steps that go
// backwards or stand still predict nothing.
class MotionPredictor {
 public:
  virtual ~MotionPredictor() = default;
  virtual void Initialize(std::chrono::nanoseconds time,
                          const GroundMeasurement& measurement) = 0;
  // Time update to `time`; returns the predicted state.
  virtual GroundState Predict(std::chrono::nanoseconds time) = 0;
  // Measurement update at the time last predicted.
  virtual GroundState Update(const GroundMeasurement& measurement) = 0;
  virtual GroundState state() const = 0;
};

struct MotionOptions {
  std::string name = "constant-acceleration";
  absl::Status Validate() const;
};

// Names: "constant-acceleration" (Robinson 2014, §3.7).
absl::StatusOr<std::unique_ptr<MotionPredictor>> CreateMotionPredictor(
    const MotionOptions& options);
std::vector<std::string> MotionPredictorNames();

}  // namespace groundlock::motion

#endif  // GROUNDLOCK_SERVER_MOTION_MOTION_PREDICTOR_H_
