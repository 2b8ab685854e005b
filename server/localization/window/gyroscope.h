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

// What the gyroscope says of the way from one frame to another, with the bias
// that was assumed taken off; along the camera's axes.
struct GyroscopeTurn {
  Eigen::Quaterniond before_from_now = Eigen::Quaterniond::Identity();
  // A bias that is db more than assumed makes the turn
  // before_from_now * Exp(-bias_jacobian_s * db).
  Eigen::Matrix3d bias_jacobian_s = Eigen::Matrix3d::Zero();
  Eigen::Vector3d rate_now_rad_s = Eigen::Vector3d::Zero();
  double duration_s = 0.0;
  double sample_period_s = 0.0;
};

// The samples that are not used up. Not thread-safe.
// Source: Forster, Carlone, Dellaert & Scaramuzza 2017, "On-manifold
// preintegration for real-time visual-inertial odometry", §V, eq. 35 and 44.
class Gyroscope {
 public:
  explicit Gyroscope(const ImuModel& imu) : imu_(imu) {}

  // Samples that are no newer than those there are, are passed over.
  void Add(std::span<const InertialSample> samples);
  // From one time to a later one; the rate is linear between samples. nullopt
  // where samples are missing.
  //   bias_rad_s  along the camera's axes.
  std::optional<GyroscopeTurn> Between(std::chrono::nanoseconds before,
                                       std::chrono::nanoseconds now,
                                       const Eigen::Vector3d& bias_rad_s) const;
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
