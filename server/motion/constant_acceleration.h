// SPDX-License-Identifier: Apache-2.0
// Kalman filter for constant acceleration on the ground (Robinson 2014, §3.7).
#ifndef GROUNDLOCK_SERVER_MOTION_CONSTANT_ACCELERATION_H_
#define GROUNDLOCK_SERVER_MOTION_CONSTANT_ACCELERATION_H_

#include <Eigen/Core>
#include <chrono>
#include <deque>
#include <optional>

#include "server/motion/motion_predictor.h"

namespace groundlock::motion {

// A = [I TI T^2/2 I; 0 I TI; 0 0 I] on (p, v, a), row by row.
Eigen::Matrix<double, 6, 6> ConstantAccelerationTransition(double step_s);

// Covariance that white jerk of unit spectral density adds within a step
// (Bar-Shalom, Li & Kirubarajan 2001, eq. 6.3.3-4, one order higher).
Eigen::Matrix<double, 6, 6> WhiteJerkCovariance(double step_s);

// While seen: the thesis' filter with steps of any length. While unseen the
// transition is damped as MotionOptions says, which the thesis leaves open.
class ConstantAcceleration : public MotionPredictor {
 public:
  explicit ConstantAcceleration(const MotionOptions& options);

  void Initialize(std::chrono::nanoseconds time,
                  const GroundMeasurement& measurement) override;
  GroundState Predict(std::chrono::nanoseconds time) override;
  GroundState Update(const GroundMeasurement& measurement) override;
  GroundState state() const override;
  void Shift(const Eigen::Vector2d& offset_m) override;

 private:
  // The velocity's running mean, which a target that slips behind an occluder
  // has disturbed less: what is left in view seems slower than it is. Older
  // estimates count exponentially less, and each by its information, so that
  // a few coarse sightings before it is unseen do not hide that it moved. Over
  // an absence it is what the way tells.
  struct Steady {
    void Add(const Eigen::Vector2d& velocity_m_s,
             const Eigen::Matrix2d& covariance_m2_s2,
             double gain);
    Eigen::Matrix2d information = Eigen::Matrix2d::Zero();
    Eigen::Vector2d information_velocity = Eigen::Vector2d::Zero();
    double weight = 0.0;  // of them all; one in the long run
  };
  // Where it was seen a while ago.
  struct Sighting {
    std::chrono::nanoseconds time{0};
    Eigen::Vector2d position_m = Eigen::Vector2d::Zero();
    Eigen::Matrix2d covariance_m2 = Eigen::Matrix2d::Zero();
  };
  void BeginUnseen();
  // The velocity with which it has gone on of late; nullopt: it is not sure
  // that it has.
  std::optional<Eigen::Vector2d> SteadyVelocity() const;
  // The squared Mahalanobis distance of where it is now from where it would be
  // if it had gone from there with that velocity.
  double Surprise(const Sighting& then,
                  const Eigen::Vector2d& velocity_m_s) const;
  // It is seen at the present time, where the state has it.
  void NoteUpdate();
  void Step(double step_s, double unseen_s);

  MotionOptions options_;
  Eigen::Matrix<double, 6, 1> x_ = Eigen::Matrix<double, 6, 1>::Zero();
  Eigen::Matrix<double, 6, 6> covariance_ =
      Eigen::Matrix<double, 6, 6>::Identity();
  Steady steady_;
  std::deque<Sighting> sightings_;  // the oldest first
  std::chrono::nanoseconds time_{0};
  // Where and when it was last seen.
  std::chrono::nanoseconds updated_{0};
  Eigen::Vector2d updated_m_ = Eigen::Vector2d::Zero();
  Eigen::Matrix2d updated_covariance_m2_ = Eigen::Matrix2d::Zero();
  bool unseen_ = false;
};

}  // namespace groundlock::motion

#endif  // GROUNDLOCK_SERVER_MOTION_CONSTANT_ACCELERATION_H_
