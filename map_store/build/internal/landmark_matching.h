// SPDX-License-Identifier: Apache-2.0
// Finds a map's landmarks by their looks.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_LANDMARK_MATCHING_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_LANDMARK_MATCHING_H_

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "map_store/build/internal/image_features.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/landmark_index.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// An observation: a feature of a view.
struct ObservationId {
  std::uint32_t view = 0;
  std::uint32_t feature = 0;  // within the view
};

// The observations of each landmark, in the order of the views.
std::vector<std::vector<ObservationId>> ObservationsByLandmark(
    const map::MapData& data);

struct LandmarkMatch {
  std::uint32_t query = 0;     // index of what was looked for
  std::uint32_t landmark = 0;  // that looks like it
  int squared_distance = 0;
};

// For each descriptor the landmark that looks most like it, if the next other
// one is clearly farther (Lowe 2004). At most one query per landmark: the
// nearest.
std::vector<LandmarkMatch> MatchToLandmarks(
    std::span<const map::Descriptor> queries,
    const map::LandmarkIndex& index,
    double ratio);

// An image that found its place among a map's landmarks.
struct FoundPose {
  geometry::Rigid3 camera_from_world;
  std::vector<LandmarkMatch> inliers;  // query = feature
};
// From 2D-3D matches; nullopt if fewer than `min_inliers` agree. Deterministic,
// thread-safe. Source: Ke & Roumeliotis 2017 (P3P), in RANSAC.
std::optional<FoundPose> FindPose(const ImageFeatures& features,
                                  const geometry::CameraModel& camera,
                                  const map::MapData& data,
                                  const map::LandmarkIndex& index,
                                  int min_inliers);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_LANDMARK_MATCHING_H_
