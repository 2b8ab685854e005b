// SPDX-License-Identifier: Apache-2.0
// A body that goes along the ground: what points of it tell (docs/method.md, "A
// body in motion").
#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <span>
#include <vector>

#include "server/tracking/body_size.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::Box3;
using geometry::Rigid3;

// How well the first box tells how far away, and so how large, a body is.
constexpr double kFirstScaleSigma = 0.1;
// The views must have turned by so much.
constexpr double kLeastViewTurn_rad = 20.0 * std::numbers::pi / 180.0;
// Without so many points of it the view in which it was drawn is another's.
constexpr std::size_t kMinSeenAsDrawn = 4;
// A body does not change: what is measured again of another size (chi-square, 3
// degrees, 99 %), but for the error of a box as its shape, is of points that
// went over to something else.
constexpr double kSameBody = 11.3;
// One is like others of its shape, and heads about as its way tells, when it is
// measured for the first time (chi-square, 4 degrees, 99 %).
constexpr double kSuchABody = 13.3;
constexpr double kShapeError = 0.1;
// Fits share most of their points and err alike: their mean counts, the last
// one for so much at least.
constexpr double kLeastGain = 0.1;
// Of each extent, of a body that was only drawn.
constexpr double kUnfittedSigma = 0.25;
// A fit's time is mostly that of its outlines.
constexpr std::size_t kMostOutlines = 8;
// What points of a body have in common of the errors of its structure, of its
// side.
constexpr double kPointsSigma = 0.03;
// Of a point in the image: as it is followed, and of its place on the body, of
// the outline.
constexpr double kSightSigma_px = 0.5;
constexpr double kSightSigma = 0.01;
// A body is where this share of its points that are seen agree that it is (see
// BodyFollower::IsSeenAtRest: a patch of something else ends where the point
// would be in one of ten cases at most).
constexpr double kShareAgreeing = 0.66;
// And where the 2D tracker found it no farther away, of its outline.
constexpr double kAside = 0.25;
// What patches have in common of the errors of their places on a body whose
// shape is a box, of its side; they tell nothing of its heading.
constexpr double kPatchesSigma = 0.08;
constexpr double kPatchHeadingSigma_rad = 3.0 * std::numbers::pi / 180.0;

// Of the silhouettes in those views, a few, about evenly; in the body's frame.
std::vector<ground::OutlineView> SomeOutlines(
    std::span<const ground::BodyView> views,
    std::span<const Rigid3> world_from_body) {
  std::vector<ground::OutlineView> all;
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (!views[i].outline) continue;
    all.push_back({views[i].camera,
                   world_from_body[i].Inverse() * views[i].world_from_camera,
                   *views[i].outline});
  }
  std::vector<ground::OutlineView> some;
  const std::size_t count = std::min(all.size(), kMostOutlines);
  for (std::size_t i = 0; i < count; ++i) {
    some.push_back(all[i * all.size() / count]);
  }
  return some;
}

double Median(std::vector<double> values) {
  const auto middle =
      values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// By how much farther along and across the body its points were known to be
// than they are found; nullopt: few were known. The median, for a few may have
// gone over to something else since.
std::optional<Eigen::Vector3d> KnownPlaceOfPoints(
    const BodyFollower::Tracks& seen, const BodyFollower::Found& found) {
  std::array<std::vector<double>, 2> farther_m;
  for (std::size_t i = 0; i < found.tracks.size(); ++i) {
    const auto& known = seen.known_body[found.tracks[i]];
    if (!known) continue;
    for (int k = 0; k < 2; ++k) {
      farther_m[k].push_back((*known)[k] - found.points_body[i][k]);
    }
  }
  if (farther_m[0].size() < GroundTarget::kMinAgreeing) {
    return std::nullopt;
  }
  return Eigen::Vector3d(Median(farther_m[0]), Median(farther_m[1]), 0.0);
}

}  // namespace

std::optional<BodyFollower::Found> GroundTarget::FitMovingBody(
    const CameraView& camera, const BodyFollower::Tracks& seen) {
  if (!heading_known_ || center_ != BoxCenter::kTexture || !last_sighting_ ||
      last_sighting_->is_bearing || !is_rigid()) {
    return std::nullopt;
  }
  const auto motion = ground::SolveBodyMotion(seen.views, seen.tracks, Form());
  if (!motion) return std::nullopt;
  // How it was drawn must hang together with what is seen.
  if (motion->seen_in_first < kMinSeenAsDrawn) return std::nullopt;
  // Seen from one side only, it is as long as one likes.
  const auto seen_from = [&](std::size_t i) -> Eigen::Vector3d {
    return (motion->world_from_body[i].Inverse() *
            seen.views[i].world_from_camera)
        .translation.normalized();
  };
  double least_cosine = 1.0;
  for (std::size_t i = 1; i < seen.views.size(); ++i) {
    least_cosine = std::min(least_cosine, seen_from(0).dot(seen_from(i)));
  }
  if (least_cosine > std::cos(kLeastViewTurn_rad)) return std::nullopt;
  const ground::GroundView drawn{
      &start_camera_,
      motion->world_from_body.front().Inverse() * start_world_from_camera_,
      geometry::Plane{}};
  ground::BodyPoints points{motion->points, {}};
  for (std::size_t i = 0; i < seen.views.size(); ++i) {
    points.eyes_world.push_back(
        (motion->world_from_body[i].Inverse() * seen.views[i].world_from_camera)
            .translation);
  }
  points.outlines = SomeOutlines(seen.views, motion->world_from_body);
  const auto fit =
      ground::FitBodyToPoints(drawn,
                              start_box_px_,
                              ground::UprightBox(geometry::Plane{},
                                                 Eigen::Vector3d::Zero(),
                                                 Eigen::Vector3d::UnitX(),
                                                 size_m_),
                              {.is_fit = fitted_,
                               .heading_sigma_rad = kWayHeadingSigma_rad,
                               .scale_sigma = kFirstScaleSigma,
                               .ground_sigma_m = ground_sigmas()[0],
                               .size = SizeAlongWay()},
                              points);
  if (!fit || (!fitted_ && fit->surprise > kSuchABody)) return std::nullopt;
  const Eigen::Matrix3d S =
      log_size_covariance_ + fit->log_size_covariance +
      kShapeError * kShapeError * Eigen::Matrix3d::Identity();
  const Eigen::Vector3d change =
      (fit->scale * fit->box.size_m.cwiseQuotient(size_m_))
          .array()
          .log()
          .matrix();
  if (fitted_ && change.dot(S.ldlt().solve(change)) > kSameBody) {
    return std::nullopt;
  }
  BodyFollower::Found found;
  found.tracks = motion->tracks;
  // The body's own frame, on the ground: everything is larger by the scale,
  // about the camera in each view.
  const Rigid3 points_from_body{fit->box.world_from_object.rotation,
                                fit->box.BottomCenterWorld()};
  for (std::size_t i = 0; i < seen.views.size(); ++i) {
    Rigid3 world_from_body = motion->world_from_body[i] * points_from_body;
    const Eigen::Vector3d& eye = seen.views[i].world_from_camera.translation;
    world_from_body.translation =
        eye + fit->scale * (world_from_body.translation - eye);
    found.world_from_body.push_back(world_from_body);
  }
  const Rigid3 body_from_points = points_from_body.Inverse();
  for (const ground::BodyPoint& point : motion->points) {
    found.points_body.push_back(fit->scale *
                                (body_from_points * point.p_world));
  }
  const double gain = std::max(kLeastGain, 1.0 / (1.0 + times_measured_++));
  // Where the body's middle is among its points is an estimate as its size is:
  // earlier fits and silhouettes have told it too.
  const auto known_m = KnownPlaceOfPoints(seen, found);
  const double told = followed_point_.TellByFit(time_, known_m.has_value());
  const Eigen::Vector3d kept_m =
      (1.0 - told) * known_m.value_or(Eigen::Vector3d::Zero());
  for (Eigen::Vector3d& p_body : found.points_body) p_body += kept_m;
  for (Rigid3& world_from_body : found.world_from_body) {
    world_from_body.translation -= world_from_body.rotation * kept_m;
  }
  const Rigid3& now = found.world_from_body.back();
  const Eigen::Vector2d axis =
      axes_.axes_world.transpose() * (now.rotation * Eigen::Vector3d::UnitX());
  const double turn_rad =
      WrapAngle_rad(std::atan2(axis.y(), axis.x()) - heading_rad_);
  heading_rad_ = WrapAngle_rad(heading_rad_ + turn_rad);
  unturned_rad_ += turn_rad;
  size_m_ = size_m_.cwiseProduct((gain * change).array().exp().matrix());
  shape_ = fit->shape;
  log_size_covariance_ = fit->log_size_covariance;
  axis_sigma_rad_ = fit->axis_sigma_rad;
  NoteHeading(axis_sigma_rad_);
  const Eigen::Vector2d place_m = axes_.FromWorld(now.translation);
  motion_->Shift(place_m - last_sighting_->place_m);
  last_sighting_->place_m = place_m;
  if (!surface_->IsPlane()) FindGroundErrors(now);
  texture_object_ = ground::PointOnRay(
      camera.view, BodyAt(place_m), last_sighting_->center_px, kTextureDepth);
  view_rad_ = ViewAngle_rad(camera);
  seen_log_ratio_ = 0.0;
  outline_scale_.RestartMeasured();
  fitted_ = true;
  return found;
}

void GroundTarget::FindGroundErrors(const Rigid3& world_from_body) {
  const auto rise_m = surface_->HeightOf(world_from_body.translation);
  if (!rise_m) return;
  ground_errors_.mean[0] = *rise_m;
  const Eigen::Vector3d known_world = ground_as_known().normal;
  ground_errors_.mean.tail<2>() =
      axes_.axes_world.transpose() *
      known_world.cross(world_from_body.rotation * Eigen::Vector3d::UnitZ());
}

ground::BodyForm GroundTarget::Form() const {
  const double size_sigma = std::sqrt(log_size_covariance_.trace() / 3.0);
  return {size_m_,
          shape_,
          fitted_ ? size_sigma : std::max(kUnfittedSigma, size_sigma)};
}

ground::BodyView GroundTarget::ExpectAt(const CameraView& camera,
                                        const Box3& body,
                                        double shape_sigma) const {
  ground::BodyView view;
  view.camera = *camera.view.camera;
  view.world_from_camera = camera.view.world_from_camera;
  view.world_from_body = {body.world_from_object.rotation,
                          body.BottomCenterWorld()};
  view.place_sigma_m =
      std::sqrt(0.5 * motion_->state().position_covariance_m2.trace()) +
      shape_sigma * Side(size_m_);
  return view;
}

GroundSighting GroundTarget::SightLocated(const CameraView& camera,
                                          const ground::BodyPose& pose,
                                          double shape_sigma) const {
  const Eigen::Matrix3d R = pose.world_from_body.rotation.toRotationMatrix();
  const Eigen::Matrix2d axes = axes_.axes_world.transpose() * R.leftCols<2>();
  return SightAt(
      camera,
      pose.world_from_body.translation,
      axes * pose.covariance.topLeftCorner<2, 2>() * axes.transpose() +
          std::pow(shape_sigma * Side(size_m_), 2) *
              Eigen::Matrix2d::Identity());
}

std::optional<GroundSighting> GroundTarget::SightByPoints(
    const CameraView& camera,
    std::span<const ground::BodySighting> seen,
    const std::optional<Eigen::Vector2d>& found_px,
    Box2& box_px,
    std::vector<bool>& agrees) {
  const Box3 expected = box();
  ground::BodyView view = ExpectAt(camera, expected, kPointsSigma);
  view.heading_sigma_rad = kWayHeadingSigma_rad;
  // The ground's errors are told along and about the body's axes, and not those
  // of the surface.
  const Eigen::Matrix3d R =
      expected.world_from_object.rotation.toRotationMatrix();
  Eigen::Matrix3d errors_from_body = Eigen::Matrix3d::Zero();
  errors_from_body(0, 0) =
      1.0 / R.col(2).dot(surface_->reference_world().normal);
  errors_from_body.bottomRightCorner<2, 2>() =
      axes_.axes_world.transpose() * R.leftCols<2>();
  const Eigen::Matrix3d body_from_errors = errors_from_body.inverse();
  view.ground_covariance = body_from_errors * ground_errors_.covariance *
                           body_from_errors.transpose();
  const auto outline = BodyHull(camera, expected);
  if (!outline) return std::nullopt;
  const double sigma_px =
      std::hypot(kSightSigma_px, kSightSigma * std::sqrt(outline->Area()));
  const auto pose = ground::LocateBody(view, seen, sigma_px);
  if (!pose || pose->agreeing < kMinAgreeing ||
      static_cast<double>(pose->agreeing) <
          kShareAgreeing * static_cast<double>(seen.size())) {
    return std::nullopt;
  }
  GroundSighting sighting = SightLocated(camera, *pose, kPointsSigma);
  if (sighting.innovation.surprise > kGate) return std::nullopt;
  const Eigen::Vector2d heading =
      axes_.axes_world.transpose() *
      pose->world_from_body.rotation.toRotationMatrix().col(0);
  sighting.heading_rad = std::atan2(heading.y(), heading.x());
  sighting.heading_sigma_rad =
      std::hypot(axis_sigma_rad_, std::sqrt(pose->covariance(2, 2)));
  const double before_rad = heading_rad_;
  const GroundErrors errors_before = ground_errors_;
  heading_rad_ = *sighting.heading_rad;
  ground_errors_.mean += errors_from_body * pose->ground;
  ground_errors_.covariance =
      errors_from_body * pose->ground_covariance * errors_from_body.transpose();
  const Box3 body = BodyAt(sighting.place_m);
  const auto outline_px = OutlineOf(camera, body);
  const auto followed_px = camera.view.camera->ImageFromCamera(
      camera.view.world_from_camera.Inverse() *
      (body.world_from_object * texture_object_));
  if (!outline_px || !followed_px ||
      (found_px &&
       (*found_px - *followed_px).cwiseQuotient(outline_px->size_px()).norm() >
           kAside)) {
    heading_rad_ = before_rad;
    ground_errors_ = errors_before;
    return std::nullopt;
  }
  agrees = pose->agrees;
  // What the tracker goes on with is the outline about its middle.
  box_px = *outline_px;
  sighting.center_px = box_px.center_px();
  texture_object_ =
      ground::PointOnRay(camera.view, body, sighting.center_px, kTextureDepth);
  view_rad_ = ViewAngle_rad(camera);
  return sighting;
}

std::optional<GroundSighting> GroundTarget::SightByPatches(
    const CameraView& camera,
    const Box3& about,
    const PatchMemory::Match& match,
    Box2& box_px) {
  std::vector<ground::BodySighting> seen;
  for (const PatchMemory::Patch& patch : match.patches) {
    seen.push_back({patch.p_body, patch.now_px});
  }
  const auto outline = BodyHull(camera, about);
  if (!outline) return std::nullopt;
  ground::BodyView view = ExpectAt(camera, about, kPatchesSigma);
  view.heading_sigma_rad = kPatchHeadingSigma_rad;
  const auto pose = ground::LocateBody(
      view,
      seen,
      std::hypot(kSightSigma_px, kPatchesSigma * std::sqrt(outline->Area())));
  if (!pose || static_cast<double>(pose->agreeing) <
                   kShareAgreeing * static_cast<double>(seen.size())) {
    return std::nullopt;
  }
  GroundSighting sighting = SightLocated(camera, *pose, kPatchesSigma);
  if (sighting.innovation.surprise > kGate) return std::nullopt;
  const Box3 body = BodyAt(sighting.place_m);
  const auto outline_px = OutlineOf(camera, body);
  const auto followed_px = FollowedPointAt(camera, body);
  if (!outline_px || !followed_px) return std::nullopt;
  // What the 2D tracker knows is still the point that it followed.
  box_px = Box2::FromCenter(*followed_px, outline_px->size_px());
  sighting.center_px = *followed_px;
  return sighting;
}

}  // namespace groundlock::tracking
