// SPDX-License-Identifier: Apache-2.0
// Where on the ground a target is that is seen somewhere in the image.
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>

#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::Box3;

// Frame-to-frame error of a detection's centre: so much, and so much of the
// box's side (a correlation filter's cell is 1/64 of the padded patch).
constexpr double kCenterSigma_px = 0.5;
constexpr double kCenterSigmaOfBox = 0.02;
// Where the ground tells no distance: the step, of a side, over which what
// moves the target in the image is measured, and how far off, in sides, the
// target may be along a bearing.
constexpr double kBearingStep = 0.05;
constexpr double kAnyDistance = 10.0;
// The ground's height where it is not known, in sides of the target (1 sigma).
constexpr double kUnknownHeight = 0.5;
// Of the target's side, to which the ground's height is met.
constexpr double kOnGround = 1e-3;

// What does as it likes may speed up by so much all the time, sides / s^2 (1
// sigma).
constexpr double kAnyAcceleration = 1.0;

// A place that is improved by less, in sides, is found.
constexpr double kSettledStep = 0.01;
// What is so many times larger or smaller than where a search looked, as beyond
// a crest, is looked at again in its own size. Not measured apart from the runs
// in docs/method.md.
constexpr double kOtherSize = 1.2;
// Its distance by its size is known to a few percent after so many.
constexpr int kSizeRounds = 3;

Eigen::Vector2d CenterSigma_px(const Box2& box_px, double sigma_of_box) {
  return ((kCenterSigmaOfBox + sigma_of_box) * box_px.size_px()).array() +
         kCenterSigma_px;
}

}  // namespace

ground::GroundView GroundTarget::Over(const CameraView& camera,
                                      const geometry::Plane& tangent_world) {
  ground::GroundView view = camera.view;
  view.ground_world = tangent_world;
  return view;
}

bool GroundTarget::IsOn(const geometry::Plane& tangent_world, const Box3& box) {
  return std::abs(tangent_world.SignedDistance(box.BottomCenterWorld())) <=
         kOnGround * Side(box.size_m);
}

GroundSighting GroundTarget::SightAt(
    const CameraView& camera,
    const Eigen::Vector3d& p_world,
    const Eigen::Matrix2d& covariance_m2) const {
  GroundSighting sighting;
  sighting.place_m = axes_.FromWorld(p_world);
  sighting.covariance_m2 = covariance_m2 + PoseCovariance(camera, p_world);
  sighting.innovation.surprise = motion_->Surprise(
      sighting.place_m, ShapeCovariance_m2() + sighting.covariance_m2);
  return sighting;
}

std::optional<GroundSighting> GroundTarget::Lift(const CameraView& camera,
                                                 const Box2& box_px,
                                                 double sigma_of_box) const {
  auto placed = PlaceNearby(camera, box_px.center_px());
  const Eigen::Vector2d sigma_px = CenterSigma_px(box_px, sigma_of_box);
  if (!placed) {
    auto bearing = SightBearing(camera, box_px.center_px(), sigma_px);
    if (bearing) return bearing;
    // Far from where it was predicted, with hills between.
    placed = PlaceOnRay(camera, box_px.center_px());
    if (!placed) return std::nullopt;
  }
  return SightPlaced(camera, *placed, box_px, sigma_px);
}

std::optional<GroundSighting> GroundTarget::LiftAsLarge(
    const CameraView& camera, const Box2& box_px) const {
  const auto placed = PlaceAsLarge(camera, box_px);
  if (!placed) return Lift(camera, box_px);
  return SightPlaced(camera, *placed, box_px, CenterSigma_px(box_px, 0.0));
}

GroundSighting GroundTarget::SightPlaced(
    const CameraView& camera,
    const ground::PlacedBox& placed,
    const Box2& box_px,
    const Eigen::Vector2d& sigma_px) const {
  GroundSighting sighting;
  const Eigen::Vector3d p_world = placed.box.BottomCenterWorld();
  sighting.place_m = axes_.FromWorld(p_world);
  sighting.center_px = box_px.center_px();
  const Eigen::Matrix2d& J = placed.place_by_center_m_px;
  sighting.covariance_m2 =
      J * sigma_px.cwiseAbs2().asDiagonal() * J.transpose() +
      PoseCovariance(camera, p_world);
  sighting.innovation.surprise = motion_->Surprise(
      sighting.place_m, ShapeCovariance_m2() + sighting.covariance_m2);
  const Eigen::Matrix2d S = ApparentCovariance_m2() + sighting.covariance_m2;
  sighting.innovation.sigma_px2 =
      std::sqrt(S.determinant()) / std::abs(J.determinant());
  return sighting;
}

std::optional<GroundTarget::SeenFrom> GroundTarget::SeeFrom(
    const CameraView& camera,
    const Eigen::Vector2d& center_px,
    const Eigen::Vector2d& place_m) const {
  const auto expected_px = FollowedPointAt(camera, BodyAt(place_m));
  const auto way = WayInImage(camera, place_m);
  if (!expected_px || !way) return std::nullopt;
  return SeenFrom{place_m, center_px - *expected_px, *way};
}

std::optional<GroundSighting> GroundTarget::SightBearing(
    const CameraView& camera,
    const Eigen::Vector2d& center_px,
    const Eigen::Vector2d& sigma_px) const {
  if (!last_sighting_) return std::nullopt;
  const Eigen::Vector2d place_m = motion_->state().position_m;
  auto there = SeeFrom(camera, center_px, place_m);
  const auto rise = RiseInImage(camera, BodyAt(place_m));
  if (!there || !rise) return std::nullopt;
  const Eigen::Vector2d risen_px = *rise * GroundSigmasAt(place_m)[0];
  Eigen::Matrix2d R = sigma_px.cwiseAbs2().asDiagonal();
  R += risen_px * risen_px.transpose();
  const Eigen::Matrix2d predicted_m2 = ApparentCovariance_m2();
  const Eigen::Matrix2d S =
      there->to_px * predicted_m2 * there->to_px.transpose() + R;
  GroundSighting sighting;
  sighting.is_bearing = true;
  sighting.center_px = center_px;
  sighting.innovation.surprise =
      there->off_px.dot(S.ldlt().solve(there->off_px));
  sighting.innovation.sigma_px2 = std::sqrt(S.determinant());
  // Anywhere else it has no place at all.
  if (!(sighting.innovation.surprise <= kGate)) return std::nullopt;
  // Over hills the image is far from linear in the place: it is linearised
  // where the target is likeliest, by the prediction and by what is seen.
  const Eigen::LDLT<Eigen::Matrix2d> noise(R);
  const Eigen::Matrix2d known = predicted_m2.inverse();
  for (int round = 0; round < kMaxPlaceRounds; ++round) {
    const Eigen::Matrix2d weighted = noise.solve(there->to_px);
    const Eigen::Vector2d step_m =
        (there->to_px.transpose() * weighted + known)
            .ldlt()
            .solve(weighted.transpose() * there->off_px +
                   known * (place_m - there->place_m));
    there = SeeFrom(camera, center_px, there->place_m + step_m);
    if (!there) return std::nullopt;
    if (step_m.norm() < kSettledStep * Side(size_m_)) break;
  }
  const Eigen::Vector2d moved_m = there->place_m - place_m;
  // No place about there is where it is seen.
  if (!(there->off_px.dot(noise.solve(there->off_px)) +
            moved_m.dot(known * moved_m) <=
        kGate)) {
    return std::nullopt;
  }
  const double any_m = kAnyDistance * Side(size_m_);
  const Eigen::Matrix2d weighted = noise.solve(there->to_px);
  sighting.covariance_m2 = (there->to_px.transpose() * weighted +
                            Eigen::Matrix2d::Identity() / (any_m * any_m))
                               .inverse();
  sighting.place_m = place_m + sighting.covariance_m2 * weighted.transpose() *
                                   (there->off_px + there->to_px * moved_m);
  return sighting;
}

void GroundTarget::GoWith(const CameraView& camera,
                          const std::optional<ground::PlacedBox>& before) {
  // A bearing tells no place that could be another.
  const auto after = PlaceNearby(camera, last_sighting_->center_px);
  if (!before || !after || last_sighting_->is_bearing) return;
  const Eigen::Vector2d shift_m =
      axes_.FromWorld(after->box.BottomCenterWorld()) -
      axes_.FromWorld(before->box.BottomCenterWorld());
  motion_->Shift(shift_m);
  last_sighting_->place_m += shift_m;
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

bool GroundTarget::GoesOverGround(const CameraView& camera,
                                  const Eigen::Vector2d& velocity_px_s,
                                  double error_px_s,
                                  double sides_s) const {
  const auto way = WayInImage(camera, motion_->state().position_m);
  if (!way) return false;
  const Eigen::Matrix2d to_m = way->inverse();
  const Eigen::Vector2d velocity_m_s = to_m * velocity_px_s;
  const double speed_m_s = velocity_m_s.norm();
  if (!std::isfinite(speed_m_s) || !(speed_m_s > 0.0)) return false;
  const double error_m_s =
      error_px_s * (to_m.transpose() * velocity_m_s).norm() / speed_m_s;
  return speed_m_s - error_m_s > sides_s * Side(size_m_);
}

std::optional<Eigen::Vector2d> GroundTarget::LastSightedCenter(
    const CameraView& camera) const {
  if (!last_sighting_) return std::nullopt;
  return FollowedPointAt(camera, BodyAt(last_sighting_->place_m));
}

std::optional<Eigen::Vector2d> GroundTarget::FollowedPointAt(
    const CameraView& camera, const Box3& box) const {
  return camera.view.camera->ImageFromCamera(
      camera.view.world_from_camera.Inverse() *
      (box.world_from_object * texture_object_));
}

std::optional<Eigen::Matrix2d> GroundTarget::WayInImage(
    const CameraView& camera, const Eigen::Vector2d& place_m) const {
  const double step_m = kBearingStep * Side(size_m_);
  const auto before_px = FollowedPointAt(camera, BodyAt(place_m));
  if (!before_px) return std::nullopt;
  Eigen::Matrix2d way;
  for (int k = 0; k < 2; ++k) {
    const auto after_px = FollowedPointAt(
        camera, BodyAt(place_m + step_m * Eigen::Vector2d::Unit(k)));
    if (!after_px) return std::nullopt;
    way.col(k) = (*after_px - *before_px) / step_m;
  }
  return way;
}

std::optional<Eigen::Vector2d> GroundTarget::RiseInImage(
    const CameraView& camera, Box3 box) const {
  const double step_m = kBearingStep * Side(size_m_);
  const auto before_px = FollowedPointAt(camera, box);
  box.world_from_object.translation +=
      step_m * surface_->reference_world().normal;
  const auto after_px = FollowedPointAt(camera, box);
  if (!before_px || !after_px) return std::nullopt;
  return Eigen::Vector2d((*after_px - *before_px) / step_m);
}

std::optional<Eigen::Vector2d> GroundTarget::WayPerHeight(
    const CameraView& camera, const Eigen::Vector2d& place_m) const {
  const auto way = WayInImage(camera, place_m);
  const auto rise = RiseInImage(camera, BodyAt(place_m));
  if (!way || !rise) return std::nullopt;
  const Eigen::Vector2d per_height = -way->inverse() * *rise;
  if (!per_height.allFinite()) return std::nullopt;
  const double most = kAnyDistance * Side(size_m_) / FollowedHeightSigma_m();
  return Eigen::Vector2d(per_height * std::min(1.0, most / per_height.norm()));
}

double GroundTarget::FollowedHeightSigma_m() const {
  const double height_m =
      0.5 * size_m_.z() +
      (center_ == BoxCenter::kTexture ? texture_object_.z() : 0.0);
  return height_m * std::sqrt(log_size_covariance_(2, 2));
}

Eigen::Vector3d GroundTarget::ground_sigmas() const {
  return GroundSigmasAt(motion_->state().position_m);
}

Eigen::Vector3d GroundTarget::GroundSigmasAt(
    const Eigen::Vector2d& place_m) const {
  // What a whole plane is off by moves the target nowhere.
  if (surface_->IsPlane()) return Eigen::Vector3d::Zero();
  const auto patch = surface_->At(axes_.ToWorld(place_m));
  const double height_sigma_m =
      patch ? patch->height_sigma_m : kUnknownHeight * Side(size_m_);
  const double slope_sigma_rad =
      patch ? patch->slope_sigma_rad : kUnknownHeight / ground::kGroundSides;
  return {height_sigma_m, slope_sigma_rad, slope_sigma_rad};
}

geometry::Plane GroundTarget::ground_as_known() const {
  const auto patch = surface_->At(axes_.ToWorld(motion_->state().position_m));
  return patch ? patch->tangent_world : last_tangent_world_;
}

std::optional<ground::PlacedBox> GroundTarget::PlaceNearby(
    const CameraView& camera, const Eigen::Vector2d& center_px) const {
  return Place(camera, center_px, motion_->state().position_m);
}

std::optional<ground::PlacedBox> GroundTarget::PlaceOnRay(
    const CameraView& camera, const Eigen::Vector2d& center_px) const {
  const auto ray = ground::RayWorld(camera.view, center_px);
  const auto seen =
      ray ? surface_->IntersectRay(camera.view.world_from_camera.translation,
                                   *ray,
                                   ground::kMaxRange_m)
          : std::nullopt;
  return Place(camera,
               center_px,
               seen ? axes_.FromWorld(*seen) : motion_->state().position_m);
}

std::optional<ground::PlacedBox> GroundTarget::PlaceAsLarge(
    const CameraView& camera, const Box2& box_px) const {
  const auto ray = ground::RayWorld(camera.view, box_px.center_px());
  if (!ray) return std::nullopt;
  const Eigen::Vector3d& eye = camera.view.world_from_camera.translation;
  const auto times_as_large = [&](const Box3& body) -> std::optional<double> {
    const auto outline_px = OutlineOf(camera, body);
    if (!outline_px) return std::nullopt;
    return outline_scale_.ratio() *
           std::sqrt(outline_px->Area() / box_px.Area());
  };
  // As far along the ray as it was predicted, wherever that is. If it would
  // look twice as large there as what was found, that is twice as far away, but
  // for what the view changes of its outline.
  double range_m = (box().world_from_object.translation - eye).norm();
  for (int round = 0; round < kSizeRounds; ++round) {
    const Box3 body = BodyAt(axes_.FromWorld(eye + range_m * *ray));
    const auto times = times_as_large(body);
    if (!times) return std::nullopt;
    range_m = *times * (body.world_from_object.translation - eye).norm();
  }
  auto placed =
      Place(camera, box_px.center_px(), axes_.FromWorld(eye + range_m * *ray));
  const auto times = placed ? times_as_large(placed->box) : std::nullopt;
  // Negated so that a NaN is none.
  if (!times || !(std::max(*times, 1.0 / *times) <= kOtherSize)) {
    return std::nullopt;
  }
  return placed;
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
    const CameraView& camera, double any_motion_s) const {
  const auto hull = ProjectForTracker(camera);
  if (!hull) return std::nullopt;
  const auto placed = PlaceNearby(camera, hull->center_px());
  std::optional<Eigen::Matrix2d> J;
  if (placed) {
    J = placed->place_by_center_m_px.inverse();
  } else {
    J = WayInImage(camera, motion_->state().position_m);
  }
  if (!J) return std::nullopt;
  const double any_m =
      0.5 * kAnyAcceleration * Side(size_m_) * any_motion_s * any_motion_s;
  return Eigen::Matrix2d(
      *J *
      (ApparentCovariance_m2() + any_m * any_m * Eigen::Matrix2d::Identity()) *
      J->transpose());
}

}  // namespace groundlock::tracking
