// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/pose_prior.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::localization {
namespace {

constexpr double kSigmas = 3.0;
constexpr double kSharedView_rad = std::numbers::pi / 3.0;
constexpr std::size_t kMinViews = 8;

}  // namespace

absl::Status PosePrior::Validate() const {
  if (position_world && !position_world->allFinite()) {
    return absl::InvalidArgumentError("the position is not finite");
  }
  if (position_world && geodetic_position) {
    return absl::InvalidArgumentError("two positions are given");
  }
  if (geodetic_position) RETURN_IF_ERROR(geodetic_position->Validate());
  if (!position_arm_camera.allFinite()) {
    return absl::InvalidArgumentError("position_arm_camera is not finite");
  }
  if (position_world || geodetic_position) {
    if (!(position_sigma > 0.0) || !std::isfinite(position_sigma)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "position_sigma is ", position_sigma, ", must be above 0"));
    }
  }
  if (rotation) {
    if (!rotation->coeffs().allFinite() ||
        std::abs(rotation->norm() - 1.0) > 1e-6) {
      return absl::InvalidArgumentError("the rotation is no unit quaternion");
    }
    if (!(rotation_sigma_rad > 0.0) || !std::isfinite(rotation_sigma_rad)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "rotation_sigma_rad is ", rotation_sigma_rad, ", must be above 0"));
    }
  }
  return absl::OkStatus();
}

std::optional<geometry::Rigid3> PosePrior::world_from_camera() const {
  if (!position_world || !rotation) return std::nullopt;
  return geometry::Rigid3{*rotation,
                          *position_world - *rotation * position_arm_camera};
}

absl::StatusOr<PosePrior> PlaceInWorld(const map::Map& map, PosePrior prior) {
  if (!prior.geodetic_position) return prior;
  if (!map.info().origin) {
    return absl::FailedPreconditionError(
        "prior: the map has no origin, so a place on the Earth has none in it");
  }
  prior.position_world =
      geometry::WorldFromGeodetic(*map.info().origin, *prior.geodetic_position);
  prior.geodetic_position.reset();
  return prior;
}

std::vector<bool> ViewsNearPrior(const map::Map& map, const PosePrior& prior) {
  std::vector<bool> near(map.num_views(), !prior.position_world);
  if (!prior.position_world) return near;
  const double max_angle_rad =
      kSharedView_rad + kSigmas * prior.rotation_sigma_rad;
  std::vector<std::pair<double, std::size_t>> by_distance;
  for (std::size_t i = 0; i < map.num_views(); ++i) {
    const map::MapView& view = map.view(i);
    if (prior.rotation) {
      const double cos_angle =
          (*prior.rotation * Eigen::Vector3d::UnitZ())
              .dot(view.camera_from_world.rotation.conjugate() *
                   Eigen::Vector3d::UnitZ());
      if (std::acos(std::clamp(cos_angle, -1.0, 1.0)) > max_angle_rad) continue;
    }
    by_distance.emplace_back((view.center_world - *prior.position_world).norm(),
                             i);
  }
  std::sort(by_distance.begin(), by_distance.end());
  for (std::size_t rank = 0; rank < by_distance.size(); ++rank) {
    const auto& [distance, view] = by_distance[rank];
    near[view] =
        rank < kMinViews || distance <= kSigmas * prior.position_sigma +
                                            prior.position_arm_camera.norm();
  }
  return near;
}

}  // namespace groundlock::localization
