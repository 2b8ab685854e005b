// SPDX-License-Identifier: Apache-2.0
// How a target moves on the ground while it is seen and while it is not.
#ifndef GROUNDLOCK_SERVER_MOTION_MOTION_PREDICTOR_H_
#define GROUNDLOCK_SERVER_MOTION_MOTION_PREDICTOR_H_

#include <Eigen/Core>
#include <chrono>
#include <memory>
#include <optional>
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
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Identity();
};

struct GroundMeasurement {
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance_m2 = Eigen::Matrix2d::Identity();
  // The thesis observes velocity too (H = [I 0 0; 0 I 0]). Give it only if it
  // was measured apart from the positions: their differences tell the filter
  // nothing that the positions have not told it.
  std::optional<Eigen::Vector2d> velocity_m_s;
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Identity();
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
  // Moves the position alone, for when a better model of the target's shape
  // puts its centre elsewhere.
  virtual void Shift(const Eigen::Vector2d& offset_m) = 0;
};

struct MotionOptions {
  std::string name = "constant-acceleration";
  // Typical size of the target. Noise and initial uncertainty are proportional
  // to it: small things make small moves, and a map without scale has no metres
  // to state them in.
  double target_size_m = 1.0;
  // Spectral density of the white jerk, size^2 / s^5. A car of 1 m on a bend of
  // 1 m radius at 1.5 m/s turns its 2 m/s^2 of lateral acceleration within
  // about a second: (3 m/s^3)^2 over 0.5 s.
  double jerk_density = 4.0;
  double initial_speed_sigma = 2.0;         // sizes / s
  double initial_acceleration_sigma = 1.0;  // sizes / s^2
  // A step without a measurement, or one longer than this, begins "unseen" ...
  double unseen_after_s = 0.5;
  // ... and then the acceleration dies away with this time constant (it is the
  // worst-known part of the state and acts with the square of time), ...
  double unseen_acceleration_decay_s = 0.3;
  // ... the velocity is kept for this long, then dies away with this time
  // constant: a prediction never leads farther than speed * (hold + decay).
  double unseen_velocity_hold_s = 3.0;
  double unseen_velocity_decay_s = 2.0;
  // Squared Mahalanobis distance (chi-square, 2 degrees, 99 %) of the velocity
  // with which the target becomes unseen. If its mean over the last
  // `steady_velocity_s`, each estimate by its information, is farther from zero
  // and the velocity no farther from that mean, the target goes on with the
  // mean. If the mean is not, its way of up to three seconds, at least
  // `steady_velocity_s` of them, takes its place if that is and goes with where
  // it was since better than having stood does. Else, if the velocity is no
  // farther from zero, it is taken to stand.
  double standing_gate = 9.21;
  double steady_velocity_s = 0.5;
  absl::Status Validate() const;
};

// Names: "constant-acceleration" (Robinson 2014, §3.7).
absl::StatusOr<std::unique_ptr<MotionPredictor>> CreateMotionPredictor(
    const MotionOptions& options);
std::vector<std::string> MotionPredictorNames();

}  // namespace groundlock::motion

#endif  // GROUNDLOCK_SERVER_MOTION_MOTION_PREDICTOR_H_
