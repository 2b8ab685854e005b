// SPDX-License-Identifier: Apache-2.0
// A body on the ground that has not moved since it was marked: what points of
// it tell (docs/method.md, "A body at rest").
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <optional>

#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::Box3;

// A body that was fitted at rest and is seen farther from there than this share
// of its side has left: the points that told it are no longer its place.
constexpr double kLeaves = 0.3;
// What rests goes no faster than so many of its sides a second (1 sigma).
constexpr double kRestSpeed = 0.1;

}  // namespace

void GroundTarget::FitBody(const CameraView& camera,
                           const ground::BodyPoints& seen) {
  if (has_moved() || center_ != BoxCenter::kTexture || !Stands()) return;
  const ground::GroundView drawn{
      &start_camera_, start_world_from_camera_, TangentAt(start_place_m_)};
  ground::BodyKnowledge known{.is_fit = fitted_};
  if (kind_) known.size = kind_size_;
  const auto fit =
      ground::FitBodyToPoints(drawn, start_box_px_, box(), known, seen);
  if (!fit) return;
  const Eigen::Vector2d axis =
      axes_.axes_world.transpose() *
      (fit->box.world_from_object.rotation * Eigen::Vector3d::UnitX());
  // Either end may be the front: it keeps the one it was taken to have.
  const double turn_rad = std::remainder(
      std::atan2(axis.y(), axis.x()) - heading_rad_, std::numbers::pi);
  heading_rad_ = WrapAngle_rad(heading_rad_ + turn_rad);
  unturned_rad_ += turn_rad;
  size_m_ = fit->box.size_m;
  shape_ = fit->shape;
  log_size_covariance_ = fit->log_size_covariance;
  axis_sigma_rad_ = fit->axis_sigma_rad;
  NoteHeading(axis_sigma_rad_);
  const Eigen::Vector2d place_m = axes_.FromWorld(fit->box.BottomCenterWorld());
  motion_->Shift(place_m - motion_->state().position_m);
  start_place_m_ = way_from_m_ = place_m;
  start_way_per_height_ = way_from_per_height_ = way_per_height_;
  texture_object_ = ground::PointOnRay(
      camera.view, box(), last_sighting_->center_px, kTextureDepth);
  last_sighting_->place_m = place_m;
  seen_log_ratio_ = 0.0;
  outline_scale_.RestartMeasured();
  fitted_ = true;
}

std::optional<Box3> GroundTarget::BodyAtRest() const {
  if (!fitted_ || has_moved()) return std::nullopt;
  return BodyAt(start_place_m_);
}

std::optional<GroundSighting> GroundTarget::StayAtRest(const CameraView& camera,
                                                       Box2& box_px) {
  GroundSighting rest = StandStill(start_place_m_, std::nullopt);
  // What the tracker goes on with is the outline about its middle.
  const auto outline_px = BodyHull(camera, box());
  if (!outline_px) return std::nullopt;
  texture_object_ = ground::PointOnRay(
      camera.view, box(), outline_px->center_px(), kTextureDepth);
  view_rad_ = ViewAngle_rad(camera);
  const auto followed_px = ProjectForTracker(camera);
  if (!followed_px) return std::nullopt;
  box_px = *followed_px;
  rest.center_px = box_px.center_px();
  return rest;
}

std::optional<GroundSighting> GroundTarget::StayByPatches(
    const CameraView& camera, Box2& box_px) {
  // The tracker stays with the point that it knows, as far as the body's shape
  // is known.
  if (fitted_) view_rad_ = ViewAngle_rad(camera);
  FollowView(camera, /*learns=*/false);
  const auto followed_px = ProjectForTracker(camera);
  if (!followed_px) return std::nullopt;
  box_px = *followed_px;
  // Its size may be wrong, and so may its next sighting be, which must not be
  // taken for motion.
  GroundSighting rest =
      StandStill(motion_->state().position_m, kRestSpeed * Side(size_m_));
  rest.center_px = box_px.center_px();
  return rest;
}

GroundSighting GroundTarget::StandStill(const Eigen::Vector2d& place_m,
                                        std::optional<double> speed_sigma_m_s) {
  motion::GroundMeasurement measurement;
  measurement.position_m = place_m;
  measurement.covariance_m2 =
      std::pow(kFittedSigma * Side(size_m_), 2) * Eigen::Matrix2d::Identity();
  if (speed_sigma_m_s) {
    measurement.velocity_m_s = Eigen::Vector2d::Zero();
    measurement.velocity_covariance_m2_s2 =
        std::pow(*speed_sigma_m_s, 2) * Eigen::Matrix2d::Identity();
  }
  motion_->Initialize(time_, measurement);
  GroundSighting sighting;
  sighting.place_m = place_m;
  sighting.covariance_m2 = measurement.covariance_m2;
  return sighting;
}

void GroundTarget::NoteLeaving(const GroundSighting& sighting) {
  if (!fitted_) return;
  const double way_m = (sighting.place_m - start_place_m_).norm();
  has_left_ = has_left_ || way_m > kLeaves * Side(size_m_);
}

bool GroundTarget::Stands() const { return motion_->state().stands > 0.5; }

}  // namespace groundlock::tracking
