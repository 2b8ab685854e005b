// SPDX-License-Identifier: Apache-2.0
// How the camera turned between two frames, from image corners alone: bridges
// moments in which no landmark is seen.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_ROTATION_FLOW_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_ROTATION_FLOW_H_

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <span>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "server/image/luma_pyramid.h"

namespace groundlock::localization {

struct FlowRotation {
  Eigen::Quaterniond before_from_now = Eigen::Quaterniond::Identity();
  int num_inliers = 0;
  double rms_error_rad = 0.0;  // of the inliers' directions
};

// The rotation that most corners' directions follow: corners of the earlier
// frame, not within `masks_px`, are followed by Lucas-Kanade there and back.
//   expected_before_from_now  where the search starts.
// nullopt if too few corners agree: black, blank or blurred frames. The
// translation in between, seen against the distance of things, is part of the
// error. Thread-safe; deterministic by seed.
// Source: Kabsch 1976 (rotation); Fischler & Bolles 1981.
std::optional<FlowRotation> EstimateRotation(
    const image::LumaPyramid& before,
    const image::LumaPyramid& now,
    const geometry::CameraModel& camera,
    std::span<const geometry::Box2> masks_px,
    const Eigen::Quaterniond& expected_before_from_now,
    std::uint64_t seed);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_ROTATION_FLOW_H_
