// SPDX-License-Identifier: Apache-2.0
#include "server/movers/point_judge.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

#include "map_store/base/order_statistics.h"
#include "server/ground/ground_model.h"

namespace groundlock::movers {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Matrix6d;
using Kind = FieldPoint::Kind;

// Poses and sightings are kept so often, kKeyViews of them: a window of some
// 0.9 s. What a slower video has between is every frame.
constexpr double kKeyStep_s = 0.1;
// Sightings before a point is judged.
constexpr std::size_t kMinSightings = 4;
// A point that rests is taken to move once in 30,000 times (4 sigma); that of a
// thing which moves is taken for neither once in 700 (3 sigma).
constexpr double kRestLimit_sigma = 4.0;
constexpr double kMotionLimit_sigma = 3.0;
// Things jolt, and people swing their limbs: their points are off smooth motion
// by so much more than noise.
constexpr double kUnsteadiness = 3.0;
// A car that turns on the spot changes its velocity by its whole within a
// second (1 sigma).
constexpr double kChangePerSecond = 1.0;
// A speed is one if it is above zero by so many sigmas.
constexpr double kMinSpeed_sigma = 5.0;
// Points at the edges of things that stand before others slide by a few pixels:
// what moves goes farther in the image than that while it is judged.
constexpr double kMinShift_px = 5.0;  // at 1280 pixels
// Beyond what is stated of it, the ground is rough by this share of the
// camera's height over it, and falls or rises by this share of the way to it:
// seen from a drone, a far fence in a hollow went with the camera before
// (flight car10).
constexpr double kRoughness = 0.01;
constexpr double kSlope = 0.02;
// The pose is doubted if more than this share of the points contradicts it, and
// nothing is said before so many rest.
constexpr double kMaxContradicting = 0.5;
constexpr std::size_t kMinResting = 12;

// The part of a symmetric matrix without negative eigenvalues.
Matrix6d PositivePart(const Matrix6d& matrix) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(matrix);
  return solver.eigenvectors() *
         solver.eigenvalues().cwiseMax(0.0).asDiagonal() *
         solver.eigenvectors().transpose();
}

std::optional<LocalGround> GroundUnder(const MoversFrame& frame,
                                       const Vector2d& xy) {
  const Vector3d& eye_world = frame.world_from_camera.translation;
  const Vector3d direction_world =
      frame.world_from_camera.rotation * xy.homogeneous();
  const geometry::Plane& reference = frame.ground->reference_world();
  const double height_m = frame.ground->HeightOf(eye_world).value_or(
      reference.SignedDistance(eye_world));
  if (!(height_m > 0.0)) return std::nullopt;
  const auto place_world = frame.ground->IntersectRay(
      eye_world, direction_world, ground::kMaxRangeOverHeight * height_m);
  // What is seen over the horizon rests on nothing, and may rest.
  if (!place_world) return LocalGround{reference, height_m};
  const auto patch = frame.ground->At(*place_world);
  if (!patch) return std::nullopt;
  return LocalGround{patch->tangent_world,
                     std::hypot(patch->height_sigma_m,
                                kRoughness * height_m,
                                kSlope * (*place_world - eye_world).norm())};
}

}  // namespace

bool PointJudge::IsDue(double time_s, double frame_step_s) const {
  return keys_.empty() ||
         time_s + 0.5 * frame_step_s - keys_.back().view.time_s >= kKeyStep_s;
}

void PointJudge::TakeKeyView(const MoversFrame& frame,
                             std::vector<FieldPoint>& points) {
  Key key;
  key.view.time_s = std::chrono::duration<double>(frame.time).count();
  key.view.world_from_camera = frame.world_from_camera;
  key.view.covariance = frame.pose_covariance;
  key.by_odometry = frame.by_odometry;
  keys_.push_back(key);
  if (keys_.size() > kKeyViews) {
    keys_.pop_front();
    ++first_key_;
  }
  const std::uint64_t number = first_key_ + keys_.size() - 1;
  std::erase_if(points, [&](FieldPoint& point) {
    const auto xy = frame.camera->NormalizedFromImage(point.pixel_px);
    if (!xy) return true;
    point.xy_by_key[number % kKeyViews] = *xy;
    point.key_pixel_px = point.pixel_px;
    if (!point.first_key) point.first_key = number;
    return false;
  });
}

std::vector<KeyView> PointJudge::ViewsNow() const {
  std::vector<KeyView> views;
  for (const Key& key : keys_) {
    views.push_back(key.view);
    // Errors of poses in the map are taken to be independent. Those of odometry
    // add up on the way: what counts is what has come since.
    if (keys_.back().by_odometry) {
      views.back().covariance =
          PositivePart(keys_.back().view.covariance - key.view.covariance);
    }
  }
  return views;
}

MoversState PointJudge::Judge(const MoversFrame& frame,
                              double sigma_px,
                              std::vector<FieldPoint>& points) {
  const std::vector<KeyView> views = ViewsNow();
  const std::uint64_t newest = first_key_ + keys_.size() - 1;
  const PointNoise noise{sigma_px / frame.camera->mean_focal_px()};
  struct Judged {
    std::size_t index;
    std::vector<Sighting> sightings;
    RestFit rest;
  };
  std::vector<Judged> judged;
  std::vector<double> excesses;
  for (std::size_t i = 0; i < points.size(); ++i) {
    FieldPoint& point = points[i];
    const std::uint64_t first = std::max(*point.first_key, first_key_);
    const Vector2d& xy = point.xy_by_key[newest % kKeyViews];
    if (!point.ground || point.kind == Kind::kMoving ||
        newest - point.ground_key >= kKeyViews) {
      point.ground = GroundUnder(frame, xy);
      point.ground_key = newest;
    }
    if (!point.ground) continue;
    Judged one{i, {}, {}};
    for (std::uint64_t key = first; key <= newest; ++key) {
      one.sightings.push_back({static_cast<std::size_t>(key - first_key_),
                               point.xy_by_key[key % kKeyViews]});
    }
    if (one.sightings.size() < 2) continue;
    one.rest = FitRest(one.sightings, views, *point.ground, noise);
    if (one.rest.degrees <= 0) continue;
    point.inverse_depth = one.rest.inverse_depth;
    if (one.sightings.size() < kMinSightings) continue;
    // The median of a chi-square is that of Wilson and Hilferty's normal.
    excesses.push_back(one.rest.chi2 / ChiSquareAt(one.rest.degrees, 0.0));
    judged.push_back(std::move(one));
  }
  if (judged.size() < kMinResting) {
    return MoversState::kStarting;
  }
  // Most of the picture rests: if even that is off by more than the pose and
  // the points are said to be, these are worse than said.
  excess_ = std::max(1.0, base::Median(std::move(excesses)));
  std::size_t resting = 0;
  for (Judged& one : judged) {
    FieldPoint& point = points[one.index];
    if (one.rest.chi2 / excess_ <
        ChiSquareAt(one.rest.degrees, kRestLimit_sigma)) {
      point.kind = Kind::kAtRest;
      ++resting;
      continue;
    }
    point.kind = Kind::kOdd;
    TakeMotion(frame, one.sightings, views, noise, point);
    // What has begun to move, or is followed on something else now, is looked
    // at anew.
    if (point.kind == Kind::kOdd) {
      point.first_key = newest;
      point.inverse_depth = 0.0;
    }
  }
  std::size_t contradicting = 0;
  for (const FieldPoint& point : points) {
    contradicting +=
        point.kind == Kind::kMoving || point.kind == Kind::kOdd ? 1 : 0;
  }
  if (static_cast<double>(contradicting) >
      kMaxContradicting * static_cast<double>(contradicting + resting)) {
    return MoversState::kPoseContradicted;
  }
  return resting < kMinResting ? MoversState::kStarting
                               : MoversState::kWatching;
}

void PointJudge::TakeMotion(const MoversFrame& frame,
                            std::span<const Sighting> sightings,
                            std::span<const KeyView> views,
                            const PointNoise& noise,
                            FieldPoint& point) const {
  const GroundMotion motion =
      FitGroundMotion(sightings, views, *point.ground, noise, kChangePerSecond);
  if (motion.degrees <= 0 ||
      motion.chi2 / (excess_ * kUnsteadiness * kUnsteadiness) >
          ChiSquareAt(motion.degrees, kMotionLimit_sigma)) {
    return;
  }
  const Matrix2d covariance = motion.covariance.bottomRightCorner<2, 2>();
  const double speed_squared_sigma =
      motion.velocity_m_s.dot(covariance.inverse() * motion.velocity_m_s);
  if (!(speed_squared_sigma > excess_ * kMinSpeed_sigma * kMinSpeed_sigma)) {
    return;
  }
  const geometry::PlaneAxes local(point.ground->plane_world);
  const geometry::Rigid3 camera_from_world = frame.world_from_camera.Inverse();
  const double lasted_s = views[sightings.back().view].time_s -
                          views[sightings.front().view].time_s;
  const auto now_px = frame.camera->ImageFromCamera(
      camera_from_world * local.ToWorld(motion.place_m));
  const auto then_px = frame.camera->ImageFromCamera(
      camera_from_world *
      local.ToWorld(motion.place_m - lasted_s * motion.velocity_m_s));
  const double min_shift_px =
      kMinShift_px * std::max(1.0, frame.camera->width_px() / 1'280.0);
  if (!now_px || !then_px || !((*now_px - *then_px).norm() > min_shift_px)) {
    return;
  }
  const geometry::PlaneAxes axes(frame.ground->reference_world());
  point.kind = Kind::kMoving;
  point.place_m = axes.FromWorld(local.ToWorld(motion.place_m));
  point.velocity_m_s =
      axes.axes_world.transpose() * local.DirectionToWorld(motion.velocity_m_s);
  point.covariance = excess_ * motion.covariance;
}

}  // namespace groundlock::movers
