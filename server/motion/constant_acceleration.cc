// SPDX-License-Identifier: Apache-2.0
#include "server/motion/constant_acceleration.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace groundlock::motion {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

// Longer gaps are predicted in steps of this, so that the damping, which is
// applied between the exact steps, follows the time constants closely.
constexpr double kMaxStep_s = 0.05;
// Beyond this nothing is left to predict; it also bounds the loop.
constexpr double kMaxGap_s = 60.0;
// Sightings are kept so far apart, and as long as an unseen target keeps its
// velocity.
constexpr std::chrono::milliseconds kSightingsApart{100};
constexpr std::chrono::milliseconds kSightingsKept{3'000};
// A place is off by so much of the target's size, for its shape is not known
// (as GroundTarget takes it): that changes as another side of it is seen.
constexpr double kShapeSigma = 0.1;

double Seconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

Matrix6 Blocks(double pp,
               double pv,
               double pa,
               double vv,
               double va,
               double aa,
               bool symmetric) {
  Matrix6 m = Matrix6::Zero();
  const Eigen::Matrix2d I = Eigen::Matrix2d::Identity();
  m.block<2, 2>(0, 0) = pp * I;
  m.block<2, 2>(0, 2) = pv * I;
  m.block<2, 2>(0, 4) = pa * I;
  m.block<2, 2>(2, 2) = vv * I;
  m.block<2, 2>(2, 4) = va * I;
  m.block<2, 2>(4, 4) = aa * I;
  if (symmetric) m = m.selfadjointView<Eigen::Upper>().toDenseMatrix();
  return m;
}

}  // namespace

Matrix6 ConstantAccelerationTransition(double step_s) {
  const double T = step_s;
  return Blocks(1.0, T, 0.5 * T * T, 1.0, T, 1.0, /*symmetric=*/false);
}

Matrix6 WhiteJerkCovariance(double step_s) {
  const double T = step_s;
  const double T2 = T * T;
  const double T3 = T2 * T;
  return Blocks(T3 * T2 / 20.0,
                T2 * T2 / 8.0,
                T3 / 6.0,
                T3 / 3.0,
                T2 / 2.0,
                T,
                /*symmetric=*/true);
}

ConstantAcceleration::ConstantAcceleration(const MotionOptions& options)
    : options_(options) {}

void ConstantAcceleration::Initialize(std::chrono::nanoseconds time,
                                      const GroundMeasurement& measurement) {
  time_ = time;
  x_.setZero();
  x_.head<2>() = measurement.position_m;
  const double speed_sigma =
      options_.initial_speed_sigma * options_.target_size_m;
  const double acceleration_sigma =
      options_.initial_acceleration_sigma * options_.target_size_m;
  covariance_ = Blocks(0.0,
                       0.0,
                       0.0,
                       speed_sigma * speed_sigma,
                       0.0,
                       acceleration_sigma * acceleration_sigma,
                       true);
  covariance_.topLeftCorner<2, 2>() = measurement.covariance_m2;
  steady_ = Steady();
  sightings_.clear();
  if (measurement.velocity_m_s) {
    x_.segment<2>(2) = *measurement.velocity_m_s;
    covariance_.block<2, 2>(2, 2) = measurement.velocity_covariance_m2_s2;
  }
  NoteUpdate();
}

void ConstantAcceleration::NoteUpdate() {
  updated_ = time_;
  updated_m_ = x_.head<2>();
  updated_covariance_m2_ = covariance_.topLeftCorner<2, 2>();
  unseen_ = false;
  while (!sightings_.empty() &&
         time_ - sightings_.front().time > kSightingsKept) {
    sightings_.pop_front();
  }
  if (sightings_.empty() || time_ - sightings_.back().time >= kSightingsApart) {
    sightings_.push_back({time_, updated_m_, updated_covariance_m2_});
  }
}

void ConstantAcceleration::Steady::Add(const Eigen::Vector2d& velocity_m_s,
                                       const Eigen::Matrix2d& covariance_m2_s2,
                                       double gain) {
  const Eigen::Matrix2d gained =
      gain * covariance_m2_s2.ldlt().solve(Eigen::Matrix2d::Identity());
  information = (1.0 - gain) * information + gained;
  information_velocity =
      (1.0 - gain) * information_velocity + gained * velocity_m_s;
  weight = (1.0 - gain) * weight + gain;
}

void ConstantAcceleration::BeginUnseen() {
  unseen_ = true;
  const Eigen::Vector2d v = x_.segment<2>(2);
  const auto may_be = [&](const Eigen::Vector2d& velocity) {
    const Eigen::Vector2d change = v - velocity;
    return change.dot(covariance_.block<2, 2>(2, 2).ldlt().solve(change)) <
           options_.standing_gate;
  };
  const auto steady = SteadyVelocity();
  if (steady && may_be(*steady)) {
    x_.segment<2>(2) = *steady;
    x_.tail<2>().setZero();
    return;
  }
  if (may_be(Eigen::Vector2d::Zero())) x_.tail<4>().setZero();
}

std::optional<Eigen::Vector2d> ConstantAcceleration::SteadyVelocity() const {
  if (steady_.weight > 0.0) {
    const Eigen::Vector2d mean =
        steady_.information.ldlt().solve(steady_.information_velocity);
    if (mean.dot(steady_.information * mean) >=
        options_.standing_gate * steady_.weight) {
      return mean;
    }
  }
  // Of one that goes slowly, or was seen coarsely or seldom, no velocity is
  // significant, but its way is: the last one that is, if it went on so since.
  for (auto then = sightings_.rbegin(); then != sightings_.rend(); ++then) {
    const double age_s = Seconds(updated_ - then->time);
    if (age_s < options_.steady_velocity_s) continue;
    if (Surprise(*then, Eigen::Vector2d::Zero()) < options_.standing_gate) {
      continue;
    }
    const Eigen::Vector2d velocity_m_s =
        (updated_m_ - then->position_m) / age_s;
    // Or did it stand since? Whichever hypothesis is likelier.
    double went_on = 0.0;
    double stood = 0.0;
    for (auto since = sightings_.rbegin(); since != then; ++since) {
      went_on += Surprise(*since, velocity_m_s);
      stood += Surprise(*since, Eigen::Vector2d::Zero());
    }
    return went_on < stood ? std::optional(velocity_m_s) : std::nullopt;
  }
  return std::nullopt;
}

double ConstantAcceleration::Surprise(
    const Sighting& then, const Eigen::Vector2d& velocity_m_s) const {
  const double shape_m = kShapeSigma * options_.target_size_m;
  const Eigen::Vector2d off_m = updated_m_ - then.position_m -
                                Seconds(updated_ - then.time) * velocity_m_s;
  const Eigen::Matrix2d covariance_m2 =
      updated_covariance_m2_ + then.covariance_m2 +
      shape_m * shape_m * Eigen::Matrix2d::Identity();
  return off_m.dot(covariance_m2.ldlt().solve(off_m));
}

void ConstantAcceleration::Step(double step_s, double unseen_s) {
  const Matrix6 A = ConstantAccelerationTransition(step_s);
  Vector6 damping = Vector6::Ones();
  if (unseen_) {
    damping.tail<2>().setConstant(
        std::exp(-step_s / options_.unseen_acceleration_decay_s));
    if (unseen_s > options_.unseen_velocity_hold_s) {
      damping.segment<2>(2).setConstant(
          std::exp(-step_s / options_.unseen_velocity_decay_s));
    }
  }
  const Matrix6 damped = damping.asDiagonal() * A;
  const double density =
      options_.jerk_density * options_.target_size_m * options_.target_size_m;
  x_ = damped * x_;
  covariance_ = damped * covariance_ * damped.transpose() +
                density * WhiteJerkCovariance(step_s);
}

GroundState ConstantAcceleration::Predict(std::chrono::nanoseconds time) {
  if (time <= time_) return state();
  const double gap_s = std::min(Seconds(time - time_), kMaxGap_s);
  const bool missed = time_ > updated_;  // the last step had no measurement
  if (!unseen_ && (missed || gap_s > options_.unseen_after_s)) BeginUnseen();
  const int steps =
      std::max(1, static_cast<int>(std::ceil(gap_s / kMaxStep_s)));
  const double already_unseen_s = Seconds(time_ - updated_);
  for (int i = 0; i < steps; ++i) {
    Step(gap_s / steps, already_unseen_s + gap_s * i / steps);
  }
  time_ = time;
  return state();
}

GroundState ConstantAcceleration::Update(const GroundMeasurement& measurement) {
  const int size = measurement.velocity_m_s ? 4 : 2;
  Eigen::VectorXd innovation = Eigen::VectorXd::Zero(size);
  Eigen::MatrixXd R = Eigen::MatrixXd::Zero(size, size);
  innovation.head<2>() = measurement.position_m - x_.head<2>();
  R.topLeftCorner<2, 2>() = measurement.covariance_m2;
  if (measurement.velocity_m_s) {
    innovation.tail<2>() = *measurement.velocity_m_s - x_.segment<2>(2);
    R.bottomRightCorner<2, 2>() = measurement.velocity_covariance_m2_s2;
  }
  // H = [I 0 0; 0 I 0] or its upper half picks the state's first entries.
  const Eigen::MatrixXd S = covariance_.topLeftCorner(size, size) + R;
  const Eigen::MatrixXd K =
      S.ldlt().solve(covariance_.topRows(size)).transpose();
  x_ += K * innovation;
  // Joseph's form keeps the covariance symmetric and positive.
  Matrix6 I_KH = Matrix6::Identity();
  I_KH.leftCols(size) -= K;
  covariance_ = I_KH * covariance_ * I_KH.transpose() + K * R * K.transpose();
  const double step_s = Seconds(time_ - updated_);
  const double gain = 1.0 - std::exp(-step_s / options_.steady_velocity_s);
  if (unseen_ || step_s > options_.unseen_after_s) {
    steady_ = Steady();
    sightings_.clear();
  }
  if (step_s > options_.steady_velocity_s) {
    // Whatever it did meanwhile, it has come so far.
    steady_.Add((measurement.position_m - updated_m_) / step_s,
                (measurement.covariance_m2 + updated_covariance_m2_) /
                    (step_s * step_s),
                gain);
  } else {
    steady_.Add(x_.segment<2>(2), covariance_.block<2, 2>(2, 2), gain);
  }
  NoteUpdate();
  return state();
}

GroundState ConstantAcceleration::state() const {
  return {x_.head<2>(),
          x_.segment<2>(2),
          x_.tail<2>(),
          covariance_.topLeftCorner<2, 2>(),
          covariance_.block<2, 2>(2, 2)};
}

void ConstantAcceleration::Shift(const Eigen::Vector2d& offset_m) {
  x_.head<2>() += offset_m;
  updated_m_ += offset_m;
  for (Sighting& sighting : sightings_) sighting.position_m += offset_m;
}

}  // namespace groundlock::motion
