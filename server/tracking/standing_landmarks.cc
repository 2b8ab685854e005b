// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/standing_landmarks.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "server/localization/search/landmark_uncertainty.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

// The region reaches so many times as far as the targets are away.
constexpr double kReach = 2.0;
// Lower than this share of the camera's height is ground.
constexpr double kGroundShare = 0.03;
// What stands before a target is so many of its lengths nearer to the camera
// than its middle, and so many standard deviations of both places.
constexpr double kNearer = 0.75;
constexpr double kDepthSigmas = 2.0;
// Of the grid on which landmarks are thinned.
constexpr int kColumns = 12;
constexpr int kRows = 8;
static_assert(kColumns * kRows == BoxCover::kMaxPoints);

}  // namespace

StandingLandmarks::StandingLandmarks(std::shared_ptr<const map::Map> map,
                                     int min_landmark_views)
    : map_(std::move(map)),
      ground_(ground::SurfaceOf(*map_)),
      min_landmark_views_(min_landmark_views) {}

bool StandingLandmarks::Region::Contains(const Eigen::Vector3d& eye_world,
                                         double range_m) const {
  return (eye_world - middle_world).norm() + range_m <= radius_m;
}

void StandingLandmarks::Follow(const ground::GroundView& view, double range_m) {
  const std::size_t all = map_->landmarks().size();
  const Eigen::Vector3d eye = view.world_from_camera.translation;
  const bool growing = growing_.radius_m > 0.0;
  const Region& last = growing ? growing_ : known_;
  if (!last.Contains(eye, range_m)) {
    growing_ = Region{eye, kReach * range_m, 0, 1, 0, {}};
  }
  if (!(growing_.radius_m > 0.0)) return;
  Gather(view, growing_);
  if (growing_.next < all && known_.next == all) return;
  if (growing_.next < all) {
    // The first one: a part of it is better than nothing.
    known_ = growing_;
    known_.next = 0;
    return;
  }
  known_ = std::exchange(growing_, Region{});
}

void StandingLandmarks::Gather(const ground::GroundView& view,
                               Region& region) const {
  const auto landmarks = map_->landmarks();
  const double least_m = kGroundShare * ground::CameraHeight_m(view);
  const double radius_m2 = region.radius_m * region.radius_m;
  const std::size_t end =
      std::min(landmarks.size(), region.next + kReadPerFrame);
  for (; region.next < end; ++region.next) {
    const map::Landmark& landmark = landmarks[region.next];
    const Eigen::Vector3d p_world = landmark.Position();
    const Eigen::Vector3d p_region = p_world - region.middle_world;
    if (!(p_region.squaredNorm() <= radius_m2) ||
        static_cast<int>(landmark.num_observations) < min_landmark_views_ ||
        !(ground_->HeightOf(p_world).value_or(
              view.ground_world.SignedDistance(p_world)) > least_m) ||
        region.found++ % region.stride != 0) {
      continue;
    }
    region.points.push_back(
        {p_region.cast<float>(), static_cast<std::uint32_t>(region.next)});
    if (region.points.size() < kMaxKept) continue;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < region.points.size(); i += 2) {
      region.points[kept++] = region.points[i];
    }
    region.points.resize(kept);
    region.stride *= 2;
  }
}

std::vector<FrontPoint> StandingLandmarks::Before(
    const ground::GroundView& view, const ExpectedBody& body) const {
  const geometry::Rigid3& pose = view.world_from_camera;
  const Eigen::Vector3d to_body =
      body.box_world.world_from_object.translation - pose.translation;
  const double range_m = to_body.norm();
  const Eigen::Vector3d& size_m = body.box_world.size_m;
  const double front_m = range_m - kNearer * size_m.head<2>().norm();
  const double link_px =
      BoxCover::kLinkSides * std::sqrt(body.outline_px.Area());
  const Box2 near_px = Box2::FromCenter(
      body.outline_px.center_px(),
      body.outline_px.size_px() + Eigen::Vector2d::Constant(2.0 * link_px));
  // A cone about the body that holds all that projects there.
  const double cone = 1.5 * size_m.norm() / range_m;
  const auto wide = static_cast<float>(1.0 + cone * cone);
  const auto nearest_m =
      static_cast<float>(front_m - kDepthSigmas * body.sigma_m);
  const Eigen::Vector3f ray = (to_body / range_m).cast<float>();
  const Eigen::Vector3f eye =
      (pose.translation - known_.middle_world).cast<float>();
  const geometry::Rigid3 camera_from_world = pose.Inverse();
  const Eigen::Vector3d along = to_body / range_m;
  // One in each cell of a grid: enough to tell a surface, however dense the
  // map.
  std::array<bool, BoxCover::kMaxPoints> taken{};
  const Eigen::Vector2d cell_px =
      near_px.size_px().cwiseQuotient(Eigen::Vector2d(kColumns, kRows));
  std::vector<FrontPoint> points;
  for (const Point& point : known_.points) {
    const Eigen::Vector3f d = point.p_region - eye;
    const float along_m = d.dot(ray);
    if (!(along_m > 0.0F) || along_m >= nearest_m ||
        d.squaredNorm() > wide * along_m * along_m) {
      continue;
    }
    const Eigen::Vector3d p_world =
        point.p_region.cast<double>() + known_.middle_world;
    const auto pixel =
        view.camera->ImageFromCamera(camera_from_world * p_world);
    if (!pixel || !near_px.Contains(*pixel)) continue;
    const Eigen::Vector2i cell =
        (*pixel - near_px.min_px).cwiseQuotient(cell_px).cast<int>();
    bool& is_taken = taken.at(std::min(cell.y(), kRows - 1) * kColumns +
                              std::min(cell.x(), kColumns - 1));
    if (is_taken) continue;
    const Eigen::Matrix3d covariance =
        localization::LandmarkCovariance(*map_, point.landmark);
    const double sigma_m =
        std::sqrt(along.dot(covariance * along) + body.sigma_m * body.sigma_m);
    if (!(along_m + kDepthSigmas * sigma_m < front_m)) continue;
    is_taken = true;
    points.push_back({*pixel, static_cast<double>(d.norm())});
  }
  return points;
}

}  // namespace groundlock::tracking
