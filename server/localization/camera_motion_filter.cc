// SPDX-License-Identifier: Apache-2.0
#include "server/localization/camera_motion_filter.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;
using geometry::Rigid3;
using geometry::Vector6d;

double Seconds(std::chrono::nanoseconds t) {
  return std::chrono::duration<double>(t).count();
}

}  // namespace

void CameraMotionFilter::Start(std::chrono::nanoseconds time,
                               const PoseEstimate& pose) {
  time_ = time;
  world_from_camera_ = pose.world_from_camera;
  velocity_world_s_.setZero();
  angular_velocity_world_rad_s_.setZero();
  covariance_.setZero();
  covariance_.topLeftCorner<6, 6>() = pose.covariance;
  covariance_.diagonal().segment<3>(6).setConstant(options_.initial_velocity_s *
                                                   options_.initial_velocity_s);
  covariance_.diagonal().segment<3>(9).setConstant(
      options_.initial_angular_velocity_rad_s *
      options_.initial_angular_velocity_rad_s);
}

Rigid3 CameraMotionFilter::PredictPose(std::chrono::nanoseconds time) const {
  const double dt_s =
      std::clamp(Seconds(time - time_), 0.0, options_.max_step_s);
  Vector6d step;
  step << dt_s * velocity_world_s_, dt_s * angular_velocity_world_rad_s_;
  return MovePose(world_from_camera_, step);
}

PoseEstimate CameraMotionFilter::Update(std::chrono::nanoseconds time,
                                        const PoseEstimate& measured) {
  const double dt_s = Seconds(time - time_);
  if (dt_s <= 0.0 || dt_s > options_.max_step_s) {
    Start(time, measured);
    return measured;
  }
  world_from_camera_ = PredictPose(time);
  time_ = time;
  Matrix12d F = Matrix12d::Identity();
  F.topRightCorner<6, 6>().diagonal().setConstant(dt_s);
  // White acceleration, integrated (Bar-Shalom et al. 2001, §6.2.2).
  Matrix12d Q = Matrix12d::Zero();
  const auto add_noise = [&](int offset, double sigma) {
    const double variance = sigma * sigma;
    const double dt2 = dt_s * dt_s;
    for (int i = offset; i < offset + 3; ++i) {
      Q(i, i) = variance * dt2 * dt2 / 4.0;
      Q(i, i + 6) = Q(i + 6, i) = variance * dt2 * dt_s / 2.0;
      Q(i + 6, i + 6) = variance * dt2;
    }
  };
  add_noise(0, options_.acceleration_s2);
  add_noise(3, options_.angular_acceleration_rad_s2);
  covariance_ = F * covariance_ * F.transpose() + Q;

  const Vector6d innovation =
      PoseDifference(world_from_camera_, measured.world_from_camera);
  const Matrix6d S = covariance_.topLeftCorner<6, 6>() + measured.covariance;
  const Eigen::LDLT<Matrix6d> solver(S);
  if (solver.info() != Eigen::Success || !(solver.vectorD().minCoeff() > 0.0) ||
      !(innovation.dot(solver.solve(innovation)) <=
        options_.max_mahalanobis_squared)) {
    Start(time, measured);
    return measured;
  }
  const Eigen::Matrix<double, 12, 6> K =
      solver.solve(covariance_.topRows<6>()).transpose();
  const Eigen::Matrix<double, 12, 1> correction = K * innovation;
  world_from_camera_ = MovePose(world_from_camera_, correction.head<6>());
  velocity_world_s_ += correction.segment<3>(6);
  angular_velocity_world_rad_s_ += correction.segment<3>(9);
  Matrix12d A = Matrix12d::Identity();
  A.leftCols<6>() -= K;
  covariance_ =
      A * covariance_ * A.transpose() + K * measured.covariance * K.transpose();
  return {world_from_camera_, covariance_.topLeftCorner<6, 6>()};
}

void CameraMotionFilter::Shift(const Rigid3& correction) {
  world_from_camera_ = correction * world_from_camera_;
  velocity_world_s_ = correction.rotation * velocity_world_s_;
  angular_velocity_world_rad_s_ =
      correction.rotation * angular_velocity_world_rad_s_;
}

void CameraMotionFilter::MakeReference() {
  covariance_.topRows<6>().setZero();
  covariance_.leftCols<6>().setZero();
}

}  // namespace groundlock::localization
