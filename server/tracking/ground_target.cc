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
// How well all extents together are known.
double CommonSigma(const Eigen::Matrix3d& log_covariance) {
  return std::sqrt(log_covariance.mean());
}

// Its edges are the body's, and not the image's.
bool IsWhole(const geometry::CameraModel& camera, const Box2& box_px) {
  return box_px.min_px.minCoeff() > kImageEdge_px &&
         box_px.max_px.x() < camera.width_px() - kImageEdge_px &&
         box_px.max_px.y() < camera.height_px() - kImageEdge_px;
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
    const motion::MotionOptions& options,
    const std::optional<BodyKind>& told) {
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
    const auto again = ground::FitBox(
        Over(camera, patch->tangent_world), box_px, std::nullopt, kAnyShape);
    // On a crest the ground faces away where the middle stands, and is met far
    // behind, if at all: what is seen at its feet tells the place.
    if (!again.ok() ||
        (again->BottomCenterWorld() - box.BottomCenterWorld()).norm() >
            kStartsWithin * Side(box.size_m)) {
      break;
    }
    tangent_world = patch->tangent_world;
    box = *again;
  }
  const ground::GroundView view = Over(camera, tangent_world);
  std::optional<KindFit> kind;
  if (told) {
    kind = FitKind(view, box_px, *told, camera.metric);
  } else if (camera.metric && IsWhole(*camera.view.camera, box_px)) {
    kind = FitLikelyKind(view, box_px);
  }
  if (kind) box = kind->fit.box;
  GroundTarget target(std::move(surface), tangent_world, camera, box_px);
  target.center_ = center;
  target.ground_errors_.mean[0] = start.rise_m;
  const Eigen::Vector2d heading =
      target.axes_.axes_world.transpose() *
      (box.world_from_object.rotation * Eigen::Vector3d::UnitX());
  target.heading_rad_ = std::atan2(heading.y(), heading.x());
  target.size_m_ = box.size_m;
  if (!kind && target.size_m_.y() > target.size_m_.x()) {
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
    target.kind_size_ = camera.metric || kind->kind.was_measured
                            ? kind->kind.Size()
                            : kind->kind.SizeInAnyUnit(Side(box.size_m));
    target.log_size_covariance_ = kind->fit.log_size_covariance;
    target.outline_scale_ =
        OutlineScale(CommonSigma(kind->fit.log_size_covariance));
    target.NoteHeading(kind->axis_sigma_rad);
  }
  target.start_place_m_ = target.axes_.FromWorld(box.BottomCenterWorld());
  motion::MotionOptions scaled = options;
  scaled.target_size_m = options.target_size_m * TypicalSize(box.size_m);
  ASSIGN_OR_RETURN(target.motion_, motion::CreateMotionPredictor(scaled));
  target.time_ = time;
  GroundSighting sighting;
  sighting.place_m = target.start_place_m_;
  sighting.center_px = box_px.center_px();
  target.Restart(sighting);
  // From there: a ray may meet the ground of hills more than once.
  const auto lifted = target.Lift(camera, box_px);
  if (lifted && !lifted->is_bearing && target.StartsAt(lifted->place_m)) {
    target.Restart(*lifted);
  }
  target.way_per_height_ = target.start_way_per_height_ =
      target.way_from_per_height_ =
          target.WayPerHeight(camera, target.motion_->state().position_m)
              .value_or(Eigen::Vector2d::Zero());
  target.way_from_m_ = target.start_place_m_;
  // It has not gone on yet, wherever its first sighting was put.
  target.ground_errors_ = {
      .mean = start.rise_m * Eigen::Vector3d::UnitX(),
      .covariance = target.ground_sigmas().cwiseAbs2().asDiagonal()};
  target.view_rad_ = target.ViewAngle_rad(camera);
  return target;
}

bool GroundTarget::StartsAt(const Eigen::Vector2d& place_m) const {
  return (place_m - start_place_m_).norm() < kStartsWithin * Side(size_m_);
}

void GroundTarget::Predict(std::chrono::nanoseconds time) {
  const double step_s = std::max(0.0, Seconds(time - time_));
  motion_->Predict(time);
  TurnAlongWay(step_s);
  outline_scale_.Predict(step_s);
  time_ = std::max(time, time_);
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
  if (last_sighting_) GoOnFrom(last_sighting_->place_m);
  way_per_height_ = WayPerHeight(camera, motion_->state().position_m)
                        .value_or(way_per_height_);
  last_sighting_ = sighting;
  last_sighting_time_ = time_;
  // A bearing tells no place of its own.
  if (sighting.is_bearing) {
    last_sighting_->place_m = motion_->state().position_m;
  }
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

void GroundTarget::Restart(const GroundSighting& sighting) {
  motion::GroundMeasurement measurement;
  measurement.position_m = sighting.place_m;
  measurement.covariance_m2 = sighting.covariance_m2;
  measurement.velocity_m_s = sighting.velocity_m_s;
  measurement.velocity_covariance_m2_s2 = sighting.velocity_covariance_m2_s2;
  motion_->Initialize(time_, measurement);
  Settle();
  if (last_sighting_) GoOnFrom(last_sighting_->place_m);
  NoteLeaving(sighting);
  turned_unseen_ = true;
  heading_sigma_rad_ = HeadingSigma_rad();
  last_sighting_ = sighting;
  last_sighting_time_ = time_;
}

void GroundTarget::GoOnFrom(const Eigen::Vector2d& before_m) {
  const Eigen::Vector2d place_m = motion_->state().position_m;
  ground_errors_.GoOn(
      (place_m - before_m).norm() / (ground::kGroundSides * Side(size_m_)),
      ground_sigmas());
}

geometry::Plane GroundTarget::TangentAt(const Eigen::Vector2d& place_m) const {
  const auto patch = surface_->At(axes_.ToWorld(place_m));
  const geometry::Plane known_world =
      patch ? patch->tangent_world : last_tangent_world_;
  if (ground_errors_.mean.isZero(0.0)) return known_world;
  const Eigen::Vector3d& up = surface_->reference_world().normal;
  const Eigen::Vector3d below = axes_.ToWorld(place_m);
  const double upright = known_world.normal.dot(up);
  const Eigen::Vector3d p_world =
      below +
      (ground_errors_.rise_m() - known_world.SignedDistance(below) / upright) *
          up;
  // In the ground, and along the axes as told.
  const Eigen::Vector3d along =
      axes_.DirectionToWorld(ground_errors_.tilt_rad());
  const Eigen::Vector3d tilt_rad =
      along - known_world.normal.dot(along) / upright * up;
  const Eigen::Vector3d normal =
      (known_world.normal + tilt_rad.cross(known_world.normal)).normalized();
  return {normal, -normal.dot(p_world)};
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

ground::SizePrior GroundTarget::SizeAlongWay() const {
  return kind_ ? kind_size_ : ground::SizePriorOf(ShapeOf(size_m_));
}

Box3 GroundTarget::box() const { return BodyAt(motion_->state().position_m); }

Box3 GroundTarget::BoxAt(std::chrono::nanoseconds time) const {
  const motion::GroundState state = motion_->state();
  return BodyAt(state.position_m + Seconds(time - time_) * state.velocity_m_s);
}

ExpectedMotion GroundTarget::MotionSince(std::chrono::nanoseconds time) const {
  const double step_s = Seconds(time_ - time);
  const motion::GroundState state = motion_->state();
  const Box3 now = box();
  const Eigen::Quaterniond& rotation = now.world_from_object.rotation;
  const Eigen::Vector3d p_now_world = now.BottomCenterWorld();
  return {
      .world_from_body = {rotation, p_now_world},
      .world_from_body_before = {
          rotation * Eigen::Quaterniond(Eigen::AngleAxisd(
                         -state.turn_rad_s * step_s, Eigen::Vector3d::UnitZ())),
          p_now_world - step_s * velocity_world_m_s()}};
}

Eigen::Matrix2d GroundTarget::ShapeCovariance_m2() const {
  // The shape's error moves all sightings alike, so the filter, which follows
  // the apparent centre, must not average over it.
  const double shape_m =
      (fitted_ && !has_moved() ? kFittedSigma : kShapeSigma) *
      TypicalSize(size_m_);
  return shape_m * shape_m * Eigen::Matrix2d::Identity();
}

Eigen::Matrix2d GroundTarget::ApparentCovariance_m2() const {
  return motion_->state().position_covariance_m2 + ShapeCovariance_m2();
}

Eigen::Matrix2d GroundTarget::ground_covariance_m2() const {
  // At the start its feet told where it stands.
  const Eigen::Vector2d by_height_m =
      FollowedHeightSigma_m() * (way_per_height_ - start_way_per_height_);
  return ApparentCovariance_m2() + by_height_m * by_height_m.transpose();
}

Eigen::Matrix3d GroundTarget::SizeCovariance_m2() const {
  // Of a size that was told there is nothing more to be unsure of.
  const double at_least =
      kind_ && kind_->was_measured ? 0.0 : kReportedSizeSigma;
  return size_m_.asDiagonal() *
         (log_size_covariance_ +
          at_least * at_least * Eigen::Matrix3d::Identity()) *
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
