// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/session_landmarks.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <unordered_set>
#include <utility>

#include "server/image/frame.h"

namespace groundlock::localization {
namespace {

// Frames that are remembered, and observations of one landmark; of more, every
// second of the older half goes.
constexpr std::size_t kMaxOwnFrames = 128;
constexpr std::size_t kMaxOwnObservations = 24;
// Of a patch that is followed from a key frame, and of the poses' own errors as
// they show in the image.
constexpr double kObservation_px = 0.5;
constexpr int kTriangulationSteps = 3;
// A thing at rest is nearer to where it was seen than this.
constexpr double kMaxRestError_px = 1.5;
constexpr std::size_t kMinObservationsToJudge = 4;
// Nearer to infinity no pose differs.
constexpr double kFarthestOverPrior = 1e3;

// Cells without a landmark of the map are where it has nothing to follow.
constexpr int kCornerColumns = 8;
constexpr int kCornerRows = 6;
constexpr int kCornersPerCell = 4;
constexpr double kFreeCornerDistance_px = 24.0;
// Smaller eigenvalue of the mean of the squared slopes, (8-bit levels per
// pixel)^2: sensor noise alone stays below a tenth of it.
constexpr float kMinCorner = 2.0F;
constexpr int kCornerBlock_px = 7;
constexpr int kMaxCornerSide_px = 640;
constexpr double kCornerBorder_px = 16.0;

int CornerCellOf(const Eigen::Vector2d& pixel_px, cv::Size size_px) {
  const int column = std::clamp(
      static_cast<int>(pixel_px.x() * kCornerColumns / size_px.width),
      0,
      kCornerColumns - 1);
  const int row =
      std::clamp(static_cast<int>(pixel_px.y() * kCornerRows / size_px.height),
                 0,
                 kCornerRows - 1);
  return row * kCornerColumns + column;
}

bool IsGreatest(float value, const float* three) {
  return value >= three[0] && value >= three[1] && value >= three[2];
}

}  // namespace

Eigen::Vector3d SessionLandmarks::Landmark::At(double its_inverse_depth) const {
  return world_from_host *
         Eigen::Vector3d(normalized.homogeneous() / its_inverse_depth);
}

std::vector<LandmarkMatch> SessionLandmarks::Add(
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    std::span<const Sighting> sightings) {
  std::vector<LandmarkMatch> added;
  if (sightings.empty()) return added;
  const std::uint64_t frame = first_frame_ + frames_.size();
  for (const Sighting& sighting : sightings) {
    const Eigen::Vector2d& pixel_px = sighting.pixel_px;
    const auto normalized = camera.NormalizedFromImage(pixel_px);
    if (!normalized || !(sighting.depth > 0.0)) continue;
    Landmark landmark;
    landmark.world_from_host = world_from_camera;
    landmark.normalized = *normalized;
    landmark.inverse_depth = 1.0 / sighting.depth;
    landmark.prior_inverse_depth = landmark.inverse_depth;
    landmark.prior_sigma = sighting.relative_sigma * landmark.inverse_depth;
    landmark.inverse_depth_sigma = landmark.prior_sigma;
    landmark.p_world = landmark.At(landmark.inverse_depth);
    landmark.observations.push_back({frame, pixel_px});
    added.push_back({next_id_, pixel_px});
    landmarks_.emplace(next_id_++, std::move(landmark));
  }
  frames_.push_back(world_from_camera);
  return added;
}

void SessionLandmarks::Observe(const geometry::CameraModel& camera,
                               const geometry::Rigid3& world_from_camera,
                               std::span<const LandmarkMatch> seen) {
  if (landmarks_.empty()) {
    Clear();
    return;
  }
  const std::uint64_t frame = first_frame_ + frames_.size();
  frames_.push_back(world_from_camera);
  while (frames_.size() > kMaxOwnFrames) {
    frames_.pop_front();
    ++first_frame_;
  }
  for (const LandmarkMatch& match : seen) {
    const auto found = landmarks_.find(match.landmark);
    if (found == landmarks_.end()) continue;
    Landmark& landmark = found->second;
    std::vector<Observation>& observations = landmark.observations;
    observations.push_back({frame, match.pixel_px});
    std::erase_if(observations, [&](const Observation& observation) {
      return observation.frame < first_frame_;
    });
    if (observations.size() > kMaxOwnObservations) {
      std::size_t kept = 0;
      for (std::size_t i = 0; i < observations.size(); ++i) {
        if (i % 2 == 0 || i >= kMaxOwnObservations / 2) {
          observations[kept++] = observations[i];
        }
      }
      observations.resize(kept);
    }
    if (!Triangulate(camera, landmark)) landmarks_.erase(found);
  }
}

bool SessionLandmarks::Triangulate(const geometry::CameraModel& camera,
                                   Landmark& landmark) {
  // Gauss-Newton on (x, y, inverse depth), with the prior that made it.
  Eigen::Vector3d estimate;
  estimate << landmark.normalized, landmark.inverse_depth;
  const double prior = landmark.prior_inverse_depth;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  double squared_px2 = 0.0;
  std::size_t used = 0;
  for (int iteration = 0; iteration < kTriangulationSteps; ++iteration) {
    information.setZero();
    // With Cauchy's weight: what was taken for the ground may stand before it.
    const double off = (prior - estimate[2]) / landmark.prior_sigma;
    const double prior_weight =
        1.0 / (landmark.prior_sigma * landmark.prior_sigma * (1.0 + off * off));
    information(2, 2) = prior_weight;
    Eigen::Vector3d b(0.0, 0.0, prior_weight * (prior - estimate[2]));
    squared_px2 = 0.0;
    used = 0;
    for (const Observation& observation : landmark.observations) {
      const geometry::Rigid3 camera_from_host =
          frames_[observation.frame - first_frame_].Inverse() *
          landmark.world_from_host;
      // Scaled by the inverse depth, which leaves the pixel where it is.
      const Eigen::Vector3d ray(estimate[0], estimate[1], 1.0);
      const Eigen::Vector3d p = camera_from_host.rotation * ray +
                                estimate[2] * camera_from_host.translation;
      Eigen::Matrix<double, 2, 3> d_pixel;
      const auto pixel = camera.ImageFromCamera(p, &d_pixel);
      if (!pixel) continue;
      const Eigen::Vector2d residual = observation.pixel_px - *pixel;
      const double error_px = residual.norm();
      Eigen::Matrix3d d_p;
      d_p.leftCols<2>() =
          camera_from_host.rotation.toRotationMatrix().leftCols<2>();
      d_p.col(2) = camera_from_host.translation;
      const Eigen::Matrix<double, 2, 3> J = d_pixel * d_p;
      // Huber's weight.
      const double weight =
          std::min(1.0, 2.0 * kObservation_px / std::max(error_px, 1e-9)) /
          (kObservation_px * kObservation_px);
      information.noalias() += weight * J.transpose() * J;
      b.noalias() += weight * J.transpose() * residual;
      squared_px2 += error_px * error_px;
      ++used;
    }
    const Eigen::Vector3d step = information.ldlt().solve(b);
    if (!step.allFinite()) return false;
    estimate += step;
    estimate[2] = std::max(estimate[2], prior / kFarthestOverPrior);
  }
  if (used >= kMinObservationsToJudge &&
      squared_px2 >
          kMaxRestError_px * kMaxRestError_px * static_cast<double>(used)) {
    return false;
  }
  const double variance = information.inverse()(2, 2);
  if (!(variance > 0.0) || !std::isfinite(variance)) return false;
  landmark.normalized = estimate.head<2>();
  landmark.inverse_depth = estimate[2];
  landmark.inverse_depth_sigma = std::sqrt(variance);
  landmark.p_world = landmark.At(landmark.inverse_depth);
  return true;
}

std::optional<double> SessionLandmarks::ParallaxVariance_px2(
    const geometry::CameraModel& camera,
    const geometry::Rigid3& a_from_world,
    const geometry::Rigid3& b_from_world,
    std::uint32_t id) const {
  const Landmark& landmark = landmarks_.at(id);
  const Eigen::Vector3d other =
      landmark.At(landmark.inverse_depth + landmark.inverse_depth_sigma);
  const auto in_a = camera.ImageFromCamera(a_from_world * landmark.p_world);
  const auto in_b = camera.ImageFromCamera(b_from_world * landmark.p_world);
  const auto other_in_a = camera.ImageFromCamera(a_from_world * other);
  const auto other_in_b = camera.ImageFromCamera(b_from_world * other);
  if (!in_a || !in_b || !other_in_a || !other_in_b) return std::nullopt;
  return 0.5 * ((*other_in_b - *in_b) - (*other_in_a - *in_a)).squaredNorm();
}

double SessionLandmarks::RelativeSigma(std::uint32_t id) const {
  const Landmark& landmark = landmarks_.at(id);
  return landmark.inverse_depth_sigma / landmark.inverse_depth;
}

void SessionLandmarks::Keep(std::span<const LandmarkMatch> kept) {
  std::unordered_set<std::uint32_t> ids;
  for (const LandmarkMatch& match : kept) ids.insert(match.landmark);
  std::erase_if(landmarks_,
                [&](const auto& entry) { return !ids.contains(entry.first); });
}

void SessionLandmarks::Move(const geometry::Rigid3& moved_from_before) {
  for (geometry::Rigid3& frame : frames_) frame = moved_from_before * frame;
  for (auto& [id, landmark] : landmarks_) {
    landmark.world_from_host = moved_from_before * landmark.world_from_host;
    landmark.p_world = landmark.At(landmark.inverse_depth);
  }
}

void SessionLandmarks::Clear() {
  landmarks_.clear();
  first_frame_ += frames_.size();
  frames_.clear();
}

std::vector<Eigen::Vector2d> FindFreeCorners_px(
    const image::LumaPyramid& pyramid,
    std::span<const geometry::Box2> masks_px,
    std::span<const LandmarkMatch> known,
    int max_corners) {
  std::vector<int> room(kCornerColumns * kCornerRows, kCornersPerCell);
  for (const LandmarkMatch& match : known) {
    --room[CornerCellOf(match.pixel_px, pyramid.size_px)];
  }
  if (max_corners <= 0 ||
      std::none_of(room.begin(), room.end(), [](int r) { return r > 0; })) {
    return {};
  }
  int level = 0;
  while (level + 1 < static_cast<int>(pyramid.levels.size()) &&
         pyramid.levels[level].cols > kMaxCornerSide_px) {
    ++level;
  }
  const double scale = 1 << level;
  cv::Mat strength;
  cv::cornerMinEigenVal(pyramid.levels[level], strength, kCornerBlock_px);
  // OpenCV takes levels to be in [0, 1], and slopes to be twice as steep.
  constexpr float kToLevels = 255.0F * 255.0F / 4.0F;
  struct Corner {
    float strength;
    Eigen::Vector2d pixel_px;
  };
  std::vector<Corner> corners;
  for (int y = 1; y + 1 < strength.rows; ++y) {
    const float* const row = strength.ptr<float>(y);
    const float* const above = strength.ptr<float>(y - 1);
    const float* const below = strength.ptr<float>(y + 1);
    for (int x = 1; x + 1 < strength.cols; ++x) {
      const float value = row[x];
      if (value * kToLevels < kMinCorner) continue;
      if (!IsGreatest(value, row + x - 1) ||
          !IsGreatest(value, above + x - 1) ||
          !IsGreatest(value, below + x - 1)) {
        continue;
      }
      const Eigen::Vector2d pixel_px(scale * (x + image::kPixelCenter),
                                     scale * (y + image::kPixelCenter));
      if (room[CornerCellOf(pixel_px, pyramid.size_px)] <= 0) continue;
      corners.push_back({value, pixel_px});
    }
  }
  std::sort(corners.begin(), corners.end(), [](const auto& a, const auto& b) {
    if (a.strength != b.strength) return a.strength > b.strength;
    return a.pixel_px.y() != b.pixel_px.y() ? a.pixel_px.y() < b.pixel_px.y()
                                            : a.pixel_px.x() < b.pixel_px.x();
  });
  std::vector<Eigen::Vector2d> taken;
  for (const LandmarkMatch& match : known) taken.push_back(match.pixel_px);
  std::vector<Eigen::Vector2d> chosen;
  for (const Corner& corner : corners) {
    if (static_cast<int>(chosen.size()) == max_corners) break;
    const Eigen::Vector2d& p = corner.pixel_px;
    int& left = room[CornerCellOf(p, pyramid.size_px)];
    const bool is_inside = p.x() >= kCornerBorder_px &&
                           p.y() >= kCornerBorder_px &&
                           p.x() < pyramid.size_px.width - kCornerBorder_px &&
                           p.y() < pyramid.size_px.height - kCornerBorder_px;
    if (left <= 0 || !is_inside ||
        std::any_of(masks_px.begin(),
                    masks_px.end(),
                    [&](const auto& mask) { return mask.Contains(p); }) ||
        std::any_of(taken.begin(), taken.end(), [&](const auto& other) {
          return (other - p).norm() < kFreeCornerDistance_px;
        })) {
      continue;
    }
    --left;
    taken.push_back(p);
    chosen.push_back(p);
  }
  return chosen;
}

}  // namespace groundlock::localization
