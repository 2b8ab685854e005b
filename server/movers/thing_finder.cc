// SPDX-License-Identifier: Apache-2.0
#include "server/movers/thing_finder.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

#include "map_store/geometry/plane.h"
#include "server/ground/box_fit.h"
#include "server/ground/ground_model.h"
#include "server/movers/moving_groups.h"

namespace groundlock::movers {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using geometry::Box2;
using Kind = FieldPoint::Kind;

// Groups reach as far as points are apart, beyond the patches' own size.
constexpr double kLinkShare = 1.0 / 32.0;  // of the image's width
constexpr double kBoxMargin_px = 4.0;      // at 1280 pixels
// Points on the outline of something that stands before a background slide
// along it together: they lie on a line, as wide as this share of its length
// (bins and crates of rendered yards were reported so).
constexpr double kMinWidth = 0.2;
// Where a group's box ends is known to this share of its size.
constexpr double kBoxSigma = 0.08;
// Boxes of things; 3D shape priors as for targets of unknown kind.
const ground::ShapePrior kShape;

// How wide points lie over how long, in standard deviations.
double WidthOverLength(const MovingGroup& group,
                       std::span<const MovingPoint> points) {
  Vector2d mean = Vector2d::Zero();
  for (const std::size_t i : group.members) mean += points[i].pixel_px;
  mean /= static_cast<double>(group.members.size());
  Matrix2d scatter = Matrix2d::Zero();
  for (const std::size_t i : group.members) {
    const Vector2d off = points[i].pixel_px - mean;
    scatter += off * off.transpose();
  }
  const Vector2d squares =
      Eigen::SelfAdjointEigenSolver<Matrix2d>(scatter).eigenvalues();
  return std::sqrt(std::max(0.0, squares[0]) / std::max(1e-9, squares[1]));
}

// Where the group stands, and how it goes.
std::optional<Finding> Locate(const MoversFrame& frame,
                              std::span<const FieldPoint> points,
                              const MovingGroup& group,
                              const std::vector<std::size_t>& indices,
                              const Vector2d& eye_velocity_m_s,
                              double sigma_px) {
  const geometry::PlaneAxes axes(frame.ground->reference_world());
  Finding finding;
  for (const std::size_t member : group.members) {
    finding.point_ids.push_back(points[indices[member]].id);
  }
  std::sort(finding.point_ids.begin(), finding.point_ids.end());
  const Box2 image_px =
      Box2::FromXywh(0, 0, frame.camera->width_px(), frame.camera->height_px());
  const double margin_px =
      kBoxMargin_px * std::max(1.0, image_px.width() / 1'280.0);
  finding.box_px = geometry::Intersection(
      Box2::FromCenter(
          group.box_px.center_px(),
          group.box_px.size_px() + Vector2d::Constant(2.0 * margin_px)),
      image_px);
  const LocalGround& local = *points[indices[group.members.front()]].ground;
  const ground::GroundView view{
      frame.camera, frame.world_from_camera, local.plane_world};
  const Vector3d heading_world =
      axes.DirectionToWorld(group.velocity_m_s.normalized());
  const auto body = ground::FitBox(view, finding.box_px, heading_world, kShape);
  // A box whose foot is not on the ground is of nothing that stands there.
  if (!body.ok()) return std::nullopt;
  const Vector3d place_world = body->BottomCenterWorld();
  finding.place_m = axes.FromWorld(place_world);
  // Points were taken to be on the ground: those above it, at heights up to the
  // body's, seem to move by what the camera does, too.
  double height_m = 0.0;
  for (const std::size_t member : group.members) {
    const Vector3d p_object = ground::PointOnRay(
        view, *body, points[indices[member]].pixel_px, /*depth=*/1.0);
    height_m += p_object.z() + 0.5 * body->size_m.z();
  }
  height_m /= static_cast<double>(group.members.size());
  const double eye_height_m = ground::CameraHeight_m(view);
  if (!(eye_height_m > 0.0)) return std::nullopt;
  const double raised = std::clamp(height_m / eye_height_m, 0.0, 0.8);
  finding.velocity_m_s =
      (1.0 - raised) * group.velocity_m_s + raised * eye_velocity_m_s;
  finding.velocity_covariance_m2_s2 = group.velocity_covariance_m2_s2;
  // Where its outline ends is seen only as well as its points show.
  const auto placed = ground::PlaceBoxByCenter(view,
                                               finding.box_px.center_px(),
                                               heading_world,
                                               body->size_m,
                                               place_world);
  if (!placed) return std::nullopt;
  const double box_sigma_px =
      2.0 * sigma_px + kBoxSigma * finding.box_px.size_px().norm();
  finding.place_covariance_m2 = box_sigma_px * box_sigma_px *
                                    (placed->place_by_center_m_px *
                                     placed->place_by_center_m_px.transpose()) +
                                ground::GroundCovarianceFromPose(
                                    view, place_world, frame.pose_covariance);
  finding.ground_per_image_m2_px2 =
      std::abs(placed->place_by_center_m_px.determinant());
  return finding;
}

}  // namespace

std::vector<Finding> FindThings(const MoversFrame& frame,
                                std::span<const FieldPoint> points,
                                const Vector2d& eye_velocity_m_s,
                                double sigma_px) {
  std::vector<MovingPoint> moving;
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].kind != Kind::kMoving) continue;
    moving.push_back({points[i].pixel_px,
                      points[i].velocity_m_s,
                      points[i].covariance.bottomRightCorner<2, 2>()});
    indices.push_back(i);
  }
  GroupingOptions options;
  options.link_px = kLinkShare * frame.pyramid->size_px.width;
  std::vector<Finding> findings;
  for (const MovingGroup& group : GroupPoints(moving, options)) {
    // Where most of what is seen rests, points move by chance.
    const auto resting = static_cast<std::size_t>(
        std::count_if(points.begin(), points.end(), [&](const FieldPoint& p) {
          return p.kind == Kind::kAtRest && group.box_px.Contains(p.pixel_px);
        }));
    if (resting > group.members.size() ||
        WidthOverLength(group, moving) < kMinWidth) {
      continue;
    }
    auto finding =
        Locate(frame, points, group, indices, eye_velocity_m_s, sigma_px);
    if (!finding) continue;
    const bool is_target =
        std::any_of(frame.targets_px.begin(),
                    frame.targets_px.end(),
                    [&](const Box2& box_px) {
                      return IsSamePlace(box_px, finding->box_px);
                    });
    if (!is_target) findings.push_back(*std::move(finding));
  }
  return findings;
}

}  // namespace groundlock::movers
