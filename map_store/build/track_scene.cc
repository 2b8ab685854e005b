// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/track_scene.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core/eigen.hpp>
#include <utility>

#include "map_store/base/order_statistics.h"
#include "map_store/build/internal/track_turn.h"

namespace groundlock::build::internal {
namespace {

// A depth that is off by a tenth of itself: the angle between the rays is ten
// times the angle that a sight is off by.
constexpr double kMaxDepthError = 0.1;
// A start wants more: its scale is what everything else hangs on.
constexpr double kStartAngles = 4.0;
constexpr std::size_t kMinStartPoints = 50;
constexpr std::size_t kMinResected = 20;
constexpr double kMinResectedShare = 0.3;
constexpr int kPnpRounds = 400;
constexpr double kPriorFocal = 0.85;  // of the larger side: 61 degrees wide
// Of the logarithm, where the camera wrote its focal length into the video:
// that is a photo's, and a mode of its video or its stabiliser may cut the
// borders off. The drone that filmed half of UAV123 has a mode that cuts 1.2.
constexpr double kWrittenFocalSigma = 0.2;
const double kFilmDiagonal_mm = std::hypot(36.0, 24.0);

std::vector<cv::Point2d> Points2(const std::vector<Eigen::Vector2d>& points) {
  std::vector<cv::Point2d> result;
  result.reserve(points.size());
  for (const Eigen::Vector2d& p : points) result.emplace_back(p.x(), p.y());
  return result;
}

geometry::Rigid3 RigidOf(const cv::Mat& R, const cv::Mat& t) {
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
  cv::cv2eigen(R, rotation);
  cv::cv2eigen(t, translation);
  return {Eigen::Quaterniond(rotation).normalized(), translation};
}

}  // namespace

Eigen::Vector2d RadialLens::ImageFromCamera(
    const Eigen::Vector3d& p_camera) const {
  const Eigen::Vector2d x = p_camera.head<2>() / p_camera.z();
  return focal_px * (1.0 + k * x.squaredNorm()) * x;
}

Eigen::Vector2d RadialLens::NormalizedFromImage(
    const Eigen::Vector2d& pixel_px) const {
  const Eigen::Vector2d x_d = pixel_px / focal_px;
  Eigen::Vector2d x = x_d;
  for (int i = 0; i < 10 && k != 0.0; ++i) {
    x = x_d / std::max(0.2, 1.0 + k * x.squaredNorm());
  }
  return x;
}

TrackScene::TrackScene(const FeatureTracks& tracks,
                       const std::optional<geometry::CameraModel>& camera) {
  camera_from_world.resize(tracks.num_images);
  tracks_of_.resize(tracks.num_images);
  const Eigen::Vector2d middle(0.5 * tracks.width_px, 0.5 * tracks.height_px);
  width_px_ = std::max(tracks.width_px, tracks.height_px);
  prior.focal_px = kPriorFocal * width_px_;
  if (tracks.film_focal_mm > 0.0) {
    prior.focal_px = tracks.film_focal_mm / kFilmDiagonal_mm *
                     std::hypot(tracks.width_px, tracks.height_px);
    prior.focal_log_sigma = kWrittenFocalSigma;
  }
  lens.focal_px = prior.focal_px;
  if (camera) {
    lens.focal_px = camera->mean_focal_px();
    lens_is_known = true;
  }
  points.reserve(tracks.tracks.size());
  for (const FeatureTrack& track : tracks.tracks) {
    Point point;
    for (const TrackSight& seen : track) {
      Sight sight{seen.image, seen.pixel_px.cast<double>() - middle};
      if (camera) {
        const auto xy =
            camera->NormalizedFromImage(seen.pixel_px.cast<double>());
        if (!xy) continue;
        sight.pixel_px = lens.focal_px * *xy;
      }
      tracks_of_[sight.image].push_back(
          static_cast<std::uint32_t>(points.size()));
      point.sights.push_back(sight);
    }
    points.push_back(std::move(point));
  }
}

std::uint32_t TrackScene::CountPosed() const {
  return static_cast<std::uint32_t>(std::count_if(
      camera_from_world.begin(), camera_from_world.end(), [](const auto& pose) {
        return pose.has_value();
      }));
}

std::uint32_t TrackScene::CountPoints() const {
  return static_cast<std::uint32_t>(
      std::count_if(points.begin(), points.end(), [](const Point& point) {
        return point.p_world.has_value();
      }));
}

std::uint32_t TrackScene::CountPlaced(std::uint32_t image) const {
  std::uint32_t count = 0;
  for (const std::uint32_t track : tracks_of_[image]) {
    count += points[track].p_world ? 1 : 0;
  }
  return count;
}

double TrackScene::MinAngle_rad() const {
  return kTrackSigma_px / lens.focal_px / kMaxDepthError;
}

double TrackScene::ErrorOf_px(const Sight& sight,
                              const Eigen::Vector3d& p_world) const {
  const Eigen::Vector3d p_camera = *camera_from_world[sight.image] * p_world;
  if (!(p_camera.z() > 1e-6 * p_camera.norm())) {
    return std::numeric_limits<double>::infinity();
  }
  return (lens.ImageFromCamera(p_camera) - sight.pixel_px).norm();
}

std::vector<const TrackScene::Sight*> TrackScene::PosedSights(
    const Point& point) const {
  std::vector<const Sight*> posed;
  for (const Sight& sight : point.sights) {
    if (camera_from_world[sight.image]) posed.push_back(&sight);
  }
  return posed;
}

// The point nearest to all rays.
std::optional<Eigen::Vector3d> TrackScene::Intersect(
    std::span<const Sight* const> sights) const {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Sight* sight : sights) {
    const geometry::Rigid3 world_from_camera =
        camera_from_world[sight->image]->Inverse();
    const Eigen::Vector3d ray =
        world_from_camera.rotation *
        lens.NormalizedFromImage(sight->pixel_px).homogeneous().normalized();
    const Eigen::Matrix3d across =
        Eigen::Matrix3d::Identity() - ray * ray.transpose();
    A += across;
    b += across * world_from_camera.translation;
  }
  const Eigen::LDLT<Eigen::Matrix3d> solver(A);
  Eigen::Vector3d p = solver.solve(b);
  if (solver.info() != Eigen::Success || !p.allFinite()) return std::nullopt;
  // Rays that cross at small angles are pulled together before the point: two
  // steps on the reprojection error put it right.
  for (int round = 0; round < 3; ++round) {
    Eigen::Matrix3d H = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    for (const Sight* sight : sights) {
      const geometry::Rigid3& pose = *camera_from_world[sight->image];
      const Eigen::Vector3d q = pose * p;
      if (!(q.z() > 1e-6 * q.norm())) return std::nullopt;
      const Eigen::Vector2d error =
          q.hnormalized() - lens.NormalizedFromImage(sight->pixel_px);
      Eigen::Matrix<double, 2, 3> J;
      J << 1.0 / q.z(), 0.0, -q.x() / (q.z() * q.z()), 0.0, 1.0 / q.z(),
          -q.y() / (q.z() * q.z());
      const Eigen::Matrix<double, 2, 3> Jw =
          J * pose.rotation.toRotationMatrix();
      H += Jw.transpose() * Jw;
      g += Jw.transpose() * error;
    }
    const Eigen::Vector3d step = H.ldlt().solve(g);
    if (!step.allFinite()) return std::nullopt;
    p -= step;
  }
  return p.allFinite() ? std::optional(p) : std::nullopt;
}

double TrackScene::WidestAngle_rad(const Point& point) const {
  // Of the extreme rays; those between them open less.
  struct Ray {
    std::uint32_t image = 0;
    Eigen::Vector3d direction;
  };
  std::vector<Ray> rays;
  for (const Sight& sight : point.sights) {
    if (!sight.fits || !camera_from_world[sight.image]) continue;
    rays.push_back({sight.image,
                    (*point.p_world -
                     camera_from_world[sight.image]->Inverse().translation)
                        .normalized()});
  }
  double widest = 0.0;
  const std::size_t stride = std::max<std::size_t>(1, rays.size() / 8);
  for (std::size_t i = 0; i < rays.size(); i += stride) {
    for (const Ray& other : rays) {
      if (IsSameTurn(rays[i].image, other.image)) continue;
      widest =
          std::max(widest, rays[i].direction.cross(other.direction).norm());
    }
  }
  return std::asin(std::min(1.0, widest));
}

bool TrackScene::Place(Point& point, int min_sights) const {
  const std::vector<const Sight*> posed = PosedSights(point);
  if (static_cast<int>(posed.size()) < min_sights) return false;
  // All sights, and pairs of them in case one is off.
  const std::size_t last = posed.size() - 1;
  std::vector<std::vector<const Sight*>> sets = {posed};
  if (posed.size() > 2) {
    sets.push_back({posed[0], posed[last]});
    sets.push_back({posed[0], posed[last / 2]});
    sets.push_back({posed[last / 2], posed[last]});
  }
  std::size_t most = 0;
  std::optional<Eigen::Vector3d> best;
  for (std::size_t s = 0; s < sets.size(); ++s) {
    const auto p = Intersect(sets[s]);
    if (!p) continue;
    const auto fitting = static_cast<std::size_t>(
        std::count_if(posed.begin(), posed.end(), [&](const Sight* sight) {
          return ErrorOf_px(*sight, *p) <= kTrackGate_px;
        }));
    if (fitting > most) {
      most = fitting;
      best = p;
    }
    if (most == posed.size()) break;
  }
  if (static_cast<int>(most) < min_sights || 3 * most < 2 * posed.size()) {
    return false;
  }
  point.p_world = best;
  for (Sight& sight : point.sights) {
    if (!camera_from_world[sight.image]) continue;
    sight.fits = ErrorOf_px(sight, *best) <= kTrackGate_px;
  }
  if (WidestAngle_rad(point) >= MinAngle_rad()) return true;
  point.p_world.reset();
  return false;
}

void TrackScene::Triangulate(std::optional<std::uint32_t> image,
                             int min_sights) {
  if (image) {
    for (const std::uint32_t track : tracks_of_[*image]) {
      if (!points[track].p_world) Place(points[track], min_sights);
    }
    return;
  }
  for (Point& point : points) {
    if (!point.p_world) Place(point, min_sights);
  }
}

void TrackScene::Filter(int min_sights) {
  for (Point& point : points) {
    if (!point.p_world) continue;
    int fitting = 0;
    int posed = 0;
    for (Sight& sight : point.sights) {
      if (!camera_from_world[sight.image]) continue;
      sight.fits = ErrorOf_px(sight, *point.p_world) <= kTrackGate_px;
      fitting += sight.fits ? 1 : 0;
      ++posed;
    }
    if (fitting < min_sights || 3 * fitting < 2 * posed ||
        WidestAngle_rad(point) < MinAngle_rad()) {
      point.p_world.reset();
    }
  }
}

void TrackScene::CommonSights(
    std::uint32_t first,
    std::uint32_t second,
    const std::function<void(const Sight&, const Sight&)>& take) const {
  for (const std::uint32_t track : tracks_of_[first]) {
    const Sight* a = nullptr;
    const Sight* b = nullptr;
    for (const Sight& sight : points[track].sights) {
      if (sight.image == first) a = &sight;
      if (sight.image == second) b = &sight;
    }
    if (a != nullptr && b != nullptr) take(*a, *b);
  }
}

void TrackScene::PlacedSights(
    std::uint32_t image,
    const std::function<void(const Sight&, const Eigen::Vector3d&)>& take)
    const {
  for (const std::uint32_t track : tracks_of_[image]) {
    const Point& point = points[track];
    if (!point.p_world) continue;
    for (const Sight& sight : point.sights) {
      if (sight.image == image) take(sight, *point.p_world);
    }
  }
}

void TrackScene::SetPose(std::uint32_t image, const geometry::Rigid3& pose) {
  camera_from_world[image] = pose;
  for (const std::uint32_t track : tracks_of_[image]) {
    Point& point = points[track];
    if (!point.p_world) continue;
    for (Sight& sight : point.sights) {
      if (sight.image != image) continue;
      sight.fits = ErrorOf_px(sight, *point.p_world) <= kTrackGate_px;
    }
  }
}

std::vector<TrackScene::Turn> TrackScene::Turns(
    const std::vector<bool>& is_wanted) const {
  // Far below what would show: a softer tie is cheaper in a smaller world, and
  // adjustment would shrink pieces whose scale nothing else holds.
  constexpr double kTightness = 0.05;
  std::vector<Turn> turns;
  for (std::uint32_t i = 0; i + 1 < num_images(); ++i) {
    if (!IsSameTurn(i, i + 1) || !camera_from_world[i] ||
        !camera_from_world[i + 1] || (!is_wanted[i] && !is_wanted[i + 1])) {
      continue;
    }
    std::vector<double> depths;
    for (const std::uint32_t image : {i, i + 1}) {
      PlacedSights(image, [&](const Sight&, const Eigen::Vector3d& p_world) {
        depths.push_back((*camera_from_world[image] * p_world).z());
      });
    }
    // Where nothing has a depth, nothing else holds the two.
    const double way_sigma =
        depths.empty() ? 1e-3
                       : kTightness * kTrackSigma_px / lens.focal_px *
                             std::abs(base::Median(std::move(depths)));
    const auto turn = FitTurn(*this, i, i + 1, /*lens_is_known=*/true);
    if (!turn) continue;
    turns.push_back({i, turn->second_from_first, way_sigma});
  }
  return turns;
}

bool TrackScene::Start(std::uint32_t first, std::uint32_t second) {
  std::vector<Eigen::Vector2d> x1;
  std::vector<Eigen::Vector2d> x2;
  CommonSights(first, second, [&](const Sight& a, const Sight& b) {
    x1.push_back(lens.NormalizedFromImage(a.pixel_px));
    x2.push_back(lens.NormalizedFromImage(b.pixel_px));
  });
  if (x1.size() < kMinStartPoints) return false;
  const std::vector<cv::Point2d> from = Points2(x1);
  const std::vector<cv::Point2d> to = Points2(x2);
  const cv::Mat K = cv::Mat::eye(3, 3, CV_64F);
  cv::Mat mask;
  const cv::Mat E = cv::findEssentialMat(
      from, to, K, cv::RANSAC, 0.999, 1.0 / lens.focal_px, 500, mask);
  if (E.rows != 3) return false;
  cv::Mat R;
  cv::Mat t;
  cv::recoverPose(E, from, to, K, R, t, mask);
  std::fill(camera_from_world.begin(), camera_from_world.end(), std::nullopt);
  for (Point& point : points) {
    point.p_world.reset();
    for (Sight& sight : point.sights) sight.fits = true;
  }
  camera_from_world[first] = geometry::Rigid3();
  camera_from_world[second] = RigidOf(R, t);
  Triangulate(first, 2);
  std::vector<double> angles;
  for (const Point& point : points) {
    if (point.p_world) angles.push_back(WidestAngle_rad(point));
  }
  if (angles.size() < kMinStartPoints) return false;
  std::nth_element(
      angles.begin(),
      angles.begin() + static_cast<std::ptrdiff_t>(angles.size() / 2),
      angles.end());
  return angles[angles.size() / 2] >= kStartAngles * MinAngle_rad();
}

bool TrackScene::Resect(std::uint32_t image) {
  std::vector<cv::Point3d> objects;
  std::vector<cv::Point2d> pixels;
  std::vector<Sight*> sights;
  for (const std::uint32_t track : tracks_of_[image]) {
    Point& point = points[track];
    if (!point.p_world) continue;
    for (Sight& sight : point.sights) {
      if (sight.image != image) continue;
      const Eigen::Vector2d x = lens.NormalizedFromImage(sight.pixel_px);
      objects.emplace_back(
          point.p_world->x(), point.p_world->y(), point.p_world->z());
      pixels.emplace_back(x.x(), x.y());
      sights.push_back(&sight);
    }
  }
  if (objects.size() < kMinResected) return false;
  cv::Mat rotation;
  cv::Mat t;
  std::vector<int> inliers;
  const cv::Mat K = cv::Mat::eye(3, 3, CV_64F);
  if (!cv::solvePnPRansac(objects,
                          pixels,
                          K,
                          cv::noArray(),
                          rotation,
                          t,
                          false,
                          kPnpRounds,
                          static_cast<float>(kTrackGate_px / lens.focal_px),
                          0.9999,
                          inliers,
                          cv::SOLVEPNP_AP3P)) {
    return false;
  }
  if (inliers.size() < kMinResected ||
      static_cast<double>(inliers.size()) <
          kMinResectedShare * static_cast<double>(objects.size())) {
    return false;
  }
  cv::Mat R;
  cv::Rodrigues(rotation, R);
  camera_from_world[image] = RigidOf(R, t);
  std::vector<bool> fits(sights.size());
  for (const int i : inliers) fits[static_cast<std::size_t>(i)] = true;
  for (std::size_t i = 0; i < sights.size(); ++i) sights[i]->fits = fits[i];
  return true;
}

std::uint32_t TrackScene::CountSights() const {
  std::uint32_t count = 0;
  for (const Point& point : points) {
    if (!point.p_world) continue;
    for (const Sight& sight : point.sights) {
      count += sight.fits && camera_from_world[sight.image] ? 1 : 0;
    }
  }
  return count;
}

double TrackScene::Parallax() const {
  constexpr double kEnough = 30.0;
  double sum = 0.0;
  for (const Point& point : points) {
    if (!point.p_world) continue;
    sum += std::min(kEnough, WidestAngle_rad(point) / MinAngle_rad());
  }
  return sum;
}

double TrackScene::TrimmedCost_px2() const {
  constexpr double kWorst = 1e4;
  std::vector<double> costs;
  for (const Point& point : points) {
    const std::vector<const Sight*> posed = PosedSights(point);
    if (posed.size() < 3) continue;
    std::optional<Eigen::Vector3d> p = point.p_world;
    if (!p) p = Intersect(posed);
    double sum = 0.0;
    for (const Sight* sight : posed) {
      const double error = p ? ErrorOf_px(*sight, *p) : kWorst;
      sum += std::min(kWorst, error * error);
    }
    costs.push_back(sum / static_cast<double>(posed.size()));
  }
  if (costs.empty()) return kWorst;
  const std::size_t half = costs.size() / 2;
  std::nth_element(costs.begin(),
                   costs.begin() + static_cast<std::ptrdiff_t>(half),
                   costs.end());
  double sum = 0.0;
  for (std::size_t i = 0; i <= half; ++i) sum += costs[i];
  return sum / static_cast<double>(half + 1);
}

double TrackScene::MeanError_px() const {
  double sum = 0.0;
  std::size_t count = 0;
  for (const Point& point : points) {
    if (!point.p_world) continue;
    for (const Sight& sight : point.sights) {
      if (!sight.fits || !camera_from_world[sight.image]) continue;
      sum += ErrorOf_px(sight, *point.p_world);
      ++count;
    }
  }
  return count == 0 ? 0.0 : sum / static_cast<double>(count);
}

}  // namespace groundlock::build::internal
