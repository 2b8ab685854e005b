// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/ground_target.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "map_store/base/status.h"
#include "server/tracking/body_size.h"
#include "server/tracking/start_ground.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::Box3;
using ground::ShapePrior;

// Frame-to-frame error of a detection's centre: so much, and so much of the
// box's side (a correlation filter's cell is 1/64 of the padded patch).
constexpr double kCenterSigma_px = 0.5;
constexpr double kCenterSigmaOfBox = 0.02;
// As the view of the target turns by this, what is followed goes 63 % of the
// way to the outline's middle; smaller turns than the other may be errors.
constexpr double kFollowView_rad = 30.0 * std::numbers::pi / 180.0;
constexpr double kLeastTurn_rad = 3.0 * std::numbers::pi / 180.0;
// Error of a place that stays from frame to frame, of the target's size: its
// unknown shape.
constexpr double kShapeSigma = 0.1;
// How well a first box tells length, width and height, relatively: which of its
// sides is the longer one is not known.
const Eigen::Vector3d kFirstBoxSigma(0.45, 0.45, 0.25);
// What all of a body's extents are reported to be uncertain by at least (docs/
// method.md, "How well it is known").
constexpr double kReportedSizeSigma = 0.13;
// After so long a time between sightings it may have turned unseen.
constexpr double kUnseen_s = 0.25;
// No vehicle turns faster.
constexpr double kFastestTurn_rad_s = 2.0;
// A box that reaches so near to the image's edge is cut off there.
constexpr double kImageEdge_px = 2.0;

double Seconds(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

// Seen from an unknown side: apparent depth and width are alike to a factor of
// 1.5, and most things on the ground are about as tall as their footprint.
constexpr ShapePrior kAnyShape{.length_over_width = 1.0,
                               .length_over_width_sigma = 0.4,
                               .tallness = 0.7,
                               .tallness_sigma = 0.8};
// Newton's method converges quadratically where it does; the ground's height is
// then met to this share of the target's side.
constexpr int kMaxPlaceRounds = 8;
constexpr double kOnGround = 1e-3;

ground::GroundView Over(const CameraView& camera,
                        const geometry::Plane& tangent_world) {
  ground::GroundView view = camera.view;
  view.ground_world = tangent_world;
  return view;
}

// Its edges are the body's, and not the image's.
bool IsWhole(const geometry::CameraModel& camera, const Box2& box_px) {
  return box_px.min_px.minCoeff() > kImageEdge_px &&
         box_px.max_px.x() < camera.width_px() - kImageEdge_px &&
         box_px.max_px.y() < camera.height_px() - kImageEdge_px;
}

bool IsOn(const geometry::Plane& tangent_world, const Box3& box) {
  return std::abs(tangent_world.SignedDistance(box.BottomCenterWorld())) <=
         kOnGround * Side(box.size_m);
}

}  // namespace

GroundTarget::GroundTarget(std::shared_ptr<const ground::GroundSurface> surface,
                           const geometry::Plane& tangent_world,
                           const CameraView& camera,
                           const Box2& box_px)
    : surface_(std::move(surface)),
      last_tangent_world_(tangent_world),
      axes_(surface_->reference_world()),
      start_camera_(*camera.view.camera),
      start_world_from_camera_(camera.view.world_from_camera),
      start_box_px_(box_px) {}

absl::StatusOr<GroundTarget> GroundTarget::Create(
    const CameraView& camera,
    const Box2& box_px,
    std::chrono::nanoseconds time,
    BoxCenter center,
    const motion::MotionOptions& options) {
  std::shared_ptr<const ground::GroundSurface> surface =
      camera.surface != nullptr
          ? camera.surface
          : ground::MakePlaneSurface(camera.view.ground_world);
  const StartGround start = StartGroundOf(camera, *surface, box_px);
  geometry::Plane tangent_world = start.plane_world;
  ASSIGN_OR_RETURN(
      Box3 box,
      ground::FitBox(
          Over(camera, tangent_world), box_px, std::nullopt, kAnyShape));
  for (int round = 0; !start.is_crest && round < kMaxPlaceRounds; ++round) {
    const auto patch = surface->At(box.BottomCenterWorld());
    if (!patch || IsOn(patch->tangent_world, box)) break;
    tangent_world = patch->tangent_world;
    ASSIGN_OR_RETURN(
        box,
        ground::FitBox(
            Over(camera, tangent_world), box_px, std::nullopt, kAnyShape));
  }
  const auto kind = camera.metric && IsWhole(*camera.view.camera, box_px)
                        ? FitLikelyKind(Over(camera, tangent_world), box_px)
                        : std::nullopt;
  if (kind) box = kind->fit.box;
  GroundTarget target(std::move(surface), tangent_world, camera, box_px);
  target.center_ = center;
  const Eigen::Vector2d heading =
      target.axes_.axes_world.transpose() *
      (box.world_from_object.rotation * Eigen::Vector3d::UnitX());
  target.heading_rad_ = std::atan2(heading.y(), heading.x());
  target.size_m_ = box.size_m;
  if (target.size_m_.y() > target.size_m_.x()) {
    // Things are longer along their heading than across it.
    std::swap(target.size_m_.x(), target.size_m_.y());
    target.heading_rad_ =
        WrapAngle_rad(target.heading_rad_ + 0.5 * std::numbers::pi);
  }
  const Box3 turned = ground::UprightBox(tangent_world,
                                         box.BottomCenterWorld(),
                                         target.HeadingWorld(),
                                         target.size_m_);
  target.texture_object_ = ground::PointOnRay(
      camera.view, turned, box_px.center_px(), kTextureDepth);
  target.log_size_covariance_ = kFirstBoxSigma.cwiseAbs2().asDiagonal();
  if (kind) {
    target.kind_ = kind->kind;
    target.log_size_covariance_ = kind->fit.log_size_covariance;
    target.NoteHeading(kind->axis_sigma_rad);
  }
  target.start_place_m_ = target.axes_.FromWorld(box.BottomCenterWorld());
  motion::MotionOptions scaled = options;
  scaled.target_size_m = options.target_size_m * TypicalSize(box.size_m);
  target.standing_gate_ = options.standing_gate;
  ASSIGN_OR_RETURN(target.motion_, motion::CreateMotionPredictor(scaled));
  target.time_ = time;
  GroundSighting sighting;
  sighting.place_m = target.start_place_m_;
  sighting.center_px = box_px.center_px();
  if (const auto lifted = target.Lift(camera, box_px)) sighting = *lifted;
  target.Restart(sighting);
  target.view_rad_ = target.ViewAngle_rad(camera);
  return target;
}

void GroundTarget::Predict(std::chrono::nanoseconds time) {
  motion_->Predict(time);
  outline_scale_.Predict(std::max(0.0, Seconds(time - time_)));
  time_ = std::max(time, time_);
}

std::optional<GroundSighting> GroundTarget::Lift(const CameraView& camera,
                                                 const Box2& box_px,
                                                 double sigma_of_box) const {
  const motion::GroundState state = motion_->state();
  const auto placed = Place(camera, box_px.center_px(), state.position_m);
  if (!placed) return std::nullopt;
  GroundSighting sighting;
  const Eigen::Vector3d p_world = placed->box.BottomCenterWorld();
  sighting.place_m = axes_.FromWorld(p_world);
  sighting.center_px = box_px.center_px();
  const Eigen::Vector2d sigma_px =
      ((kCenterSigmaOfBox + sigma_of_box) * box_px.size_px()).array() +
      kCenterSigma_px;
  const Eigen::Matrix2d J = placed->place_by_center_m_px;
  sighting.covariance_m2 =
      J * sigma_px.cwiseAbs2().asDiagonal() * J.transpose() +
      PoseCovariance(camera, p_world);
  const Eigen::Vector2d innovation = sighting.place_m - state.position_m;
  const Eigen::Matrix2d S = ground_covariance_m2() + sighting.covariance_m2;
  sighting.innovation.surprise = innovation.dot(S.ldlt().solve(innovation));
  sighting.innovation.sigma_px2 =
      std::sqrt(S.determinant()) / std::abs(J.determinant());
  return sighting;
}

void GroundTarget::Update(const CameraView& camera,
                          const GroundSighting& sighting) {
  // No velocity: differences of positions that the filter has already taken say
  // nothing new.
  motion::GroundMeasurement measurement;
  measurement.position_m = sighting.place_m;
  measurement.covariance_m2 = sighting.covariance_m2;
  const double step_s = Seconds(time_ - last_sighting_time_);
  if (step_s > kUnseen_s) heading_sigma_rad_ = HeadingSigma_rad();
  motion_->Update(measurement);
  NoteLeaving(sighting);
  Settle();
  last_sighting_ = sighting;
  last_sighting_time_ = time_;
  if (sighting.heading_rad) {
    heading_rad_ = *sighting.heading_rad;
    NoteHeading(sighting.heading_sigma_rad);
    turned_unseen_ = false;
  } else if (heading_known_) {
    FollowHeading(step_s);
  } else {
    LearnHeadingFromStart(camera, sighting.center_px);
  }
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
  const auto after = PlaceNearby(camera, last_sighting_->center_px);
  if (!before || !after) return;
  const Eigen::Vector2d shift_m =
      axes_.FromWorld(after->box.BottomCenterWorld()) -
      axes_.FromWorld(before->box.BottomCenterWorld());
  motion_->Shift(shift_m);
  last_sighting_->place_m += shift_m;
}

void GroundTarget::FollowSize(const CameraView& camera,
                              const Eigen::Vector2d& size_px) {
  const auto seen_px = SeenSize_px(camera);
  if (seen_px) {
    FollowGrowth(camera, std::sqrt(size_px.prod() / seen_px->prod()));
  }
}

double GroundTarget::DistanceTo(const GroundSighting& sighting) const {
  return last_sighting_ ? (sighting.place_m - last_sighting_->place_m).norm()
                        : 0.0;
}

void GroundTarget::TellVelocity(const CameraView& camera,
                                const Eigen::Vector2d& velocity_px_s,
                                double sigma_px_s,
                                GroundSighting& sighting) const {
  const auto placed = Place(camera, sighting.center_px, sighting.place_m);
  if (!placed) return;
  const Eigen::Matrix2d J = placed->place_by_center_m_px;
  sighting.velocity_m_s = J * velocity_px_s;
  sighting.velocity_covariance_m2_s2 =
      sigma_px_s * sigma_px_s * J * J.transpose();
}

void GroundTarget::Restart(const GroundSighting& sighting) {
  motion::GroundMeasurement measurement;
  measurement.position_m = sighting.place_m;
  measurement.covariance_m2 = sighting.covariance_m2;
  measurement.velocity_m_s = sighting.velocity_m_s;
  measurement.velocity_covariance_m2_s2 = sighting.velocity_covariance_m2_s2;
  motion_->Initialize(time_, measurement);
  Settle();
  NoteLeaving(sighting);
  turned_unseen_ = true;
  heading_sigma_rad_ = HeadingSigma_rad();
  last_sighting_ = sighting;
  last_sighting_time_ = time_;
}

void GroundTarget::FollowView(const CameraView& camera, bool learns) {
  const double view_rad = ViewAngle_rad(camera);
  if (!learns && heading_known_) view_rad_ = view_rad;
  const double turn_rad = std::abs(WrapAngle_rad(view_rad - view_rad_));
  if (center_ != BoxCenter::kTexture || turn_rad < kLeastTurn_rad) return;
  const auto outline = BodyHull(camera, box());
  if (!outline) return;
  view_rad_ = view_rad;
  const double share = 1.0 - std::exp(-turn_rad / kFollowView_rad);
  texture_object_ +=
      share * (ground::PointOnRay(
                   camera.view, box(), outline->center_px(), kTextureDepth) -
               texture_object_);
}

geometry::Plane GroundTarget::TangentAt(const Eigen::Vector2d& place_m) const {
  const auto patch = surface_->At(axes_.ToWorld(place_m));
  return patch ? patch->tangent_world : last_tangent_world_;
}

Eigen::Vector3d GroundTarget::OnGround(const Eigen::Vector2d& place_m) const {
  const geometry::Plane tangent_world = TangentAt(place_m);
  const Eigen::Vector3d& up = surface_->reference_world().normal;
  const Eigen::Vector3d below = axes_.ToWorld(place_m);
  return below - tangent_world.SignedDistance(below) /
                     tangent_world.normal.dot(up) * up;
}

Eigen::Matrix2d GroundTarget::FromTangent(
    const geometry::Plane& tangent_world) const {
  if (tangent_world.normal == surface_->reference_world().normal) {
    return Eigen::Matrix2d::Identity();
  }
  return axes_.axes_world.transpose() *
         geometry::PlaneAxes(tangent_world).axes_world;
}

void GroundTarget::Settle() {
  const auto patch = surface_->At(axes_.ToWorld(motion_->state().position_m));
  if (patch) last_tangent_world_ = patch->tangent_world;
}

Box3 GroundTarget::BodyAt(const Eigen::Vector2d& place_m) const {
  return ground::UprightBox(
      TangentAt(place_m), OnGround(place_m), HeadingWorld(), size_m_);
}

ground::ShapePrior GroundTarget::ShapeAlongWay() const {
  return kind_ != nullptr ? kind_->Shape() : ShapeOf(size_m_);
}

Box3 GroundTarget::box() const { return BodyAt(motion_->state().position_m); }

Box3 GroundTarget::BoxAt(std::chrono::nanoseconds time) const {
  const motion::GroundState state = motion_->state();
  return BodyAt(state.position_m + Seconds(time - time_) * state.velocity_m_s);
}

ExpectedMotion GroundTarget::MotionSince(std::chrono::nanoseconds time) const {
  const double step_s = Seconds(time_ - time);
  const motion::GroundState state = motion_->state();
  const Eigen::Vector2d& v = state.velocity_m_s;
  const Eigen::Vector2d& a = state.acceleration_m_s2;
  const double speed2 = v.squaredNorm();
  const double turn_rad_s =
      speed2 > 0.0 ? std::clamp((v.x() * a.y() - v.y() * a.x()) / speed2,
                                -kFastestTurn_rad_s,
                                kFastestTurn_rad_s)
                   : 0.0;
  const Box3 now = box();
  const Eigen::Quaterniond& rotation = now.world_from_object.rotation;
  const Eigen::Vector3d p_now_world = now.BottomCenterWorld();
  return {.world_from_body = {rotation, p_now_world},
          .world_from_body_before = {
              rotation * Eigen::Quaterniond(Eigen::AngleAxisd(
                             -turn_rad_s * step_s, Eigen::Vector3d::UnitZ())),
              p_now_world - step_s * velocity_world_m_s()}};
}

std::optional<Eigen::Vector2d> GroundTarget::FollowedPoint(
    const CameraView& camera) const {
  return camera.view.camera->ImageFromCamera(
      camera.view.world_from_camera.Inverse() *
      (box().world_from_object * texture_object_));
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
  const auto point_px = FollowedPoint(camera);
  if (!point_px) return hull;
  const double ratio = outline_scale_.ratio();
  return Box2{*point_px + ratio * (hull->min_px - *point_px),
              *point_px + ratio * (hull->max_px - *point_px)};
}

std::optional<Box2> GroundTarget::ProjectAbout(
    const CameraView& camera, const Eigen::Vector2d& center_px) const {
  const auto outline = Project(camera);
  if (!outline || center_ == BoxCenter::kOutline) return outline;
  const auto point_px = FollowedPoint(camera);
  if (!point_px) return outline;
  const Eigen::Vector2d shift_px = center_px - *point_px;
  return Box2{outline->min_px + shift_px, outline->max_px + shift_px};
}

std::optional<Box2> GroundTarget::ProjectForTracker(
    const CameraView& camera) const {
  const auto outline = Project(camera);
  if (!outline || center_ == BoxCenter::kOutline) return outline;
  const auto center_px = FollowedPoint(camera);
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

std::optional<Eigen::Vector2d> GroundTarget::LastSightedCenter(
    const CameraView& camera) const {
  if (!last_sighting_) return std::nullopt;
  const Box3 there = BodyAt(last_sighting_->place_m);
  return camera.view.camera->ImageFromCamera(
      camera.view.world_from_camera.Inverse() *
      (there.world_from_object * texture_object_));
}

std::optional<ground::PlacedBox> GroundTarget::PlaceNearby(
    const CameraView& camera, const Eigen::Vector2d& center_px) const {
  return Place(camera, center_px, motion_->state().position_m);
}

std::optional<ground::PlacedBox> GroundTarget::Place(
    const CameraView& camera,
    const Eigen::Vector2d& center_px,
    Eigen::Vector2d place_m) const {
  for (int round = 0; round < kMaxPlaceRounds; ++round) {
    const geometry::Plane tangent_world = TangentAt(place_m);
    const ground::GroundView view = Over(camera, tangent_world);
    auto placed =
        center_ == BoxCenter::kTexture
            ? ground::PlaceBoxByPoint(
                  view, center_px, HeadingWorld(), size_m_, texture_object_)
            : ground::PlaceBoxByCenter(
                  view, center_px, HeadingWorld(), size_m_, OnGround(place_m));
    if (!placed) return std::nullopt;
    place_m = axes_.FromWorld(placed->box.BottomCenterWorld());
    if (!IsOn(TangentAt(place_m), placed->box)) continue;
    placed->place_by_center_m_px =
        FromTangent(tangent_world) * placed->place_by_center_m_px;
    return placed;
  }
  return std::nullopt;
}

Eigen::Matrix2d GroundTarget::PoseCovariance(
    const CameraView& camera, const Eigen::Vector3d& p_world) const {
  const geometry::Plane tangent_world = TangentAt(axes_.FromWorld(p_world));
  const Eigen::Matrix2d to_axes = FromTangent(tangent_world);
  return to_axes *
         ground::GroundCovarianceFromPose(
             Over(camera, tangent_world), p_world, camera.pose_covariance) *
         to_axes.transpose();
}

std::optional<Eigen::Matrix2d> GroundTarget::ImageCovariance(
    const CameraView& camera) const {
  const auto hull = ProjectForTracker(camera);
  if (!hull) return std::nullopt;
  const auto placed = PlaceNearby(camera, hull->center_px());
  if (!placed) return std::nullopt;
  const Eigen::Matrix2d J = placed->place_by_center_m_px.inverse();
  return Eigen::Matrix2d(J * ground_covariance_m2() * J.transpose());
}

double GroundTarget::ViewAngle_rad(const CameraView& camera) const {
  const geometry::Rigid3& pose = camera.view.world_from_camera;
  const Eigen::Vector3d ray =
      (OnGround(motion_->state().position_m) - pose.translation).normalized();
  const Eigen::Vector3d up = pose.rotation * -Eigen::Vector3d::UnitY();
  const Eigen::Vector2d away = axes_.axes_world.transpose() * (ray + up);
  return WrapAngle_rad(std::atan2(away.y(), away.x()) - heading_rad_ +
                       unturned_rad_);
}

Eigen::Matrix2d GroundTarget::ground_covariance_m2() const {
  // The shape's error moves all sightings alike, so the filter, which follows
  // the apparent centre, must not average over it.
  const double shape = (fitted_ && !has_moved() ? kFittedSigma : kShapeSigma) *
                       TypicalSize(size_m_);
  return motion_->state().position_covariance_m2 +
         shape * shape * Eigen::Matrix2d::Identity();
}

Eigen::Matrix3d GroundTarget::SizeCovariance_m2() const {
  return size_m_.asDiagonal() *
         (log_size_covariance_ + kReportedSizeSigma * kReportedSizeSigma *
                                     Eigen::Matrix3d::Identity()) *
         size_m_.asDiagonal();
}

double GroundTarget::RangeSigma_m(const CameraView& camera) const {
  const Eigen::Vector2d way =
      motion_->state().position_m -
      axes_.FromWorld(camera.view.world_from_camera.translation);
  const Eigen::Matrix2d covariance = ground_covariance_m2();
  // From straight above no direction is "away".
  if (!(way.norm() > 0.0)) return std::sqrt(covariance.trace());
  const Eigen::Vector2d direction = way.normalized();
  return std::sqrt(direction.dot(covariance * direction));
}

Eigen::Vector3d GroundTarget::velocity_world_m_s() const {
  const motion::GroundState state = motion_->state();
  const Eigen::Vector3d level = axes_.DirectionToWorld(state.velocity_m_s);
  const Eigen::Vector3d& up = surface_->reference_world().normal;
  const Eigen::Vector3d normal = TangentAt(state.position_m).normal;
  return level - normal.dot(level) / normal.dot(up) * up;
}

}  // namespace groundlock::tracking
