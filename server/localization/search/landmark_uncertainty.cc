// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/landmark_uncertainty.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace groundlock::localization {
namespace {

constexpr double kMinObservationError_px = 0.5;
// Observations looked at: more add little and cost as much each.
constexpr std::size_t kMaxObservations = 32;

}  // namespace

Eigen::Matrix3d LandmarkCovariance(const map::Map& map,
                                   std::uint32_t landmark) {
  const map::Landmark& point = map.landmarks()[landmark];
  const Eigen::Vector3d p_world = point.Position();
  const double sigma_px =
      std::max(kMinObservationError_px, static_cast<double>(point.error_px));
  const auto observations = map.ObservationsOf(point);
  const std::size_t stride =
      (observations.size() + kMaxObservations - 1) / kMaxObservations;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  double distance = 0.0;
  for (std::size_t i = 0; i < observations.size(); i += stride) {
    const map::MapView& view = map.view(map.features()[observations[i]].view);
    Eigen::Matrix<double, 2, 3> d_pixel;
    if (!map.camera(view.camera)
             .ImageFromCamera(view.camera_from_world * p_world, &d_pixel)) {
      continue;
    }
    const Eigen::Matrix<double, 2, 3> J =
        d_pixel * view.camera_from_world.rotation.toRotationMatrix() / sigma_px;
    information.noalias() += static_cast<double>(stride) * J.transpose() * J;
    distance = std::max(distance, (p_world - view.center_world).norm());
  }
  if (!(distance > 0.0)) distance = 1.0;
  information.diagonal().array() += 1.0 / (distance * distance);
  return information.inverse();
}

}  // namespace groundlock::localization
