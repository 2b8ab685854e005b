// SPDX-License-Identifier: Apache-2.0
// How the camera turned between two frames, as a gyroscope fixed to it says.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_GYROSCOPE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_GYROSCOPE_H_

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <chrono>
#include <cstddef>
#include <deque>
#include <optional>
#include <span>

#include "absl/status/status.h"

namespace groundlock::localization {

// What an inertial measurement unit (IMU) measures, along its own axes.
struct InertialSample {
  std::chrono::nanoseconds time{0};  // of the clock that stamps the frames
  Eigen::Vector3d angular_rate_rad_s = Eigen::Vector3d::Zero();
  // Specific force: at rest it points up, with 9.8 m/s^2.
  Eigen::Vector3d acceleration_m_s2 = Eigen::Vector3d::Zero();
};

// A frame brings at most so many: four seconds at 1 kHz.
inline constexpr std::size_t kMaxInertialSamples = 4'096;

// Times ascend and are not negative, values are finite and within what such
// sensors measure. kInvalidArgument names sample and value.
absl::Status ValidateInertial(std::span<const InertialSample> samples);

// The unit, and how it is fixed to the camera. The defaults are those of a
// phone's (Bosch BMI160, data sheet BST-BMI160-DS000): 0.007 deg/s/sqrt(Hz),
// zero-rate offset 3 deg/s.
struct ImuModel {
  Eigen::Quaterniond imu_from_camera = Eigen::Quaterniond::Identity();
  // White noise of the rate, per axis.
  double gyroscope_noise_rad_s_sqrt_hz = 1.2e-4;
  // How its zero wanders: a random walk; and what is known of it at first.
  double gyroscope_walk_rad_s2_sqrt_hz = 2e-5;
  double gyroscope_bias_rad_s = 0.05;

  absl::Status Validate() const;  // kInvalidArgument names the field
};

// What a gyroscope errs by, along the camera's axes: it measures
// (I + scale) * rate + bias_rad_s. `scale` holds how sensitive its axes are,
// how they lie to each other, and to the camera.
struct GyroscopeErrors {
  Eigen::Vector3d bias_rad_s = Eigen::Vector3d::Zero();
  Eigen::Matrix3d scale = Eigen::Matrix3d::Zero();
};

// What the gyroscope says of the way from one frame to another, with the errors
// that were assumed taken off; along the camera's axes.
struct GyroscopeTurn {
  // Of (bias, scale column by column): 3 + 9.
  using ErrorJacobian = Eigen::Matrix<double, 3, 12>;

  Eigen::Quaterniond before_from_now = Eigen::Quaterniond::Identity();
  // Errors that are de more than assumed make the turn
  // before_from_now * Exp(-error_jacobian * de), to the first order.
  ErrorJacobian error_jacobian = ErrorJacobian::Zero();
  Eigen::Vector3d rate_now_rad_s = Eigen::Vector3d::Zero();
  double duration_s = 0.0;
  double sample_period_s = 0.0;
};

// How the gyroscope's errors show in the rate that it measures while the camera
// turns with `rate_rad_s`.
GyroscopeTurn::ErrorJacobian ErrorJacobianOfRate(
    const Eigen::Vector3d& rate_rad_s);

// The samples that are not used up. Not thread-safe.
// Source: Forster, Carlone, Dellaert & Scaramuzza 2017, "On-manifold
// preintegration for real-time visual-inertial odometry", §V, eq. 35 and 44;
// Rehder, Nikolic, Schneider, Hinzmann & Siegwart 2016, "Extending kalibr:
// calibrating the extrinsics of multiple IMUs and of individual axes", §III-B
// (scale and misalignment as one matrix).
class Gyroscope {
 public:
  explicit Gyroscope(const ImuModel& imu) : imu_(imu) {}

  // Samples that are no newer than those there are, are passed over.
  void Add(std::span<const InertialSample> samples);
  // From one time to a later one; the rate is linear between samples. nullopt
  // where samples are missing.
  std::optional<GyroscopeTurn> Between(std::chrono::nanoseconds before,
                                       std::chrono::nanoseconds now,
                                       const GyroscopeErrors& errors) const;
  // Times before are not asked for any more.
  void ForgetBefore(std::chrono::nanoseconds time);

 private:
  friend struct StateFields;

  struct Rate {
    std::chrono::nanoseconds time{0};
    Eigen::Vector3d rate_rad_s;  // along the camera's axes
  };
  // Between samples, or held where the outermost is not far.
  std::optional<Eigen::Vector3d> RateAt(std::chrono::nanoseconds time) const;

  ImuModel imu_;
  std::deque<Rate> samples_;  // times ascend
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_WINDOW_GYROSCOPE_H_
