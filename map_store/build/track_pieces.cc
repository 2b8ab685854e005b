// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/track_pieces.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/order_statistics.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {
namespace {

constexpr std::size_t kMinPoints = 15;
constexpr double kMaxScaleSigma = 0.1;
// From the median of absolute deviations to a normal distribution's sigma.
constexpr double kSigmaOfMad = 1.4826;
// Two grounds are the same if their normals agree within so many sigmas.
constexpr double kMaxTiltSigmas = 3.0;

struct Scale {
  double whole_from_piece = 1.0;
  double log_sigma = 0.0;
};

// By the distances of points that both have placed from the shared images.
std::optional<Scale> ScaleOfPoints(const TrackScene& whole,
                                   const TrackScene& piece,
                                   const std::vector<std::uint32_t>& shared) {
  const std::uint32_t image = shared[shared.size() / 2];
  const Eigen::Vector3d in_whole =
      whole.camera_from_world[image]->Inverse().translation;
  const Eigen::Vector3d in_piece =
      piece.camera_from_world[image]->Inverse().translation;
  std::vector<double> ratios;
  for (std::size_t i = 0; i < whole.points.size(); ++i) {
    if (!whole.points[i].p_world || !piece.points[i].p_world) continue;
    ratios.push_back(std::log((*whole.points[i].p_world - in_whole).norm() /
                              (*piece.points[i].p_world - in_piece).norm()));
  }
  if (ratios.size() < kMinPoints) return std::nullopt;
  const double median = base::Median(ratios);
  const auto count = static_cast<double>(ratios.size());
  for (double& ratio : ratios) ratio = std::abs(ratio - median);
  return Scale{
      std::exp(median),
      kSigmaOfMad * base::Median(std::move(ratios)) / std::sqrt(count)};
}

// The points of a scene as a map that its ground is looked for in.
std::optional<map::GroundEstimate> GroundOf(
    const TrackScene& scene, const geometry::CameraModel& camera) {
  const Eigen::Vector2d middle(0.5 * camera.width_px(),
                               0.5 * camera.height_px());
  map::MapData data;
  data.source_format = "video";
  data.cameras = {camera};
  std::vector<std::size_t> view_of(scene.num_images());
  for (std::uint32_t i = 0; i < scene.num_images(); ++i) {
    if (!scene.camera_from_world[i]) continue;
    view_of[i] = data.views.size();
    map::MapViewData& view = data.views.emplace_back();
    view.name = absl::StrCat(i);
    view.camera_from_world = *scene.camera_from_world[i];
  }
  for (const TrackScene::Point& point : scene.points) {
    if (!point.p_world) continue;
    const auto landmark = static_cast<std::uint32_t>(data.landmarks.size());
    data.landmarks.emplace_back().p_world = *point.p_world;
    for (const TrackScene::Sight& sight : point.sights) {
      if (!sight.fits || !scene.camera_from_world[sight.image]) continue;
      map::MapViewData& view = data.views[view_of[sight.image]];
      view.keypoints_px.push_back((sight.pixel_px + middle).cast<float>());
      view.landmarks.push_back(landmark);
    }
  }
  auto ground = map::AlignToEstimatedGround(0, data);
  if (!ground.ok() || !ground->doubt.empty()) return std::nullopt;
  return *std::move(ground);
}

// By the camera's height over the ground, from the same place.
std::optional<Scale> ScaleOfGround(const TrackScene& whole,
                                   const TrackScene& piece,
                                   const geometry::CameraModel& camera,
                                   const std::vector<std::uint32_t>& shared,
                                   const Eigen::Quaterniond& turn) {
  const auto in_whole = GroundOf(whole, camera);
  const auto in_piece = GroundOf(piece, camera);
  if (!in_whole || !in_piece) return std::nullopt;
  const Eigen::Vector3d normal = turn * in_piece->ground_source.normal;
  const double tilt_rad =
      std::atan2(normal.cross(in_whole->ground_source.normal).norm(),
                 normal.dot(in_whole->ground_source.normal));
  if (tilt_rad >
      kMaxTiltSigmas * std::hypot(in_whole->sigma_rad, in_piece->sigma_rad)) {
    return std::nullopt;
  }
  const std::uint32_t image = shared[shared.size() / 2];
  const double height_whole = in_whole->ground_source.SignedDistance(
      whole.camera_from_world[image]->Inverse().translation);
  const double height_piece = in_piece->ground_source.SignedDistance(
      piece.camera_from_world[image]->Inverse().translation);
  if (!(height_whole > 0.0) || !(height_piece > 0.0)) return std::nullopt;
  return Scale{height_whole / height_piece,
               std::hypot(in_whole->height_sigma / height_whole,
                          in_piece->height_sigma / height_piece)};
}

}  // namespace

std::optional<PieceJoint> FindJoint(const TrackScene& whole,
                                    const TrackScene& piece,
                                    const geometry::CameraModel& camera) {
  std::vector<std::uint32_t> shared;
  for (std::uint32_t i = 0; i < whole.num_images(); ++i) {
    if (whole.camera_from_world[i] && piece.camera_from_world[i]) {
      shared.push_back(i);
    }
  }
  if (shared.empty()) return std::nullopt;
  // The mean turn; quaternions of one sign.
  Eigen::Vector4d sum = Eigen::Vector4d::Zero();
  for (const std::uint32_t i : shared) {
    Eigen::Vector4d one = (whole.camera_from_world[i]->rotation.conjugate() *
                           piece.camera_from_world[i]->rotation)
                              .coeffs();
    if (one.dot(sum) < 0.0) one = -one;
    sum += one;
  }
  const Eigen::Quaterniond turn(Eigen::Quaterniond(sum).normalized());
  auto scale = ScaleOfPoints(whole, piece, shared);
  const bool is_by_ground = !scale;
  if (!scale) scale = ScaleOfGround(whole, piece, camera, shared, turn);
  if (!scale || scale->log_sigma > kMaxScaleSigma) return std::nullopt;
  PieceJoint joint;
  joint.whole_from_piece.scale = scale->whole_from_piece;
  joint.whole_from_piece.rotation = turn;
  joint.scale_log_sigma = scale->log_sigma;
  joint.is_by_ground = is_by_ground;
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();
  for (const std::uint32_t i : shared) {
    shift += whole.camera_from_world[i]->Inverse().translation -
             scale->whole_from_piece *
                 (turn * piece.camera_from_world[i]->Inverse().translation);
  }
  joint.whole_from_piece.translation =
      shift / static_cast<double>(shared.size());
  return joint;
}

void AddPiece(const TrackScene& piece,
              const geometry::Similarity3& whole_from_piece,
              TrackScene& whole) {
  for (std::uint32_t i = 0; i < whole.num_images(); ++i) {
    if (whole.camera_from_world[i] || !piece.camera_from_world[i]) continue;
    whole.camera_from_world[i] = geometry::TransformCameraFromWorld(
        whole_from_piece, *piece.camera_from_world[i]);
  }
  whole.Triangulate(std::nullopt, 3);
}

}  // namespace groundlock::build::internal
