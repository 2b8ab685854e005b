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
#include "map_store/base/state_stream.h"

namespace groundlock::motion {

// On the ground, in two axes spanning it: metres, metres per second.
struct GroundState {
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d velocity_m_s = Eigen::Vector2d::Zero();
  double turn_rad_s = 0.0;  // anticlockwise, as seen from above the axes
  double stands = 0.0;      // probability that it does
  Eigen::Matrix2d position_covariance_m2 = Eigen::Matrix2d::Identity();
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Identity();
};

struct GroundMeasurement {
  Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance_m2 = Eigen::Matrix2d::Identity();
  // Only if it was measured apart from the positions: their differences tell
  // the filter nothing that the positions have not told it.
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
  // How surprising it is to find the target at `position_m`, which was seen as
  // well as `covariance_m2` says: minus twice the logarithm of the density
  // there, over that of a Gaussian of the state's mean and covariance in its
  // middle, and at least 0. Of one Gaussian that is the squared Mahalanobis
  // distance; what may have started has a longer tail.
  virtual double Surprise(const Eigen::Vector2d& position_m,
                          const Eigen::Matrix2d& covariance_m2) const = 0;
  // Moves the position alone, for when a better model of the target's shape
  // puts its centre elsewhere.
  virtual void Shift(const Eigen::Vector2d& offset_m) = 0;

  // All that it knows as plain data, and the size of its target. One that was
  // made with the same options, of a target of any size, goes on from there;
  // where the reader fails it is of no use any more.
  virtual void SaveState(base::StateWriter& writer) const = 0;
  virtual void RestoreState(base::StateReader& reader) = 0;
};

struct MotionOptions {
  std::string name = "interacting-models";
  // Typical size of the target. Speeds and noise are proportional to it: small
  // things make small moves, and a map without scale has no metres to state
  // them in.
  double target_size_m = 1.0;
  // Of a target of which only the place is known (1 sigma, sizes / s), and of
  // one that stood and starts.
  double speed_sigma = 2.0;
  double start_speed_sigma = 0.5;
  // Of the turn rate of what moves, and the time constant with which it dies
  // away: a lateral acceleration of 1 size / s^2 at 1.4 sizes / s, and a bend.
  double turn_sigma_rad_s = 0.7;
  double turn_time_s = 5.0;
  // Spectral densities of the white acceleration, size^2 / s^3: what goes on
  // steadily changes its speed by 0.14 sizes / s within a second, what
  // manoeuvres by 1. And of what stands the place seems to wander (size^2 / s),
  // by 3 % of its size within a second, as other sides of it come into view.
  double steady_density = 0.02;
  double manoeuvre_density = 1.0;
  double standing_density = 1e-3;
  // Mean times, in seconds, for which a target stands, goes on steadily (until
  // it manoeuvres, or has stopped: in the urban cycle of UN ECE Regulation 83
  // there are 45 s of driving for each stop) and manoeuvres (until it goes on
  // steadily, or stands).
  double stands_s = 5.0;
  double steady_s = 5.0;
  double steady_until_stop_s = 45.0;
  double manoeuvre_s = 1.0;
  double manoeuvre_until_stop_s = 3.0;
  absl::Status Validate() const;
};

// Names: "interacting-models" (Blom & Bar-Shalom 1988).
absl::StatusOr<std::unique_ptr<MotionPredictor>> CreateMotionPredictor(
    const MotionOptions& options);
std::vector<std::string> MotionPredictorNames();

}  // namespace groundlock::motion

#endif  // GROUNDLOCK_SERVER_MOTION_MOTION_PREDICTOR_H_
