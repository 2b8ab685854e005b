// SPDX-License-Identifier: Apache-2.0
// Up by what stands upright in the images: walls, posts, trunks. Their edges
// point at one place of each image (the vanishing point of the vertical), and
// by the images' poses at one direction of the map.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_UPRIGHT_EDGES_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_UPRIGHT_EDGES_H_

#include <Eigen/Core>
#include <filesystem>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/map/map_data.h"
#include "map_store/map/measured_up.h"

namespace groundlock::build::internal {

// The planes through the camera's centre and the straight edges of an image
// (8-bit luma of any size, of that camera): their unit normals, camera frame.
// Source: von Gioi et al., "LSD: a line segment detector", IPOL 2012.
std::vector<Eigen::Vector3d> FindEdgePlanes(
    const cv::Mat& luma, const geometry::CameraModel& camera);

// The direction that more of the planes hold than chance explains, among those
// within 30 degrees of `up_guess`; nullopt unless it stands out from all
// others.
//   normals_world  of the planes of all images together, unit
std::optional<map::UprightEdges> UpByEdgePlanes(
    std::span<const Eigen::Vector3d> normals_world,
    const Eigen::Vector3d& up_guess);

// From the images of a map (at most a hundred, evenly) that lie in `folder`
// under their views' names; those that cannot be read are skipped.
std::optional<map::UprightEdges> FindUprightEdges(
    const map::MapData& data, const std::filesystem::path& folder);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_UPRIGHT_EDGES_H_
