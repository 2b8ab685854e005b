// SPDX-License-Identifier: Apache-2.0
#include "server/localization/window/pose_filter.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "server/localization/window/seconds.h"

namespace groundlock::localization {
namespace {

using geometry::Matrix6d;
using geometry::Rigid3;
using geometry::Vector6d;

// Symmetric: the axes stay where they are while the covariance changes slowly.
Matrix6d SquareRoot(const Matrix6d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(covariance);
  return eigen.eigenvectors() *
         eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal() *
         eigen.eigenvectors().transpose();
}

// How an error of a pose displaces another one that is fixed to it.
Matrix6d LeverArm(const Eigen::Vector3d& offset_world) {
  Matrix6d J = Matrix6d::Identity();
  J.topRightCorner<3, 3>() = -geometry::Skew(offset_world);
  return J;
}

// Of a gyroscope's sensitivity, and of how exactly it is known to be fixed to
// the camera: data sheets state 1 to 3 % before calibration.
constexpr double kGyroscopeScale = 0.01;
// What satellites' signals or a compass err by stays about the same for a
// minute (the way through the atmosphere, what reflects the signals, iron
// nearby; and how the map lies on the Earth, for good). An assumption, that of
// a plain receiver.
constexpr double kSensorErrorLasts_s = 60.0;
// Variances that are tried, as natural logarithms: up to accelerations 10,000
// times as strong.
constexpr double kLogVarianceStep = 0.25;
constexpr double kMaxLogVariance = 18.5;

}  // namespace

PoseFilter::PoseFilter(const PoseFilterOptions& options)
    : options_(options),
      size_(kBias + 6 + (options.imu ? kGyroscopeErrors : 0)),
      covariance_(Covariance::Zero(size_, size_)) {
  if (!options_.imu) return;
  const double sigma = options_.imu->gyroscope_bias_rad_s;
  auto variances = covariance_.diagonal().tail<kGyroscopeErrors>();
  variances.head<3>().setConstant(sigma * sigma);
  variances.tail<9>().setConstant(kGyroscopeScale * kGyroscopeScale);
}

void PoseFilter::Start(std::chrono::nanoseconds time,
                       const MapMeasurement& measured,
                       const Vector6d& velocity_s) {
  time_ = time;
  last_measured_ = time;
  world_from_camera_ = measured.world_from_camera;
  velocity_world_s_ = velocity_s.head<3>();
  angular_velocity_world_rad_s_ = velocity_s.tail<3>();
  remembered_.fill(false);
  // What is behind the poses' own.
  const int learnt = size_ - kGyroscope;
  const Eigen::MatrixXd of_sensors =
      covariance_.bottomRightCorner(learnt, learnt);
  covariance_.setZero();
  covariance_.bottomRightCorner(learnt, learnt) = of_sensors;
  ResetBias();
  const Matrix6d L = SquareRoot(measured.systematic);
  covariance_.topLeftCorner<6, 6>() = measured.random + L * L.transpose();
  covariance_.block<6, 6>(0, kBias) = -L;
  covariance_.block<6, 6>(kBias, 0) = -L.transpose();
  covariance_.diagonal().segment<3>(kVelocity).setConstant(
      options_.initial_velocity_s * options_.initial_velocity_s);
  covariance_.diagonal()
      .segment<3>(kVelocity + 3)
      .setConstant(options_.initial_angular_velocity_rad_s *
                   options_.initial_angular_velocity_rad_s);
}

void PoseFilter::ResetBias() {
  bias_.setZero();
  covariance_.middleRows<6>(kBias).setZero();
  covariance_.middleCols<6>(kBias).setZero();
  covariance_.block<6, 6>(kBias, kBias).setIdentity();
}

void PoseFilter::ShareBias(double shared) {
  const double rho = std::clamp(shared, 0.0, 1.0);
  bias_ *= rho;
  covariance_.middleRows<6>(kBias) *= rho;
  covariance_.middleCols<6>(kBias) *= rho;
  covariance_.block<6, 6>(kBias, kBias).diagonal().array() += 1.0 - rho * rho;
}

PoseFilter::Step PoseFilter::AtConstantVelocity(double duration_s) {
  // Bar-Shalom, Li & Kirubarajan 2001, eq. 6.2.2-12.
  const double t = duration_s;
  return {t, 1.0, t * t * t / 3.0, t * t / 2.0, t};
}

PoseFilter::Step PoseFilter::WhileDyingAway(double duration_s, double decay_s) {
  // The velocity is an Ornstein-Uhlenbeck process: the integrals of white noise
  // through exp(-t / decay) and through what that has travelled.
  const double t = duration_s / decay_s;
  const double kept = std::exp(-t);
  const double lost = -std::expm1(-t);
  const double lost_twice = -std::expm1(-2.0 * t);
  return {decay_s * lost,
          kept,
          decay_s * decay_s * decay_s * (t - 2.0 * lost + 0.5 * lost_twice),
          decay_s * decay_s * 0.5 * lost * lost,
          decay_s * 0.5 * lost_twice};
}

PoseFilter::Coasting PoseFilter::CoastFor(double duration_s) const {
  const double steady_left_s =
      options_.coast_s - Seconds(time_ - last_measured_);
  const double steady_s = std::clamp(steady_left_s, 0.0, duration_s);
  return {steady_s, duration_s - steady_s};
}

void PoseFilter::Propagate(std::chrono::nanoseconds time) {
  const double dt_s = Seconds(time - time_);
  if (!(dt_s > 0.0)) return;
  turn_is_measured_ = false;
  const Coasting coasting = CoastFor(dt_s);
  Move(AtConstantVelocity(coasting.steady_s));
  Move(WhileDyingAway(coasting.dying_s, options_.coast_decay_s));
  if (options_.imu) {
    const double walk = options_.imu->gyroscope_walk_rad_s2_sqrt_hz;
    covariance_.diagonal().segment<3>(kGyroscope).array() += walk * walk * dt_s;
  }
  if (expects_sensors_) {
    const double rho = std::exp(-dt_s / kSensorErrorLasts_s);
    sensor_errors_ *= rho;
    covariance_.bottomRows<kSensorErrors>() *= rho;
    covariance_.rightCols<kSensorErrors>() *= rho;
    covariance_.diagonal().tail<kSensorErrors>().array() += 1.0 - rho * rho;
  }
  time_ = time;
  last_step_s_ = dt_s;
}

void PoseFilter::Move(const Step& step) {
  if (!(step.travel_s > 0.0)) return;
  Vector6d travelled;
  travelled << step.travel_s * velocity_world_s_,
      step.travel_s * angular_velocity_world_rad_s_;
  world_from_camera_ = MovePose(world_from_camera_, travelled);
  velocity_world_s_ *= step.kept;
  angular_velocity_world_rad_s_ *= step.kept;
  // F = [I travel I; 0 kept I] on the pose now and its velocity.
  covariance_.topRows<6>() +=
      step.travel_s * covariance_.middleRows<6>(kVelocity);
  covariance_.leftCols<6>() +=
      step.travel_s * covariance_.middleCols<6>(kVelocity);
  covariance_.middleRows<6>(kVelocity) *= step.kept;
  covariance_.middleCols<6>(kVelocity) *= step.kept;
  AddNoise(step, 1.0);
}

void PoseFilter::AddNoise(const Step& step, double variance) {
  const auto add_noise = [&](int offset, double sigma) {
    const double density =
        variance * sigma * sigma * options_.acceleration_lasts_s;
    for (int i = offset; i < offset + 3; ++i) {
      covariance_(i, i) += density * step.position;
      covariance_(i, i + kVelocity) += density * step.cross;
      covariance_(i + kVelocity, i) += density * step.cross;
      covariance_(i + kVelocity, i + kVelocity) += density * step.velocity;
    }
  };
  add_noise(0, options_.acceleration_s2);
  if (!turn_is_measured_) add_noise(3, options_.angular_acceleration_rad_s2);
}

void PoseFilter::Remember(Frame frame) {
  const int offset = OffsetOf(frame);
  frames_[frame] = world_from_camera_;
  remembered_[frame] = true;
  covariance_.middleRows<6>(offset) = covariance_.topRows<6>().eval();
  covariance_.middleCols<6>(offset) = covariance_.leftCols<6>().eval();
}

void PoseFilter::MakeAnchorFrameKeyFrame() {
  const int key = OffsetOf(kKeyFrame);
  const int anchor = OffsetOf(kAnchorFrame);
  frames_[kKeyFrame] = frames_[kAnchorFrame];
  remembered_[kKeyFrame] = remembered_[kAnchorFrame];
  remembered_[kAnchorFrame] = false;
  covariance_.middleRows<6>(key) = covariance_.middleRows<6>(anchor).eval();
  covariance_.middleCols<6>(key) = covariance_.middleCols<6>(anchor).eval();
}

PoseEstimate PoseFilter::pose() const {
  return {world_from_camera_, covariance_.topLeftCorner<6, 6>()};
}

PoseEstimate PoseFilter::pose(Frame frame) const {
  const int offset = OffsetOf(frame);
  return {frames_[frame], covariance_.block<6, 6>(offset, offset)};
}

Vector6d PoseFilter::velocity_s() const {
  Vector6d velocity;
  velocity << velocity_world_s_, angular_velocity_world_rad_s_;
  return velocity;
}

bool PoseFilter::Update(const Eigen::VectorXd& innovation,
                        const Observation& H,
                        const Eigen::MatrixXd& R,
                        double max_mahalanobis_squared) {
  const Eigen::MatrixXd HP = H * covariance_;
  const Eigen::MatrixXd S = HP * H.transpose() + R;
  const Eigen::LDLT<Eigen::MatrixXd> solver(S);
  if (solver.info() != Eigen::Success || !(solver.vectorD().minCoeff() > 0.0) ||
      !(innovation.dot(solver.solve(innovation)) <= max_mahalanobis_squared)) {
    return false;
  }
  const Eigen::MatrixXd K = solver.solve(HP).transpose();
  // Joseph's form keeps the covariance symmetric and positive.
  Covariance A = Covariance::Identity(size_, size_);
  A.noalias() -= K * H;
  const Covariance AP = A * covariance_;
  covariance_.noalias() = AP * A.transpose();
  const Eigen::MatrixXd KR = K * R;
  covariance_.noalias() += KR * K.transpose();
  covariance_ = 0.5 * (covariance_ + covariance_.transpose()).eval();
  Inject(K * innovation);
  return true;
}

void PoseFilter::Inject(const Eigen::VectorXd& correction) {
  world_from_camera_ = MovePose(world_from_camera_, correction.head<6>());
  velocity_world_s_ += correction.segment<3>(kVelocity);
  angular_velocity_world_rad_s_ += correction.segment<3>(kVelocity + 3);
  for (int i = 0; i < kNumFrames; ++i) {
    if (!remembered_[i]) continue;
    frames_[i] = MovePose(frames_[i], correction.segment<6>(12 + 6 * i));
  }
  bias_ += correction.segment<6>(kBias);
  if (options_.imu) {
    gyro_errors_.bias_rad_s += correction.segment<3>(kGyroscope);
    gyro_errors_.scale.reshaped() += correction.segment<9>(kGyroscope + 3);
  }
  if (expects_sensors_) sensor_errors_ += correction.tail<kSensorErrors>();
}

Matrix6d PoseFilter::AccelerationCovariance() const {
  const Step step = AtConstantVelocity(last_step_s_);
  const auto variance = [&](double sigma) {
    return sigma * sigma * options_.acceleration_lasts_s * step.position;
  };
  Vector6d noise;
  noise.head<3>().setConstant(variance(options_.acceleration_s2));
  noise.tail<3>().setConstant(
      turn_is_measured_ ? 0.0 : variance(options_.angular_acceleration_rad_s2));
  return noise.asDiagonal();
}

PoseFilter::HeavyTail PoseFilter::Explain(const Vector6d& innovation,
                                          const Matrix6d& expected,
                                          const Matrix6d& of_tail) const {
  const double expected_log_volume = std::log(expected.determinant());
  HeavyTail best;
  best.surprise = std::numeric_limits<double>::infinity();
  for (double log_variance = 0.0; log_variance <= kMaxLogVariance;
       log_variance += kLogVarianceStep) {
    const double variance = std::exp(log_variance);
    const Matrix6d S = expected + (variance - 1.0) * of_tail;
    const Eigen::LDLT<Matrix6d> solver(S);
    if (solver.info() != Eigen::Success ||
        !(solver.vectorD().minCoeff() > 0.0)) {
      break;
    }
    const double log_volume = solver.vectorD().array().log().sum();
    // The variance is inverse-gamma; of its logarithm, 1 is the likeliest.
    const double surprise = 0.5 * (innovation.dot(solver.solve(innovation)) +
                                   log_volume - expected_log_volume) +
                            0.5 * options_.degrees_of_freedom *
                                (log_variance + 1.0 / variance - 1.0);
    if (!(surprise < best.surprise)) break;
    best = {variance, surprise};
  }
  return best;
}

bool PoseFilter::UpdateRelative(Frame frame,
                                const Rigid3& reference,
                                const PoseEstimate& measured,
                                double max_surprise) {
  const Rigid3 expected =
      frames_[frame] * reference.Inverse() * measured.world_from_camera;
  Observation H = Observation::Zero(6, size_);
  H.leftCols<6>().setIdentity();
  H.middleCols<6>(OffsetOf(frame)) =
      -LeverArm(expected.translation - frames_[frame].translation);
  const Vector6d innovation = PoseDifference(world_from_camera_, expected);
  const Eigen::MatrixXd HP = H * covariance_;
  const HeavyTail jolt = Explain(innovation,
                                 HP * H.transpose() + measured.covariance,
                                 AccelerationCovariance());
  if (!(jolt.surprise <= max_surprise)) return false;
  Covariance before;
  if (jolt.variance > 1.0) {
    before = covariance_;
    AddNoise(AtConstantVelocity(last_step_s_), jolt.variance - 1.0);
  }
  if (!Update(innovation,
              H,
              measured.covariance,
              std::numeric_limits<double>::infinity())) {
    if (jolt.variance > 1.0) covariance_ = std::move(before);
    return false;
  }
  last_measured_ = time_;
  return true;
}

Matrix6d PoseFilter::RelativeCovariance(Frame frame) const {
  Observation H = Observation::Zero(6, size_);
  H.leftCols<6>().setIdentity();
  H.middleCols<6>(OffsetOf(frame)) =
      -LeverArm(world_from_camera_.translation - frames_[frame].translation);
  const Eigen::MatrixXd HP = H * covariance_;
  return HP * H.transpose();
}

void PoseFilter::UpdateRotation(Frame frame,
                                const Eigen::Quaterniond& frame_from_now,
                                double sigma_rad) {
  const Eigen::Quaterniond expected = frames_[frame].rotation * frame_from_now;
  Observation H = Observation::Zero(3, size_);
  H.middleCols<3>(3).setIdentity();
  H.middleCols<3>(OffsetOf(frame) + 3) = -Eigen::Matrix3d::Identity();
  Update(geometry::RotationVector(expected *
                                  world_from_camera_.rotation.conjugate()),
         H,
         sigma_rad * sigma_rad * Eigen::Matrix3d::Identity(),
         std::numeric_limits<double>::infinity());
}

void PoseFilter::AddDrift(const Matrix6d& drift) {
  covariance_.topLeftCorner<6, 6>() += drift;
}

bool PoseFilter::UpdateFromMap(const MapMeasurement& measured) {
  if (!UpdateFromMapAt(0, world_from_camera_, measured)) return false;
  last_measured_ = time_;
  return true;
}

bool PoseFilter::UpdateFromMap(Frame frame, const MapMeasurement& measured) {
  return UpdateFromMapAt(OffsetOf(frame), frames_[frame], measured);
}

bool PoseFilter::UpdateFromMapAt(int offset,
                                 const Rigid3& known,
                                 const MapMeasurement& measured) {
  const Vector6d bias_before = bias_;
  const Covariance covariance_before = covariance_;
  ShareBias(measured.shared);
  const Matrix6d L = SquareRoot(measured.systematic);
  Observation H = Observation::Zero(6, size_);
  H.middleCols<6>(offset).setIdentity();
  H.middleCols<6>(kBias) = L;
  const Vector6d innovation =
      PoseDifference(known, measured.world_from_camera) - L * bias_;
  const Eigen::MatrixXd HP = H * covariance_;
  const HeavyTail tail = Explain(
      innovation, HP * H.transpose() + measured.random, measured.random);
  if (tail.surprise <= options_.max_map_surprise &&
      Update(innovation,
             H,
             tail.variance * measured.random,
             std::numeric_limits<double>::infinity())) {
    return true;
  }
  bias_ = bias_before;
  covariance_ = covariance_before;
  return false;
}

bool PoseFilter::Confirms(Frame frame, const MapMeasurement& measured) const {
  const PoseEstimate known = pose(frame);
  const Vector6d difference =
      PoseDifference(known.world_from_camera, measured.world_from_camera);
  const Matrix6d covariance =
      known.covariance + measured.random + measured.systematic;
  const Eigen::LDLT<Matrix6d> solver(covariance);
  return solver.info() == Eigen::Success && solver.vectorD().minCoeff() > 0.0 &&
         difference.dot(solver.solve(difference)) <=
             options_.max_confirmed_mahalanobis_squared;
}

void PoseFilter::RestartFromMap(Frame frame, const MapMeasurement& measured) {
  const Eigen::Vector3d pivot_world = frames_[frame].translation;
  const Rigid3 correction =
      measured.world_from_camera * frames_[frame].Inverse();
  // How every pose follows that of `frame`. What remains of the state is the
  // motion between them and the velocity: that is known as before.
  Eigen::MatrixXd from_frame = Eigen::MatrixXd::Zero(size_, 6);
  from_frame.topRows<6>() =
      LeverArm(world_from_camera_.translation - pivot_world);
  for (int i = 0; i < kNumFrames; ++i) {
    if (!remembered_[i]) continue;
    from_frame.middleRows<6>(12 + 6 * i) =
        LeverArm(frames_[i].translation - pivot_world);
  }
  Eigen::MatrixXd D = Eigen::MatrixXd::Identity(size_, size_);
  D.middleCols<6>(OffsetOf(frame)) -= from_frame;
  covariance_ = (D * covariance_).eval() * D.transpose();

  const auto correct = [&](Rigid3& pose) {
    pose = correction * pose;
    pose.rotation.normalize();
  };
  correct(world_from_camera_);
  velocity_world_s_ = correction.rotation * velocity_world_s_;
  angular_velocity_world_rad_s_ =
      correction.rotation * angular_velocity_world_rad_s_;
  for (int i = 0; i < kNumFrames; ++i) {
    if (remembered_[i]) correct(frames_[i]);
  }

  ResetBias();
  const Matrix6d L = SquareRoot(measured.systematic);
  const Matrix6d at_frame = measured.random + L * L.transpose();
  covariance_.noalias() += from_frame * at_frame * from_frame.transpose();
  const Eigen::MatrixXd with_bias = -from_frame * L;
  covariance_.middleCols<6>(kBias) += with_bias;
  covariance_.middleRows<6>(kBias) += with_bias.transpose();
}

}  // namespace groundlock::localization
