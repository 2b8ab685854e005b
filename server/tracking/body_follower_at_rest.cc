// SPDX-License-Identifier: Apache-2.0
// Points of a target that may be at rest: where they are, by triangulation.
#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "server/tracking/body_follower.h"

namespace groundlock::tracking {
namespace {

// So many of them make no room for others.
constexpr std::size_t kMinFollowed = 60;
// Lucas-Kanade's error from frame to frame adds up to about so much in a view.
constexpr double kPixelSigma_px = 0.5;
constexpr int kTriangulationSteps = 5;
// Less parallax than that of a range known to this share tells nothing.
constexpr double kMaxRangeSigma = 0.05;
// A point that is known so well (about what a body's faces are rough by, at ten
// of its lengths), and stands no higher than this share of the body, is the
// ground's, and makes room for others.
constexpr double kKnownRangeSigma = 0.003;
constexpr double kGroundOfBody = 0.06;
// A body is seen at rest by so many of its points, and this share of those that
// were followed. A patch of something else ends where the point would be in one
// of ten cases at most: five of seven do in one of 5,000.
constexpr int kMinAtRest = 5;
constexpr double kShareAtRest = 0.66;
constexpr double kBodyMargin = 0.1;  // of its half extents

}  // namespace

std::optional<Eigen::Vector2d> BodyFollower::MotionAtRest_px(
    const View& before, const View& now, const Eigen::Vector3d& p_world) {
  const auto from =
      before.camera.ImageFromCamera(before.camera_from_world * p_world);
  const auto to = now.camera.ImageFromCamera(now.camera_from_world * p_world);
  if (!from || !to) return std::nullopt;
  return Eigen::Vector2d(*to - *from);
}

bool BodyFollower::IsSeenAtRest(const geometry::Box3& body_world) const {
  if (last_pyramid_ == nullptr) return false;
  const geometry::Rigid3 body_from_world =
      body_world.world_from_object.Inverse();
  int on_body = 0;
  int at_rest = 0;
  for (const Point& point : points_) {
    if (!point.at_rest) continue;
    const Eigen::Vector3d share = (body_from_world * point.place->p_world)
                                      .cwiseQuotient(0.5 * body_world.size_m);
    if (share.cwiseAbs().maxCoeff() > 1.0 + kBodyMargin ||
        share.z() < kBodyMargin - 1.0) {
      continue;
    }
    ++on_body;
    at_rest += *point.at_rest ? 1 : 0;
  }
  return at_rest >= kMinAtRest && at_rest >= kShareAtRest * on_body;
}

ground::BodyPoints BodyFollower::Points() const {
  ground::BodyPoints seen;
  for (const Point& point : points_) {
    if (point.place) seen.points.push_back(*point.place);
  }
  for (const View& view : views_) {
    seen.eyes_world.push_back(view.camera_from_world.Inverse().translation);
  }
  return seen;
}

void BodyFollower::TriangulatePoints(const geometry::Plane& ground_world,
                                     const BodyState& body) {
  for (Point& point : points_) {
    if (!point.followed || point.moves || Triangulate(point)) continue;
    point.moves = true;
    point.place.reset();
    point.at_rest.reset();
  }
  if (body.rests) {
    std::erase_if(points_, [](const Point& point) { return point.moves; });
  }
  const double ground_m =
      2.0 * kGroundOfBody *
      ground_world.SignedDistance(body.box_world.world_from_object.translation);
  std::size_t followed = 0;
  for (Point& point : points_) {
    if (point.is_known && point.place &&
        ground_world.SignedDistance(point.place->p_world) < ground_m) {
      point.followed = false;
    }
    followed += point.followed ? 1 : 0;
  }
  // What is known longest makes room for what comes into view.
  for (Point& point : points_) {
    if (followed <= kMinFollowed) break;
    if (!point.followed || !point.is_known) continue;
    point.followed = false;
    --followed;
  }
}

bool BodyFollower::Triangulate(Point& point) const {
  if (point.observations.size() < kMinObservations) return true;
  // Linear: each pixel's ray is two planes through the camera's centre.
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Observation& observation : point.observations) {
    const View& view = views_[observation.view];
    const auto normalized =
        view.camera.NormalizedFromImage(observation.pixel_px);
    if (!normalized) return false;
    const Eigen::Matrix3d R =
        view.camera_from_world.rotation.toRotationMatrix();
    const Eigen::Vector3d& t = view.camera_from_world.translation;
    for (const int axis : {0, 1}) {
      const Eigen::Vector3d plane =
          (R.row(axis) - (*normalized)[axis] * R.row(2)).transpose();
      const double offset = (*normalized)[axis] * t.z() - t[axis];
      A += plane * plane.transpose();
      b += offset * plane;
    }
  }
  Eigen::Vector3d p_world = A.ldlt().solve(b);
  // Then by the error in the image, Gauss-Newton.
  Eigen::Matrix3d information;
  double squared_px2 = 0.0;
  for (int step = 0; step < kTriangulationSteps; ++step) {
    information.setZero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    squared_px2 = 0.0;
    for (const Observation& observation : point.observations) {
      const View& view = views_[observation.view];
      Eigen::Matrix<double, 2, 3> J;
      const auto pixel =
          view.camera.ImageFromCamera(view.camera_from_world * p_world, &J);
      // Not in front of the camera: there is no parallax yet.
      if (!pixel) return true;
      J = J * view.camera_from_world.rotation.toRotationMatrix();
      const Eigen::Vector2d error_px = observation.pixel_px - *pixel;
      information += J.transpose() * J;
      gradient += J.transpose() * error_px;
      squared_px2 += error_px.squaredNorm();
    }
    p_world += information.ldlt().solve(gradient);
    if (!p_world.allFinite()) return true;
  }
  const double rms_px =
      std::sqrt(squared_px2 / static_cast<double>(point.observations.size()));
  if (rms_px > kMaxRestError_px) return false;
  const Eigen::Matrix3d covariance_m2 =
      kPixelSigma_px * kPixelSigma_px * information.inverse();
  const double range_m = (views_.back().camera_from_world * p_world).norm();
  const double sigma_m =
      std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance_m2)
                    .eigenvalues()
                    .maxCoeff());
  if (sigma_m < kMaxRangeSigma * range_m) {
    point.place = ground::BodyPoint{p_world, covariance_m2};
  }
  point.is_known = sigma_m < kKnownRangeSigma * range_m;
  return true;
}

}  // namespace groundlock::tracking
