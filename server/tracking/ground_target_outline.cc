// SPDX-License-Identifier: Apache-2.0
// How large a target on the ground looks.
#include <Eigen/Geometry>
#include <cmath>

#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {

using geometry::Box2;
using geometry::Box3;

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
