// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/map_data.h"

#include <cmath>
#include <limits>
#include <optional>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/file_layout.h"

namespace groundlock::map {
namespace {

// Indices in the file are 32 bits wide.
constexpr std::size_t kMaxCount = std::numeric_limits<std::uint32_t>::max();
// Importers normalise in double precision; text formats keep 6 digits or more.
constexpr double kUnitTolerance = 1e-5;

bool IsUnit(const Eigen::Quaterniond& q) {
  return std::abs(q.norm() - 1.0) <= kUnitTolerance;
}

absl::Status CheckView(const MapData& data,
                       const MapViewData& view,
                       bool with_descriptors) {
  if (view.name.size() > internal::kMaxNameBytes) {
    return absl::InvalidArgumentError(absl::StrCat("name of ",
                                                   view.name.size(),
                                                   " bytes, at most ",
                                                   internal::kMaxNameBytes));
  }
  if (view.name.find('\0') != std::string::npos) {
    return absl::InvalidArgumentError("name holds a zero byte");
  }
  if (view.camera >= data.cameras.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("camera ", view.camera, " of ", data.cameras.size()));
  }
  if (!view.camera_from_world.IsFinite() ||
      !IsUnit(view.camera_from_world.rotation)) {
    return absl::InvalidArgumentError(
        "pose is not finite or its quaternion not of unit length");
  }
  const std::size_t count = view.keypoints_px.size();
  if (count > kMaxCount) return absl::InvalidArgumentError("too many features");
  if (view.landmarks.size() != count) {
    return absl::InvalidArgumentError(absl::StrCat(
        count, " keypoints but ", view.landmarks.size(), " landmarks"));
  }
  if (view.descriptors.size() != (with_descriptors ? count : 0)) {
    return absl::InvalidArgumentError(absl::StrCat(
        count, " keypoints but ", view.descriptors.size(), " descriptors"));
  }
  for (std::size_t i = 0; i < count; ++i) {
    if (!view.keypoints_px[i].allFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat("feature ", i, ": position is not finite"));
    }
    if (view.landmarks[i] >= data.landmarks.size()) {
      return absl::InvalidArgumentError(absl::StrCat("feature ",
                                                     i,
                                                     ": landmark ",
                                                     view.landmarks[i],
                                                     " of ",
                                                     data.landmarks.size()));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status MapData::Validate() const {
  if (source_format.size() > internal::kMaxSourceFormatBytes) {
    return absl::InvalidArgumentError("source_format is too long");
  }
  if (cameras.size() > kMaxCount || views.size() > kMaxCount ||
      landmarks.size() > kMaxCount) {
    return absl::InvalidArgumentError(
        "too many cameras, views or landmarks for 32-bit indices");
  }
  if (!world_from_source.IsFinite() || !(world_from_source.scale > 0.0) ||
      !IsUnit(world_from_source.rotation)) {
    return absl::InvalidArgumentError(
        "world_from_source is not a similarity transform");
  }
  if (!ground.normal.allFinite() || !std::isfinite(ground.d) ||
      std::abs(ground.normal.norm() - 1.0) > kUnitTolerance) {
    return absl::InvalidArgumentError("ground is not a plane");
  }
  if (origin) {
    if (!metric) {
      return absl::InvalidArgumentError("origin: the map is not metric");
    }
    RETURN_IF_ERROR(base::Annotate(origin->Validate(), "origin"));
  }
  const bool with_descriptors = has_descriptors();
  for (std::size_t i = 0; i < views.size(); ++i) {
    RETURN_IF_ERROR(base::Annotate(CheckView(*this, views[i], with_descriptors),
                                   "view " + std::to_string(i) + " '" +
                                       views[i].name.substr(0, 80) + "'"));
  }
  for (std::size_t i = 0; i < landmarks.size(); ++i) {
    if (!landmarks[i].p_world.allFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat("landmark ", i, ": position is not finite"));
    }
    if (!(landmarks[i].error_px >= 0.0F) ||
        !std::isfinite(landmarks[i].error_px)) {
      return absl::InvalidArgumentError(
          absl::StrCat("landmark ", i, ": error is ", landmarks[i].error_px));
    }
  }
  return absl::OkStatus();
}

void MapData::Transform(const geometry::Similarity3& new_world_from_world) {
  for (MapViewData& view : views) {
    view.camera_from_world = geometry::TransformCameraFromWorld(
        new_world_from_world, view.camera_from_world);
  }
  for (MapLandmarkData& landmark : landmarks) {
    landmark.p_world = new_world_from_world * landmark.p_world;
  }
  std::optional<Eigen::Vector3d> relief_origin;
  if (!given_relief.empty() && new_world_from_world.scale == 1.0 &&
      new_world_from_world.rotation.isApprox(Eigen::Quaterniond::Identity(),
                                             1e-12)) {
    relief_origin =
        geometry::PlaneAxes(ground).ToWorld(given_relief.origin_plane) +
        new_world_from_world.translation;
  }
  // n.x + d = 0 with x = R^T (x' - t) / s: n' = R n, d' = s d - n'.t.
  ground.normal = new_world_from_world.rotation * ground.normal;
  if (measured_up) {
    measured_up->up_world =
        new_world_from_world.rotation * measured_up->up_world;
  }
  ground.d = new_world_from_world.scale * ground.d -
             ground.normal.dot(new_world_from_world.translation);
  if (relief_origin) {
    given_relief.origin_plane =
        geometry::PlaneAxes(ground).FromWorld(*relief_origin);
  } else {
    given_relief = {};
  }
  world_from_source = new_world_from_world * world_from_source;
}

ReprojectionStatistics ComputeReprojection(const MapData& data) {
  ReprojectionStatistics statistics;
  double sum_px = 0.0;
  for (const MapViewData& view : data.views) {
    const geometry::CameraModel& camera = data.cameras[view.camera];
    for (std::size_t i = 0; i < view.keypoints_px.size(); ++i) {
      const Eigen::Vector3d& p_world =
          data.landmarks[view.landmarks[i]].p_world;
      const std::optional<Eigen::Vector2d> pixel =
          camera.ImageFromCamera(view.camera_from_world * p_world);
      if (!pixel.has_value()) {
        ++statistics.num_behind_camera;
        continue;
      }
      ++statistics.num_observations;
      sum_px += (*pixel - view.keypoints_px[i].cast<double>()).norm();
    }
  }
  if (statistics.num_observations > 0) {
    statistics.mean_error_px =
        sum_px / static_cast<double>(statistics.num_observations);
  }
  return statistics;
}

}  // namespace groundlock::map
