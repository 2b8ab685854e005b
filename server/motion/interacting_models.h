// SPDX-License-Identifier: Apache-2.0
// A target that stands, goes on steadily, or manoeuvres: one Kalman filter for
// each, and how likely each is (the interacting multiple model estimator: Blom
// & Bar-Shalom, IEEE TAC 33(8), 1988).
#ifndef GROUNDLOCK_SERVER_MOTION_INTERACTING_MODELS_H_
#define GROUNDLOCK_SERVER_MOTION_INTERACTING_MODELS_H_

#include <Eigen/Core>
#include <array>
#include <chrono>

#include "server/motion/motion_predictor.h"

namespace groundlock::motion {

// State of a model: position (m), velocity (m/s), turn rate (rad/s,
// anticlockwise in the ground's axes).
using CurveState = Eigen::Matrix<double, 5, 1>;
using CurveCovariance = Eigen::Matrix<double, 5, 5>;

// The nearly coordinated turn with a Cartesian velocity (Bar-Shalom, Li &
// Kirubarajan 2001, §11.7.1), whose turn rate dies away with the time constant
// `turn_time_s`, as an Ornstein-Uhlenbeck process does: the state after a step,
// and its derivative by the state before. `turn_time_s` > 0.
struct Curve {
  CurveState state;
  CurveCovariance transition;
};
Curve GoAlongCurve(const CurveState& before, double step_s, double turn_time_s);

// All three models have that state; what differs is the white acceleration that
// disturbs the velocity. What stands has none, and neither velocity nor turn
// rate.
class InteractingModels : public MotionPredictor {
 public:
  explicit InteractingModels(const MotionOptions& options);

  void Initialize(std::chrono::nanoseconds time,
                  const GroundMeasurement& measurement) override;
  GroundState Predict(std::chrono::nanoseconds time) override;
  GroundState Update(const GroundMeasurement& measurement) override;
  // Mean and covariance of the mixture of all models.
  GroundState state() const override;
  // Of the mixture (as in the IMM-PDA filter: Houles & Bar-Shalom, IEEE TAES
  // 25(2), 1989).
  double Surprise(const Eigen::Vector2d& position_m,
                  const Eigen::Matrix2d& covariance_m2) const override;
  void Shift(const Eigen::Vector2d& offset_m) override;
  void SaveState(base::StateWriter& writer) const override;
  void RestoreState(base::StateReader& reader) override;

 private:
  friend struct StateFields;

  enum Kind { kStands, kSteady, kManoeuvres };
  static constexpr int kKinds = 3;
  struct Model {
    CurveState x = CurveState::Zero();
    CurveCovariance covariance = CurveCovariance::Zero();
    double probability = 1.0 / kKinds;
  };
  using Transitions = Eigen::Matrix<double, kKinds, kKinds>;

  // Probabilities of going from one kind (row) to another within a step.
  Transitions After(double step_s) const;
  // What a model that was of one kind is where it becomes another.
  Model Become(const Model& model, Kind from, Kind to) const;
  void Mix(double step_s);
  void Step(Kind kind, double step_s);
  // Two entries of the state from `first` on were observed.
  void Observe(int first,
               const Eigen::Vector2d& value,
               const Eigen::Matrix2d& covariance);

  MotionOptions options_;
  std::array<Model, kKinds> models_;
  std::chrono::nanoseconds time_{0};
};

}  // namespace groundlock::motion

#endif  // GROUNDLOCK_SERVER_MOTION_INTERACTING_MODELS_H_
