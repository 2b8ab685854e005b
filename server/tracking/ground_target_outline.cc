// SPDX-License-Identifier: Apache-2.0
// How large a target on the ground looks.
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "server/ground/body_outline.h"
#include "server/tracking/association.h"
#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {

using geometry::Box2;
using geometry::Box3;

namespace {

// What silhouettes tell wrongly stays about the same for so long; and in the
// end no extent is known better than to so much.
constexpr double kSilhouetteTime_s = 1.0;
constexpr double kLeastSizeSigma = 0.04;
// One that alone says where the target is has this share of its size at least.
constexpr double kWholeSilhouette = 0.9;
// Where one is whose whereabouts are unknown, of its side, by the middle of its
// silhouette; and that is of its size, so many times or less.
constexpr double kUnknownPlace = 0.5;
constexpr double kSameSize = 1.3;
// Its edges are where they may be by what is known of place and size
// (chi-square, 4 degrees, 99 %).
constexpr double kSilhouetteGate = 13.3;

// Of the variance of a body's place, the mean over all directions.
double ShareLeft(const ground::StandingBody& before,
                 const ground::StandingBody& after) {
  const Eigen::Matrix2d place_before = before.covariance.topLeftCorner<2, 2>();
  const Eigen::Matrix2d place_after = after.covariance.topLeftCorner<2, 2>();
  return std::min(1.0, 0.5 * place_before.ldlt().solve(place_after).trace());
}

}  // namespace

ground::StandingBody GroundTarget::Standing(const CameraView& camera) const {
  const Box3 body = box();
  ground::StandingBody standing;
  standing.world_from_body = {body.world_from_object.rotation,
                              body.BottomCenterWorld()};
  standing.size_m = size_m_;
  standing.shape = shape_;
  Eigen::Matrix2d covariance_m2 = motion_->state().position_covariance_m2;
  const auto outline_px = Project(camera);
  const auto placed =
      outline_px ? PlaceNearby(camera, outline_px->center_px()) : std::nullopt;
  if (placed) {
    const Eigen::Matrix2d& J = placed->place_by_center_m_px;
    covariance_m2 +=
        followed_point_.variance() * outline_px->Area() * J * J.transpose();
  } else {
    covariance_m2 += followed_point_.variance() * std::pow(Side(size_m_), 2) *
                     Eigen::Matrix2d::Identity();
  }
  const Eigen::Matrix2d to_body =
      standing.world_from_body.rotation.toRotationMatrix()
          .leftCols<2>()
          .transpose() *
      axes_.axes_world;
  standing.covariance.setZero();
  standing.covariance.topLeftCorner<2, 2>() =
      to_body * covariance_m2 * to_body.transpose();
  standing.covariance(2, 2) = std::pow(HeadingSigma_rad(), 2);
  standing.covariance.bottomRightCorner<3, 3>() = log_size_covariance_;
  return standing;
}

std::optional<GroundSighting> GroundTarget::SightBySilhouette(
    const CameraView& camera,
    const ground::SeenOutline& silhouette,
    Whereabouts whereabouts,
    Box2& box_px) {
  if (center_ != BoxCenter::kTexture || !is_rigid() || !last_sighting_ ||
      last_sighting_->is_bearing) {
    return std::nullopt;
  }
  const bool is_expected = whereabouts == Whereabouts::kExpected;
  const auto& edges = silhouette.is_seen;
  if (is_expected && std::count(edges.begin(), edges.end(), false) > 0) {
    return std::nullopt;
  }
  ground::StandingBody before = Standing(camera);
  if (!is_expected) {
    const auto outline_px = Project(camera);
    const auto point_px = FollowedPointAt(camera, box());
    if (!outline_px || !point_px) return std::nullopt;
    const auto there = PlaceOnRay(
        camera,
        *point_px + silhouette.sure_px.center_px() - outline_px->center_px());
    if (!there) return std::nullopt;
    before.world_from_body = {there->box.world_from_object.rotation,
                              there->box.BottomCenterWorld()};
    before.covariance.topLeftCorner<2, 2>() =
        std::pow(kUnknownPlace * Side(size_m_), 2) *
        Eigen::Matrix2d::Identity();
  }
  const auto placed = ground::FitToOutline(*camera.view.camera,
                                           camera.view.world_from_camera,
                                           before,
                                           silhouette,
                                           ground::OutlinePart::kEdges);
  if (!placed || (is_expected && placed->surprise > kSilhouetteGate)) {
    return std::nullopt;
  }
  const Eigen::Vector3d& p_world = placed->world_from_body.translation;
  const Box3 body = BodyAt(axes_.FromWorld(p_world));
  const auto outline_px = OutlineOf(camera, body);
  if (!outline_px) return std::nullopt;
  // Of a target that something hides a part of, looks may say more.
  const Eigen::Array2d times =
      silhouette.sure_px.size_px().cwiseQuotient(outline_px->size_px());
  if ((times < kWholeSilhouette).any()) return std::nullopt;
  if (!is_expected && (times > kSameSize).any()) return std::nullopt;
  const Eigen::Matrix2d axes =
      axes_.axes_world.transpose() *
      before.world_from_body.rotation.toRotationMatrix().leftCols<2>();
  GroundSighting sighting = SightAt(
      camera,
      p_world,
      axes * placed->covariance.topLeftCorner<2, 2>() * axes.transpose());
  if (is_expected && sighting.innovation.surprise > kGate) return std::nullopt;
  box_px = *outline_px;
  sighting.center_px = box_px.center_px();
  texture_object_ =
      ground::PointOnRay(camera.view, body, sighting.center_px, kTextureDepth);
  view_rad_ = ViewAngle_rad(camera);
  return sighting;
}

Eigen::Vector3d GroundTarget::SeeSilhouette(
    const CameraView& camera,
    const ground::SeenOutline& silhouette,
    const Eigen::Vector2d& center_px,
    double step_s) {
  if (center_ != BoxCenter::kTexture || !is_rigid() || !last_sighting_ ||
      last_sighting_->is_bearing) {
    return Eigen::Vector3d::Zero();
  }
  ground::StandingBody standing = Standing(camera);
  // Not as many of them are worth more than one in that time.
  const double times =
      std::sqrt(std::max(1.0, kSilhouetteTime_s / std::max(step_s, 1e-3)));
  const auto fit = [&](ground::OutlinePart part) {
    return ground::FitToOutline(*camera.view.camera,
                                camera.view.world_from_camera,
                                standing,
                                silhouette,
                                part,
                                times);
  };
  const auto sized = fit(ground::OutlinePart::kSize);
  if (!sized) return Eigen::Vector3d::Zero();
  const auto& edges = silhouette.is_seen;
  const bool tells_size = (edges[0] && edges[2]) || (edges[1] && edges[3]);
  standing.size_m = sized->size_m;
  standing.covariance.bottomRightCorner<3, 3>() =
      sized->covariance.bottomRightCorner<3, 3>();
  const auto placed = fit(ground::OutlinePart::kEdges);
  // Of a target that something hides a part of, the rest is seen.
  if (!placed || placed->surprise > kSilhouetteGate) {
    return Eigen::Vector3d::Zero();
  }
  followed_point_.Tell(ShareLeft(standing, *placed));
  size_m_ = sized->size_m;
  log_size_covariance_ = sized->covariance.bottomRightCorner<3, 3>();
  log_size_covariance_.diagonal() = log_size_covariance_.diagonal().cwiseMax(
      kLeastSizeSigma * kLeastSizeSigma);
  const Eigen::Vector2d place_m =
      axes_.FromWorld(placed->world_from_body.translation);
  const Eigen::Vector2d shift_m = place_m - motion_->state().position_m;
  motion_->Shift(shift_m);
  last_sighting_->place_m += shift_m;
  texture_object_ =
      ground::PointOnRay(camera.view, box(), center_px, kTextureDepth);
  view_rad_ = ViewAngle_rad(camera);
  if (tells_size) {
    seen_log_ratio_ = 0.0;
    outline_scale_.RestartMeasured();
  }
  return standing.world_from_body.Inverse() *
         placed->world_from_body.translation;
}

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
  const auto placed = PlaceOnRay(camera, center_px);
  if (!placed) return std::nullopt;
  const auto outline = OutlineOf(camera, placed->box);
  if (!outline) return std::nullopt;
  return Box2::FromCenter(center_px,
                          outline_scale_.ratio() * outline->size_px());
}

Box2 GroundTarget::BoxAsLarge(const CameraView& camera,
                              const Box2& box_px) const {
  if (PlaceAsLarge(camera, box_px)) return box_px;
  return BoxForTrackerAt(camera, box_px.center_px()).value_or(box_px);
}

}  // namespace groundlock::tracking
