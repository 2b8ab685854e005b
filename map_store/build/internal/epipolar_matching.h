// SPDX-License-Identifier: Apache-2.0
// Matching of images whose poses are known, and the tracks that come of it.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_EPIPOLAR_MATCHING_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_EPIPOLAR_MATCHING_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/image_pairs.h"
#include "map_store/build/internal/triangulation.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map_data.h"

namespace groundlock::build::internal {

// An image with its pose, as matching needs it.
struct PosedFeatures {
  const ImageFeatures* features = nullptr;
  const geometry::CameraModel* camera = nullptr;
  geometry::Rigid3 camera_from_world;
};

// The pairs that may see the same, by how much of one image's view lies in the
// other's at some distance (from twice to a hundred times that of neighbouring
// cameras): per image the `per_image` best with at least min_overlap. Sorted.
std::vector<ImagePair> ChoosePairsByOverlap(
    std::span<const PosedFeatures> images,
    std::size_t per_image,
    double min_overlap);

struct EpipolarOptions {
  double max_distance_px = 3.0;  // from the epipolar line
  double ratio = 0.8;            // to the second best on that line
  // Of 512 * RootSIFT: beyond, two patches do not look alike.
  double max_descriptor_distance = 350.0;
};

// Features that are each other's best near their epipolar lines.
std::vector<std::array<std::uint32_t, 2>> MatchAlongEpipolarLines(
    const PosedFeatures& first,
    const PosedFeatures& second,
    const EpipolarOptions& options);

// Joins matches into tracks and triangulates them: new landmarks with their
// observations are appended to `data`, whose views are those of `images`, one
// to one. Features that observe a landmark already are left out. A track that
// holds several points that exclude each other gives several landmarks.
// Returns how many were added.
std::size_t TriangulateTracks(std::span<const PosedFeatures> images,
                              std::span<const PairMatches> matches,
                              const TriangulationOptions& options,
                              map::MapData* data);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_EPIPOLAR_MATCHING_H_
