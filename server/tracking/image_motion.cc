// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/image_motion.h"

#include <algorithm>
#include <cmath>

namespace groundlock::tracking {
namespace {

// A velocity in the image is mostly the camera's: it changes from frame to
// frame, and unseen soon means nothing.
constexpr double kImageVelocityRate = 0.3;  // a step
constexpr double kImageVelocityLife_s = 0.4;
// That over the background is the target's own.
constexpr double kVelocityMemory_s = 0.5;
constexpr double kVelocityLife_s = 3.0;
// Who films keeps a target somewhere in the picture.
constexpr double kUsualMemory_s = 2.0;
constexpr double kInnovationRate = 0.1;
// Shares of the box's side.
constexpr double kFirstSigma = 0.5;   // a step, before its velocity is known
constexpr double kUsualSigma = 0.1;   // of a step after that, until it is known
constexpr double kLeastSigma = 0.03;  // to which a tracker finds a place
constexpr double kWidestSigma = 4.0;
// A camera that moves otherwise than it did, by more than so many times its
// usual (mean square) change, makes what was learnt of the image worth less.
constexpr double kUnusual = 9.0;

double Seconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

// With which a velocity over the background is learnt.
double RateOver(double step_s) {
  return 1.0 - std::exp(-step_s / kVelocityMemory_s);
}

}  // namespace

ImageMotion::Prediction ImageMotion::Model::Predict(double age_s,
                                                    double step_s,
                                                    double side_px) const {
  Prediction prediction;
  prediction.center_px =
      last_px + velocity_px_s * life_s * (1.0 - std::exp(-age_s / life_s));
  const double least_px2 = std::pow(kLeastSigma * side_px, 2);
  const double step_px2 =
      steps > 0 ? innovation_px2 : std::pow(kFirstSigma * side_px, 2);
  const double sigma_px =
      std::min(kWidestSigma * side_px,
               std::sqrt(step_px2 + least_px2) * std::max(1.0, age_s / step_s));
  prediction.covariance_px2 = sigma_px * sigma_px * Eigen::Matrix2d::Identity();
  return prediction;
}

void ImageMotion::Model::Update(const Eigen::Vector2d& center_px,
                                double step_s,
                                double rate,
                                double trust) {
  const Eigen::Vector2d way_px = center_px - last_px;
  const Eigen::Vector2d surprise_px = way_px - velocity_px_s * step_s;
  ++steps;
  if (steps > 1) {
    innovation_px2 += trust * std::max(kInnovationRate, 1.0 / steps) *
                      (0.5 * surprise_px.squaredNorm() - innovation_px2);
  }
  velocity_px_s += trust * std::max(rate, 1.0 / steps) * (surprise_px / step_s);
  last_px = center_px;
}

void ImageMotion::Restart(const geometry::Box2& box_px,
                          std::chrono::nanoseconds time) {
  side_px_ = std::sqrt(box_px.size_px().prod());
  in_image_ = {.last_px = box_px.center_px(),
               .innovation_px2 = std::pow(kUsualSigma * side_px_, 2),
               .life_s = kImageVelocityLife_s};
  on_background_ = in_image_;
  on_background_.life_s = kVelocityLife_s;
  looks_ = on_background_;
  looked_ = time;
  background_known_ = background_since_look_ = true;
  unusual_change_px2_ = 0.0;
  usual_px_ = box_px.center_px();
  usual_spread_px2_ = 0.0;
  time_ = time;
}

void ImageMotion::Carry(const std::optional<ImageAffinity>& background) {
  // The way from a drawn box to where the tracker finds it next is mostly the
  // drawing's error, which no velocity should start from.
  if (!background || in_image_.steps == 0) {
    background_known_ = background_since_look_ = false;
    return;
  }
  const Eigen::Vector2d last_px = *background * on_background_.last_px;
  const Eigen::Vector2d change_px =
      last_px - on_background_.last_px - camera_way_px_;
  const double change_px2 = 0.5 * change_px.squaredNorm();
  const double least_px2 = std::pow(kLeastSigma * side_px_, 2);
  if (change_px2 > kUnusual * (usual_change_px2_ + least_px2)) {
    unusual_change_px2_ += change_px2;
  }
  usual_change_px2_ += kInnovationRate * (change_px2 - usual_change_px2_);
  camera_way_px_ += kImageVelocityRate * change_px;
  on_background_.last_px = last_px;
  on_background_.velocity_px_s =
      background->turn * on_background_.velocity_px_s;
  looks_.last_px = *background * looks_.last_px;
  looks_.velocity_px_s = background->turn * looks_.velocity_px_s;
}

void ImageMotion::Update(const geometry::Box2& box_px,
                         std::chrono::nanoseconds time,
                         double trust,
                         bool by_looks) {
  const double step_s = Seconds(time - time_);
  if (!(step_s > 0.0)) return;
  side_px_ = std::sqrt(box_px.size_px().prod());
  const Eigen::Vector2d center_px = box_px.center_px();
  way_px2_ += std::max(kInnovationRate, 1.0 / (1.0 + in_image_.steps)) *
              (0.5 * (center_px - in_image_.last_px).squaredNorm() - way_px2_);
  in_image_.Update(center_px, step_s, kImageVelocityRate, trust);
  const double usual_rate = 1.0 - std::exp(-step_s / kUsualMemory_s);
  const Eigen::Vector2d off_px = center_px - usual_px_;
  usual_px_ += usual_rate * off_px;
  usual_spread_px2_ +=
      usual_rate * (0.5 * off_px.squaredNorm() - usual_spread_px2_);
  if (background_known_) {
    on_background_.Update(center_px, step_s, RateOver(step_s), trust);
  }
  on_background_.last_px = center_px;
  if (by_looks) {
    const double look_step_s = Seconds(time - looked_);
    if (background_since_look_) {
      looks_.Update(center_px, look_step_s, RateOver(look_step_s), trust);
    }
    looks_.last_px = center_px;
    looked_ = time;
    background_since_look_ = true;
  }
  background_known_ = true;
  unusual_change_px2_ = 0.0;
  step_s_ = step_s;
  time_ = time;
}

ImageMotion::Velocity ImageMotion::VelocityOf(const Model& model) const {
  // Of a mean that forgets, if the steps' errors are independent.
  const double rate = RateOver(step_s_);
  return {model.velocity_px_s,
          std::sqrt(rate / (2.0 - rate) * model.innovation_px2) / step_s_};
}

ImageMotion::Velocity ImageMotion::LooksOverBackground(
    const Eigen::Vector2d& center_px, std::chrono::nanoseconds time) const {
  Model looks = looks_;
  const double step_s = Seconds(time - looked_);
  if (background_since_look_ && step_s > 0.0) {
    looks.Update(center_px, step_s, RateOver(step_s), 1.0);
  }
  return VelocityOf(looks);
}

const ImageMotion::Model& ImageMotion::Better() const {
  return background_known_ && on_background_.innovation_px2 <=
                                  in_image_.innovation_px2 + unusual_change_px2_
             ? on_background_
             : in_image_;
}

ImageMotion::Prediction ImageMotion::UsualPlace() const {
  Prediction usual;
  usual.center_px = usual_px_;
  usual.covariance_px2 = std::min(usual_spread_px2_ + side_px_ * side_px_,
                                  std::pow(kWidestSigma * side_px_, 2)) *
                         Eigen::Matrix2d::Identity();
  return usual;
}

bool ImageMotion::IsBetterThanRest() const {
  return background_known_ && &Better() == &on_background_ &&
         on_background_.steps > 1 &&
         on_background_.innovation_px2 <=
             way_px2_ + unusual_change_px2_ +
                 std::pow(kLeastSigma * side_px_, 2);
}

ImageMotion::Prediction ImageMotion::Predict(
    std::chrono::nanoseconds time) const {
  return Better().Predict(
      std::max(0.0, Seconds(time - time_)), step_s_, side_px_);
}

std::optional<Eigen::Vector2d> ImageMotion::LeftBehind_px() const {
  if (!background_known_) return std::nullopt;
  return on_background_.last_px;
}

}  // namespace groundlock::tracking
