// SPDX-License-Identifier: Apache-2.0
// How large a target on the ground looks, and what that tells of its body.
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <chrono>
#include <cmath>

#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::Box3;

// Of the outline's sides, as logarithms: the step over which what they say of
// the body is measured; what an upright box tells of a body's outline (1
// sigma); and for how long its errors stay.
constexpr double kOutlineStep = 0.05;
constexpr double kOutlineSigma = 0.1;
constexpr double kOutlineMemory_s = 3.0;

}  // namespace

std::optional<Eigen::Vector2d> GroundTarget::SeenSize_px(
    const CameraView& camera) const {
  const auto hull = OutlineOf(camera, box());
  if (!hull) return std::nullopt;
  return Eigen::Vector2d(std::exp(seen_log_ratio_) * hull->size_px());
}

void GroundTarget::FollowGrowth(const CameraView& camera, double growth) {
  seen_log_ratio_ += std::log(growth);
  outline_scale_.Observe(seen_log_ratio_);
  const double body_growth = outline_scale_.TakeBody();
  seen_log_ratio_ -= std::log(body_growth);
  // The same pixel means another place for a larger body: the target goes there
  // without an innovation.
  const auto before = PlaceNearby(camera, last_sighting_->center_px);
  size_m_ *= body_growth;
  texture_object_ *= body_growth;
  GoWith(camera, before);
}

void GroundTarget::FollowSize(const CameraView& camera,
                              const Eigen::Vector2d& size_px) {
  const auto seen_px = SeenSize_px(camera);
  if (seen_px) {
    FollowGrowth(camera, std::sqrt(size_px.prod() / seen_px->prod()));
  }
}

void GroundTarget::FollowOutline(const CameraView& camera,
                                 const Eigen::Vector2d& size_px,
                                 const Eigen::Matrix2d& log_covariance) {
  const double step_s =
      std::chrono::duration<double>(time_ - outline_time_).count();
  outline_time_ = time_;
  if (!heading_known_ || !is_rigid() || center_ != BoxCenter::kTexture ||
      !(step_s > 0.0)) {
    return;
  }
  using State = Eigen::Vector4d;  // heading, logarithms of the extents
  const Eigen::Vector2d place_m = motion_->state().position_m;
  const geometry::Plane tangent_world = TangentAt(place_m);
  const Eigen::Vector3d p_ground_world = OnGround(place_m);
  const auto log_size_of =
      [&](const State& change) -> std::optional<Eigen::Vector2d> {
    const double heading_rad = heading_rad_ + change[0];
    const Box3 body = ground::UprightBox(
        tangent_world,
        p_ground_world,
        axes_.DirectionToWorld({std::cos(heading_rad), std::sin(heading_rad)}),
        size_m_.cwiseProduct(change.tail<3>().array().exp().matrix()));
    const auto hull = BodyHull(camera, body);
    if (!hull) return std::nullopt;
    return Eigen::Vector2d(hull->size_px().array().log());
  };
  const auto log_size = log_size_of(State::Zero());
  if (!log_size) return;
  Eigen::Matrix<double, 2, 4> H;
  for (int k = 0; k < 4; ++k) {
    const State change = kOutlineStep * State::Unit(k);
    const auto more = log_size_of(change);
    const auto less = log_size_of(-change);
    if (!more || !less) return;
    H.col(k) = (*more - *less) / (2.0 * kOutlineStep);
  }
  Eigen::Matrix4d P = Eigen::Matrix4d::Zero();
  P(0, 0) = std::pow(HeadingSigma_rad(), 2);
  P.bottomRightCorner<3, 3>() = log_size_covariance_;
  // Errors of colours, and of a box as a body's shape, stay for a while.
  const Eigen::Matrix2d R = (log_covariance + kOutlineSigma * kOutlineSigma *
                                                  Eigen::Matrix2d::Identity()) *
                            std::max(1.0, kOutlineMemory_s / step_s);
  const Eigen::Vector2d surprise =
      Eigen::Vector2d(size_px.array().log()) - *log_size -
      std::log(outline_scale_.ratio()) * Eigen::Vector2d::Ones();
  const Eigen::Matrix2d S = H * P * H.transpose() + R;
  const Eigen::Matrix<double, 4, 2> gain = P * H.transpose() * S.inverse();
  const State change = gain * surprise;
  const Eigen::Matrix4d after = P - gain * H * P;
  const auto before = PlaceNearby(camera, last_sighting_->center_px);
  heading_rad_ = WrapAngle_rad(heading_rad_ + change[0]);
  heading_sigma_rad_ = std::min(heading_sigma_rad_, std::sqrt(after(0, 0)));
  const Eigen::Vector3d growth = change.tail<3>().array().exp().matrix();
  size_m_ = size_m_.cwiseProduct(growth);
  texture_object_ = texture_object_.cwiseProduct(growth);
  log_size_covariance_ = after.bottomRightCorner<3, 3>();
  const auto changed = log_size_of(-change[0] * State::Unit(0));
  if (changed) {
    // The outline stays as large as it was seen.
    const double log_ratio = 0.5 * (*changed - *log_size).sum();
    seen_log_ratio_ -= log_ratio;
  }
  GoWith(camera, before);
}

std::optional<Box2> GroundTarget::OutlineOf(const CameraView& camera,
                                            const Box3& box) const {
  const auto hull = BodyHull(camera, box);
  if (!hull || center_ == BoxCenter::kOutline || IsSquat(size_m_)) return hull;
  const Eigen::Vector2d drawn_px = start_box_px_.size_px();
  return Box2::FromCenter(
      hull->center_px(),
      std::sqrt(hull->Area() / start_box_px_.Area()) * drawn_px);
}

std::optional<Box2> GroundTarget::Project(const CameraView& camera) const {
  const auto hull = OutlineOf(camera, box());
  if (!hull || center_ == BoxCenter::kOutline) return hull;
  const auto point_px = FollowedPointAt(camera, box());
  if (!point_px) return hull;
  const double ratio = outline_scale_.ratio();
  return Box2{*point_px + ratio * (hull->min_px - *point_px),
              *point_px + ratio * (hull->max_px - *point_px)};
}

std::optional<Box2> GroundTarget::ProjectAbout(
    const CameraView& camera, const Eigen::Vector2d& center_px) const {
  const auto outline = Project(camera);
  if (!outline || center_ == BoxCenter::kOutline) return outline;
  const auto point_px = FollowedPointAt(camera, box());
  if (!point_px) return outline;
  const Eigen::Vector2d shift_px = center_px - *point_px;
  return Box2{outline->min_px + shift_px, outline->max_px + shift_px};
}

std::optional<Box2> GroundTarget::ProjectForTracker(
    const CameraView& camera) const {
  const auto outline = Project(camera);
  if (!outline || center_ == BoxCenter::kOutline) return outline;
  const auto center_px = FollowedPointAt(camera, box());
  if (!center_px) return std::nullopt;
  return Box2::FromCenter(*center_px, outline->size_px());
}

std::optional<Box2> GroundTarget::BoxForTrackerAt(
    const CameraView& camera, const Eigen::Vector2d& center_px) const {
  // Anywhere in the image: from the ground that is seen there.
  const auto ray = ground::RayWorld(camera.view, center_px);
  const auto seen =
      ray ? surface_->IntersectRay(camera.view.world_from_camera.translation,
                                   *ray,
                                   ground::kMaxRange_m)
          : std::nullopt;
  const auto placed =
      Place(camera,
            center_px,
            seen ? axes_.FromWorld(*seen) : motion_->state().position_m);
  if (!placed) return std::nullopt;
  const auto outline = OutlineOf(camera, placed->box);
  if (!outline) return std::nullopt;
  return Box2::FromCenter(center_px,
                          outline_scale_.ratio() * outline->size_px());
}

}  // namespace groundlock::tracking
