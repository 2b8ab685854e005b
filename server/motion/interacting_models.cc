// SPDX-License-Identifier: Apache-2.0
#include "server/motion/interacting_models.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace groundlock::motion {
namespace {

// Longer gaps are predicted in steps of this: the models mix between them.
constexpr double kMaxStep_s = 0.05;
// Beyond this nothing is left to predict; it also bounds the loop.
constexpr double kMaxGap_s = 60.0;
// No model becomes so unlikely that it could not come back within some
// sightings.
constexpr double kLeastProbability = 1e-6;
// Below this the sine of an angle is its series' first two terms to 1e-15.
constexpr double kSmallAngle_rad = 1e-3;

double Seconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

Eigen::Matrix2d Rotation(double angle_rad) {
  const double c = std::cos(angle_rad);
  const double s = std::sin(angle_rad);
  return (Eigen::Matrix2d() << c, -s, s, c).finished();
}

// Of what turns at `turn_rad_s`: the way of a step for each velocity at its
// start, which is the integral of the rotation; and how that changes with the
// turn rate.
struct Way {
  Eigen::Matrix2d of_velocity;
  Eigen::Matrix2d by_turn;
};

Way WayOf(double turn_rad_s, double step_s) {
  const double w = turn_rad_s;
  const double T = step_s;
  const double a = w * T;
  double along = T * (1.0 - a * a / 6.0);
  double aside = T * a / 2.0 * (1.0 - a * a / 12.0);
  double along_by_turn = -T * T * a / 3.0;
  double aside_by_turn = T * T / 2.0 * (1.0 - a * a / 4.0);
  if (std::abs(a) > kSmallAngle_rad) {
    along = std::sin(a) / w;
    aside = (1.0 - std::cos(a)) / w;
    along_by_turn = (T * std::cos(a) - along) / w;
    aside_by_turn = (T * std::sin(a) - aside) / w;
  }
  const auto turned = [](double c, double s) {
    return (Eigen::Matrix2d() << c, -s, s, c).finished();
  };
  return {turned(along, aside), turned(along_by_turn, aside_by_turn)};
}

}  // namespace

Curve GoAlongCurve(const CurveState& before,
                   double step_s,
                   double turn_time_s) {
  const Eigen::Vector2d v = before.segment<2>(2);
  const double w = before[4];
  const Way way = WayOf(w, step_s);
  const Eigen::Matrix2d rotation = Rotation(w * step_s);
  const Eigen::Vector2d v_after = rotation * v;
  const double kept = std::exp(-step_s / turn_time_s);
  Curve curve;
  curve.state.head<2>() = before.head<2>() + way.of_velocity * v;
  curve.state.segment<2>(2) = v_after;
  curve.state[4] = kept * w;
  curve.transition.setIdentity();
  curve.transition.block<2, 2>(0, 2) = way.of_velocity;
  curve.transition.block<2, 1>(0, 4) = way.by_turn * v;
  curve.transition.block<2, 2>(2, 2) = rotation;
  curve.transition.block<2, 1>(2, 4) =
      step_s * Eigen::Vector2d(-v_after.y(), v_after.x());
  curve.transition(4, 4) = kept;
  return curve;
}

InteractingModels::InteractingModels(const MotionOptions& options)
    : options_(options) {}

void InteractingModels::Initialize(std::chrono::nanoseconds time,
                                   const GroundMeasurement& measurement) {
  time_ = time;
  const double speed_m_s = options_.speed_sigma * options_.target_size_m;
  for (int kind = 0; kind < kKinds; ++kind) {
    Model& model = models_[kind];
    model = Model();
    model.x.head<2>() = measurement.position_m;
    model.covariance.topLeftCorner<2, 2>() = measurement.covariance_m2;
    if (kind == kStands) continue;
    model.covariance.diagonal().segment<2>(2).setConstant(speed_m_s *
                                                          speed_m_s);
    model.covariance(4, 4) = std::pow(options_.turn_sigma_rad_s, 2);
  }
  if (measurement.velocity_m_s) {
    Observe(
        2, *measurement.velocity_m_s, measurement.velocity_covariance_m2_s2);
  }
}

InteractingModels::Transitions InteractingModels::After(double step_s) const {
  Transitions rates = Transitions::Zero();
  rates(kStands, kManoeuvres) = 1.0 / options_.stands_s;
  rates(kSteady, kManoeuvres) = 1.0 / options_.steady_s;
  rates(kSteady, kStands) = 1.0 / options_.steady_until_stop_s;
  rates(kManoeuvres, kSteady) = 1.0 / options_.manoeuvre_s;
  rates(kManoeuvres, kStands) = 1.0 / options_.manoeuvre_until_stop_s;
  Transitions after = Transitions::Zero();
  for (int from = 0; from < kKinds; ++from) {
    const double leaves = rates.row(from).sum();
    const double stays = std::exp(-leaves * step_s);
    after.row(from) = (1.0 - stays) / leaves * rates.row(from);
    after(from, from) = stays;
  }
  return after;
}

InteractingModels::Model InteractingModels::Become(const Model& model,
                                                   Kind from,
                                                   Kind to) const {
  Model other = model;
  if (from == to) return other;
  if (to == kStands) {
    other.x.tail<3>().setZero();
    other.covariance.rightCols<3>().setZero();
    other.covariance.bottomRows<3>().setZero();
  } else if (from == kStands) {
    const double speed_m_s =
        options_.start_speed_sigma * options_.target_size_m;
    other.covariance.diagonal().segment<2>(2).setConstant(speed_m_s *
                                                          speed_m_s);
    other.covariance(4, 4) = std::pow(options_.turn_sigma_rad_s, 2);
  }
  return other;
}

void InteractingModels::Mix(double step_s) {
  const Transitions after = After(step_s);
  std::array<Model, kKinds> mixed;
  for (int to = 0; to < kKinds; ++to) {
    Model& model = mixed[to];
    std::array<Model, kKinds> parts;
    std::array<double, kKinds> shares;
    model.probability = 0.0;
    for (int from = 0; from < kKinds; ++from) {
      parts[from] =
          Become(models_[from], static_cast<Kind>(from), static_cast<Kind>(to));
      shares[from] = after(from, to) * models_[from].probability;
      model.probability += shares[from];
    }
    for (int from = 0; from < kKinds; ++from) {
      shares[from] /= model.probability;
      model.x += shares[from] * parts[from].x;
    }
    for (int from = 0; from < kKinds; ++from) {
      const CurveState off = parts[from].x - model.x;
      model.covariance +=
          shares[from] * (parts[from].covariance + off * off.transpose());
    }
  }
  models_ = mixed;
}

void InteractingModels::Step(Kind kind, double step_s) {
  Model& model = models_[kind];
  const double size_m = options_.target_size_m;
  if (kind == kStands) {
    model.covariance.diagonal().head<2>().array() +=
        size_m * size_m * options_.standing_density * step_s;
    return;
  }
  const Curve curve = GoAlongCurve(model.x, step_s, options_.turn_time_s);
  model.x = curve.state;
  const double q =
      size_m * size_m *
      (kind == kSteady ? options_.steady_density : options_.manoeuvre_density);
  const double T = step_s;
  CurveCovariance noise = CurveCovariance::Zero();
  noise.diagonal().head<2>().setConstant(q * T * T * T / 3.0);
  noise.diagonal().segment<2>(2).setConstant(q * T);
  noise(0, 2) = noise(2, 0) = noise(1, 3) = noise(3, 1) = q * T * T / 2.0;
  const double kept = curve.transition(4, 4);
  noise(4, 4) = std::pow(options_.turn_sigma_rad_s, 2) * (1.0 - kept * kept);
  model.covariance =
      curve.transition * model.covariance * curve.transition.transpose() +
      noise;
}

GroundState InteractingModels::Predict(std::chrono::nanoseconds time) {
  if (time <= time_) return state();
  const double gap_s = std::min(Seconds(time - time_), kMaxGap_s);
  const int steps =
      std::max(1, static_cast<int>(std::ceil(gap_s / kMaxStep_s)));
  for (int i = 0; i < steps; ++i) {
    Mix(gap_s / steps);
    for (int kind = 0; kind < kKinds; ++kind) {
      Step(static_cast<Kind>(kind), gap_s / steps);
    }
  }
  time_ = time;
  return state();
}

void InteractingModels::Observe(int first,
                                const Eigen::Vector2d& value,
                                const Eigen::Matrix2d& covariance) {
  std::array<double, kKinds> log_likelihood;
  for (int kind = 0; kind < kKinds; ++kind) {
    Model& model = models_[kind];
    const Eigen::Vector2d innovation = value - model.x.segment<2>(first);
    const Eigen::Matrix2d S =
        model.covariance.block<2, 2>(first, first) + covariance;
    const Eigen::LDLT<Eigen::Matrix2d> solver(S);
    log_likelihood[kind] = -0.5 * innovation.dot(solver.solve(innovation)) -
                           0.5 * std::log(S.determinant());
    const Eigen::Matrix<double, 5, 2> K =
        solver.solve(model.covariance.middleRows<2>(first)).transpose();
    model.x += K * innovation;
    // Joseph's form keeps the covariance symmetric and positive.
    CurveCovariance I_KH = CurveCovariance::Identity();
    I_KH.middleCols<2>(first) -= K;
    model.covariance = I_KH * model.covariance * I_KH.transpose() +
                       K * covariance * K.transpose();
  }
  const double likeliest =
      *std::max_element(log_likelihood.begin(), log_likelihood.end());
  double sum = 0.0;
  for (int kind = 0; kind < kKinds; ++kind) {
    double& p = models_[kind].probability;
    p = std::max(kLeastProbability,
                 p * std::exp(log_likelihood[kind] - likeliest));
    sum += p;
  }
  for (Model& model : models_) model.probability /= sum;
}

GroundState InteractingModels::Update(const GroundMeasurement& measurement) {
  Observe(0, measurement.position_m, measurement.covariance_m2);
  if (measurement.velocity_m_s) {
    Observe(
        2, *measurement.velocity_m_s, measurement.velocity_covariance_m2_s2);
  }
  return state();
}

GroundState InteractingModels::state() const {
  CurveState mean = CurveState::Zero();
  for (const Model& model : models_) mean += model.probability * model.x;
  CurveCovariance covariance = CurveCovariance::Zero();
  for (const Model& model : models_) {
    const CurveState off = model.x - mean;
    covariance +=
        model.probability * (model.covariance + off * off.transpose());
  }
  return {.position_m = mean.head<2>(),
          .velocity_m_s = mean.segment<2>(2),
          .turn_rad_s = mean[4],
          .stands = models_[kStands].probability,
          .position_covariance_m2 = covariance.topLeftCorner<2, 2>(),
          .velocity_covariance_m2_s2 = covariance.block<2, 2>(2, 2)};
}

double InteractingModels::Surprise(const Eigen::Vector2d& position_m,
                                   const Eigen::Matrix2d& covariance_m2) const {
  // Logarithms, so that what no model foresees is a number, too.
  std::array<double, kKinds> log_densities;
  for (int kind = 0; kind < kKinds; ++kind) {
    const Model& model = models_[kind];
    const Eigen::Vector2d off_m = position_m - model.x.head<2>();
    const Eigen::Matrix2d S =
        model.covariance.topLeftCorner<2, 2>() + covariance_m2;
    log_densities[kind] = std::log(model.probability) -
                          0.5 * off_m.dot(S.ldlt().solve(off_m)) -
                          0.5 * std::log(S.determinant());
  }
  const double highest =
      *std::max_element(log_densities.begin(), log_densities.end());
  double sum = 0.0;
  for (const double log_density : log_densities) {
    sum += std::exp(log_density - highest);
  }
  const Eigen::Matrix2d S = state().position_covariance_m2 + covariance_m2;
  const double log_density = highest + std::log(sum);
  return std::max(0.0, -2.0 * log_density - std::log(S.determinant()));
}

void InteractingModels::Shift(const Eigen::Vector2d& offset_m) {
  for (Model& model : models_) model.x.head<2>() += offset_m;
}

}  // namespace groundlock::motion
