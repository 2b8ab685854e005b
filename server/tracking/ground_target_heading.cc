// SPDX-License-Identifier: Apache-2.0
// Which way a target on the ground heads.
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>
#include <optional>

#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {
namespace {

// A heading is read from the way since the start once that is so long, in sizes
// and in standard deviations.
constexpr double kHeadingWay = 0.75;
constexpr double kHeadingWaySigmas = 4.0;
// So many where it is not noise, but what is followed being higher than taken.
constexpr double kHeadingAlongSigmas = 2.0;
// A way is measured anew from where the distance is told so much better.
constexpr double kToldBetter = 0.5;
// A heading follows the velocity above this speed, sizes / s, while its
// direction is known to this, and with this time constant; a badly known one
// also while it is known worse, as much slower as that says less.
constexpr double kHeadingSpeed = 0.3;
constexpr double kHeadingSigma_rad = 0.35;
constexpr double kHeadingTime_s = 0.08;
// How well one box tells length, width and height of a body whose heading is
// known, relatively.
const Eigen::Vector3d kBoxAlongWaySigma(0.25, 0.25, 0.25);
// A heading that was measured by points of the body is good to this at best
// (docs/method.md, "How well it is known"): its sides are no planes.
constexpr double kAxisSigma_rad = 3.5 * std::numbers::pi / 180.0;
// Unseen, a vehicle may go into a curve; it turns at most about so fast.
constexpr double kTurnRate_rad_s = 0.5;

}  // namespace

std::optional<GroundTarget::Direction> GroundTarget::DirectionOfWay() {
  const motion::GroundState state = motion_->state();
  const Eigen::Vector2d way = state.position_m - way_from_m_;
  const double way_m = way.norm();
  if (!(way_m > kHeadingWay * Side(size_m_))) return std::nullopt;
  // What is followed is as much higher than taken now as it was there.
  const Eigen::Vector2d by_height_m =
      FollowedHeightSigma_m() * (way_per_height_ - way_from_per_height_);
  const Eigen::Matrix2d& noise_m2 = state.position_covariance_m2;
  const Eigen::Matrix2d covariance_m2 =
      noise_m2 + by_height_m * by_height_m.transpose();
  // Across the view it may be sure to have moved where along it nothing is: at
  // a crest a pixel is metres.
  has_left_ = has_left_ || way.dot(covariance_m2.ldlt().solve(way)) >
                               kHeadingWaySigmas * kHeadingWaySigmas;
  const auto sigma_m = [](const Eigen::Vector2d& along,
                          const Eigen::Matrix2d& of_m2) {
    return std::sqrt(along.dot(of_m2 * along));
  };
  const Eigen::Vector2d along = way / way_m;
  const Eigen::Vector2d across(-along.y(), along.x());
  const double sigma_rad = sigma_m(across, covariance_m2) / way_m;
  if (!(sigma_rad < kHeadingSigma_rad) ||
      !(way_m > kHeadingWaySigmas * sigma_m(along, noise_m2)) ||
      !(way_m > kHeadingAlongSigmas * sigma_m(along, covariance_m2))) {
    return std::nullopt;
  }
  Direction direction{along, along, sigma_rad};
  // On a bend its way is a chord, and it heads along the tangent.
  const double speed_m_s = state.velocity_m_s.norm();
  const Eigen::Vector2d tangent = state.velocity_m_s / speed_m_s;
  const Eigen::Vector2d aside(-tangent.y(), tangent.x());
  const double tangent_sigma_rad =
      sigma_m(aside, state.velocity_covariance_m2_s2) / speed_m_s;
  if (tangent_sigma_rad < kHeadingSigma_rad) {
    direction.along = tangent;
    direction.sigma_rad = std::hypot(sigma_rad, tangent_sigma_rad);
  }
  return direction;
}

void GroundTarget::LearnHeadingFromStart(const CameraView& camera,
                                         const Eigen::Vector2d& center_px) {
  const auto told = DirectionOfWay();
  if (!told) {
    // From where its distance is told better, its way is, too.
    if (way_per_height_.norm() < kToldBetter * way_from_per_height_.norm()) {
      way_from_m_ = motion_->state().position_m;
      way_from_per_height_ = way_per_height_;
    }
    return;
  }
  const Eigen::Vector2d& direction = told->along;
  heading_known_ = true;
  if (fitted_) {
    // Its axis is known better than the way; which end is the front was not.
    const double turn_rad =
        WrapAngle_rad(std::atan2(direction.y(), direction.x()) - heading_rad_);
    if (std::abs(turn_rad) > 0.5 * std::numbers::pi) TurnRound();
    return;
  }
  const auto seen_px = SeenSize_px(camera);
  ground::GroundView start{
      &start_camera_, start_world_from_camera_, TangentAt(start_place_m_)};
  auto fitted = FitStartAlong(start, told->along_way);
  if (!fitted) {
    // A slope that is seen edge-on tells no distances: as if it were level.
    start.ground_world = surface_->reference_world();
    start.ground_world.d -=
        start.ground_world.SignedDistance(OnGround(start_place_m_));
    fitted = FitStartAlong(start, told->along_way);
  }
  const double before_rad = heading_rad_;
  heading_rad_ = std::atan2(direction.y(), direction.x());
  unturned_rad_ += heading_rad_ - before_rad;
  turned_unseen_ = false;
  NoteHeading(std::hypot(kWayHeadingSigma_rad, told->sigma_rad));
  if (!fitted) return;
  size_m_ = fitted->box.size_m;
  log_size_covariance_ = fitted->log_size_covariance;
  texture_object_ = ground::PointOnRay(
      start, fitted->box, start_box_px_.center_px(), kTextureDepth);
  // The same pixel now means another place: move there without an innovation.
  if (const auto placed = PlaceNearby(camera, center_px)) {
    const Eigen::Vector2d shift_m =
        axes_.FromWorld(placed->box.BottomCenterWorld()) -
        last_sighting_->place_m;
    // Not to the next slope, which the ray may meet as well.
    if (shift_m.norm() < kStartsWithin * Side(size_m_)) {
      motion_->Shift(shift_m);
      last_sighting_->place_m += shift_m;
    }
  }
  const auto hull = BodyHull(camera, box());
  if (!seen_px || !hull) return;
  seen_log_ratio_ = 0.5 * std::log(seen_px->prod() / hull->size_px().prod());
  outline_scale_.Restart(seen_log_ratio_);
}

std::optional<ground::BoxFit> GroundTarget::FitStartAlong(
    const ground::GroundView& start, const Eigen::Vector2d& direction) const {
  const Eigen::Vector3d heading_world = axes_.DirectionToWorld(direction);
  std::optional<ground::BoxFit> fit;
  if (kind_) {
    fit = ground::FitBoxOfSize(start, start_box_px_, heading_world, kind_size_);
  } else {
    const auto box =
        ground::FitBox(start, start_box_px_, heading_world, ShapeOf(size_m_));
    if (box.ok()) {
      fit = {.box = *box,
             .log_size_covariance = kBoxAlongWaySigma.cwiseAbs2().asDiagonal()};
    }
  }
  const bool is_there =
      fit && StartsAt(axes_.FromWorld(fit->box.BottomCenterWorld()));
  return is_there ? fit : std::nullopt;
}

void GroundTarget::TurnRound() {
  heading_rad_ = WrapAngle_rad(heading_rad_ + std::numbers::pi);
  unturned_rad_ += std::numbers::pi;
  // What is followed stays where it is.
  texture_object_.head<2>() *= -1.0;
}

void GroundTarget::TurnAlongWay(double step_s) {
  const motion::GroundState state = motion_->state();
  if (!heading_known_ ||
      !(state.velocity_m_s.norm() > kHeadingSpeed * Side(size_m_))) {
    return;
  }
  heading_rad_ = WrapAngle_rad(heading_rad_ + state.turn_rad_s * step_s);
}

void GroundTarget::FollowHeading(double step_s) {
  const motion::GroundState state = motion_->state();
  const double speed = state.velocity_m_s.norm();
  if (!(speed > kHeadingSpeed * Side(size_m_))) return;
  const Eigen::Vector2d across =
      Eigen::Vector2d(-state.velocity_m_s.y(), state.velocity_m_s.x()) / speed;
  const double sigma_rad =
      std::sqrt(across.dot(state.velocity_covariance_m2_s2 * across)) / speed;
  // What tells it badly tells more than a heading that is known worse.
  if (!(sigma_rad < std::max(kHeadingSigma_rad, HeadingSigma_rad()))) {
    // Meanwhile it may go into a curve; while it was not seen, that counts
    // already.
    heading_sigma_rad_ =
        std::min(kAnyHeading_rad,
                 heading_sigma_rad_ +
                     kTurnRate_rad_s * std::min(step_s, kHeadingTime_s));
    return;
  }
  double turn =
      WrapAngle_rad(std::atan2(state.velocity_m_s.y(), state.velocity_m_s.x()) -
                    heading_rad_);
  if (std::abs(turn) > 0.5 * std::numbers::pi) {
    // It goes back the way it came, unless it had time to turn round unseen.
    const bool turned = turned_unseen_;
    TurnRound();
    if (turned) unturned_rad_ -= std::numbers::pi;
    turn = WrapAngle_rad(turn + std::numbers::pi);
  }
  turned_unseen_ = false;
  double time_s = kHeadingTime_s;
  if (sigma_rad > kHeadingSigma_rad) {
    // And no more in one step, however long it was not seen.
    time_s *= std::pow(sigma_rad / kHeadingSigma_rad, 2);
    step_s = std::min(step_s, kHeadingTime_s);
  }
  const double gain = step_s / (step_s + time_s);
  Turn(gain * turn);
  // It is known no better than it was turned towards what the way tells.
  const double before_rad = heading_sigma_rad_;
  NoteHeading(std::hypot(kWayHeadingSigma_rad, sigma_rad));
  heading_sigma_rad_ = std::max(
      heading_sigma_rad_,
      std::hypot((1.0 - gain) * before_rad, gain * heading_sigma_rad_));
}

void GroundTarget::Turn(double angle_rad) {
  // Detections follow a point of the body, and so the centre swings round that
  // point. If the point is behind the centre, that swing is towards where the
  // body turns: taken for motion it would turn the heading further, and a
  // target that is followed by its rear would seem to sway without end. Its
  // rear, then, is what moves along the heading, as a vehicle's rear axle does.
  const Eigen::Vector2d rear_m(std::min(texture_object_.x(), 0.0), 0.0);
  const Eigen::Rotation2Dd before(heading_rad_);
  heading_rad_ = WrapAngle_rad(heading_rad_ + angle_rad);
  if (center_ != BoxCenter::kTexture) return;
  const Eigen::Vector2d swing_m =
      before * rear_m - Eigen::Rotation2Dd(heading_rad_) * rear_m;
  motion_->Shift(swing_m);
  last_sighting_->place_m += swing_m;
}

void GroundTarget::NoteHeading(double sigma_rad) {
  heading_sigma_rad_ = std::hypot(sigma_rad, kAxisSigma_rad);
}

double GroundTarget::HeadingSigma_rad() const {
  // What was not known to move is not taken to turn.
  const double unseen_s =
      has_moved()
          ? std::chrono::duration<double>(time_ - last_sighting_time_).count()
          : 0.0;
  return std::min(kAnyHeading_rad,
                  std::hypot(heading_sigma_rad_, kTurnRate_rad_s * unseen_s));
}

Eigen::Vector3d GroundTarget::HeadingWorld() const {
  return axes_.DirectionToWorld(
      {std::cos(heading_rad_), std::sin(heading_rad_)});
}

}  // namespace groundlock::tracking
