// SPDX-License-Identifier: Apache-2.0
// What PoseFilter takes in from other sensors than the camera.
#include <limits>
#include <utility>

#include "server/localization/window/pose_filter.h"

namespace groundlock::localization {
namespace {

// Of the rate, what no constant matrix explains (nonlinearity): 0.1 % by the
// data sheet that ImuModel cites.
constexpr double kGyroscopeNonlinearity = 1e-3;
// Of what satellites' signals or a compass err by, a tenth is new in each
// frame. An assumption: fixes of the carrier's phase are better than that, and
// are then believed too little.
constexpr double kSensorNoiseShare = 0.1;

}  // namespace

void PoseFilter::UpdateFromGyroscope(Frame frame, const GyroscopeTurn& turn) {
  const Eigen::Quaterniond expected =
      frames_[frame].rotation * turn.before_from_now;
  const Eigen::Matrix3d R = world_from_camera_.rotation.toRotationMatrix();
  // The turn since the frame, then how fast it turns now; in world.
  Eigen::VectorXd innovation(6);
  innovation << geometry::RotationVector(
      expected * world_from_camera_.rotation.conjugate()),
      R * turn.rate_now_rad_s - angular_velocity_world_rad_s_;
  Observation H = Observation::Zero(6, size_);
  H.block<3, 3>(0, 3).setIdentity();
  H.block<3, 3>(0, OffsetOf(frame) + 3) = -Eigen::Matrix3d::Identity();
  H.block<3, kGyroscopeErrors>(0, kGyroscope) = R * turn.error_jacobian;
  H.block<3, 3>(3, kVelocity + 3).setIdentity();
  H.block<3, kGyroscopeErrors>(3, kGyroscope) =
      R * ErrorJacobianOfRate(turn.rate_now_rad_s);
  const double density = options_.imu->gyroscope_noise_rad_s_sqrt_hz;
  const double turned = kGyroscopeNonlinearity *
                        geometry::RotationVector(turn.before_from_now).norm();
  const double rate = kGyroscopeNonlinearity * turn.rate_now_rad_s.norm();
  Eigen::VectorXd variance(6);
  variance.head<3>().setConstant(density * density * turn.duration_s +
                                 turned * turned);
  variance.tail<3>().setConstant(density * density / turn.sample_period_s +
                                 rate * rate);
  Update(innovation,
         H,
         variance.asDiagonal(),
         std::numeric_limits<double>::infinity());
  turn_is_measured_ = true;
}

void PoseFilter::ExpectSensors() {
  if (expects_sensors_) return;
  expects_sensors_ = true;
  const int before = size_;
  size_ += kSensorErrors;
  Covariance grown = Covariance::Identity(size_, size_);
  grown.topLeftCorner(before, before) = covariance_;
  covariance_ = std::move(grown);
}

bool PoseFilter::UpdateFromSensor(const Eigen::Vector3d& innovation,
                                  const Eigen::Matrix<double, 3, 6>& d_pose,
                                  int offset,
                                  double sigma) {
  Observation H = Observation::Zero(3, size_);
  H.leftCols<6>() = d_pose;
  H.middleCols<3>(offset) = sigma * Eigen::Matrix3d::Identity();
  const double noise = kSensorNoiseShare * sigma;
  return Update(innovation,
                H,
                noise * noise * Eigen::Matrix3d::Identity(),
                options_.max_sensor_mahalanobis_squared);
}

bool PoseFilter::UpdateFromPosition(const PositionMeasurement& measured) {
  ExpectSensors();
  const Eigen::Vector3d arm_world =
      world_from_camera_.rotation * measured.p_camera;
  Eigen::Matrix<double, 3, 6> d_pose;
  d_pose << Eigen::Matrix3d::Identity(), -geometry::Skew(arm_world);
  return UpdateFromSensor(measured.p_world - world_from_camera_.translation -
                              arm_world -
                              measured.sigma * sensor_errors_.head<3>(),
                          d_pose,
                          SensorOffset(),
                          measured.sigma);
}

bool PoseFilter::UpdateFromAttitude(const AttitudeMeasurement& measured) {
  ExpectSensors();
  Eigen::Matrix<double, 3, 6> d_pose = Eigen::Matrix<double, 3, 6>::Zero();
  d_pose.rightCols<3>().setIdentity();
  return UpdateFromSensor(
      geometry::RotationVector(measured.world_from_camera *
                               world_from_camera_.rotation.conjugate()) -
          measured.sigma_rad * sensor_errors_.tail<3>(),
      d_pose,
      SensorOffset() + 3,
      measured.sigma_rad);
}

}  // namespace groundlock::localization
