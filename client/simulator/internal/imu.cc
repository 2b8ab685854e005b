// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/imu.h"

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/core.hpp>

#include "absl/strings/str_format.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector3d;
using geometry::Rigid3;

constexpr int kRate_Hz = 200;
// EuRoC's unit, an Analog Devices ADIS16448, as its sensor.yaml states it.
constexpr double kGyroscopeNoise = 1.6968e-4;   // rad/s/sqrt(Hz)
constexpr double kGyroscopeWalk = 1.9393e-5;    // rad/s^2/sqrt(Hz)
constexpr double kAccelerometerNoise = 2.0e-3;  // m/s^2/sqrt(Hz)
constexpr double kAccelerometerWalk = 3.0e-3;   // m/s^3/sqrt(Hz)
// Its zeros are off by up to 0.08 rad/s and 0.6 m/s^2 in EuRoC's flights.
constexpr double kGyroscopeBias_rad_s = 0.05;
constexpr double kAccelerometerBias_m_s2 = 0.3;
constexpr double kGravity_m_s2 = 9.81;

Eigen::Quaterniond ImuFromCamera() {
  Eigen::Matrix3d level;  // camera: x right, y down, z forward
  level << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const Eigen::AngleAxisd tilt(0.06, Vector3d(0.5, -0.7, 0.5).normalized());
  return Eigen::Quaterniond(tilt) * Eigen::Quaterniond(level);
}

class Noise {
 public:
  explicit Noise(std::uint64_t seed) : random_(seed) {}
  Vector3d Draw(double sigma) {
    return {random_.gaussian(sigma),
            random_.gaussian(sigma),
            random_.gaussian(sigma)};
  }

 private:
  cv::RNG random_;
};

}  // namespace

std::string ImuCsv(const std::function<Rigid3(double t_s)>& world_from_camera,
                   double duration_s,
                   std::uint64_t seed) {
  std::string csv =
      "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],"
      "w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],"
      "a_RS_S_z [m s^-2]\n";
  const Eigen::Quaterniond imu_from_camera = ImuFromCamera();
  const double step_s = 1.0 / kRate_Hz;
  Noise noise(seed);
  Vector3d gyroscope_bias = noise.Draw(kGyroscopeBias_rad_s);
  Vector3d accelerometer_bias = noise.Draw(kAccelerometerBias_m_s2);
  const int count = static_cast<int>(std::ceil(duration_s * kRate_Hz)) + 2;
  for (int i = 0; i < count; ++i) {
    const double t_s = i * step_s;
    const Rigid3 before = world_from_camera(t_s - 0.5 * step_s);
    const Rigid3 now = world_from_camera(t_s);
    const Rigid3 after = world_from_camera(t_s + 0.5 * step_s);
    // The unit averages over the time between two samples.
    const Vector3d rate =
        imu_from_camera * (geometry::RotationVector(
                               before.rotation.conjugate() * after.rotation) /
                           step_s);
    const Vector3d acceleration_world =
        (before.translation - 2.0 * now.translation + after.translation) /
        (0.25 * step_s * step_s);
    const Vector3d force =
        imu_from_camera *
        (now.rotation.conjugate() *
         (acceleration_world + kGravity_m_s2 * Vector3d::UnitZ()));
    const Vector3d measured_rate =
        rate + gyroscope_bias +
        noise.Draw(kGyroscopeNoise * std::sqrt(1.0 * kRate_Hz));
    const Vector3d measured_force =
        force + accelerometer_bias +
        noise.Draw(kAccelerometerNoise * std::sqrt(1.0 * kRate_Hz));
    absl::StrAppendFormat(&csv,
                          "%d,%.9f,%.9f,%.9f,%.9f,%.9f,%.9f\n",
                          1'000'000'000LL / kRate_Hz * i,
                          measured_rate.x(),
                          measured_rate.y(),
                          measured_rate.z(),
                          measured_force.x(),
                          measured_force.y(),
                          measured_force.z());
    gyroscope_bias += noise.Draw(kGyroscopeWalk * std::sqrt(step_s));
    accelerometer_bias += noise.Draw(kAccelerometerWalk * std::sqrt(step_s));
  }
  return csv;
}

std::string ImuJson() {
  const Eigen::Quaterniond q = ImuFromCamera();
  return absl::StrFormat(
      "{\"imu_from_camera_wxyz\":[%.17g,%.17g,%.17g,%.17g],"
      "\"gyroscope_noise_rad_s_sqrt_hz\":%.10g,"
      "\"gyroscope_walk_rad_s2_sqrt_hz\":%.10g,"
      "\"gyroscope_bias_rad_s\":%.10g}\n",
      q.w(),
      q.x(),
      q.y(),
      q.z(),
      kGyroscopeNoise,
      kGyroscopeWalk,
      kGyroscopeBias_rad_s);
}

}  // namespace groundlock::simulator
