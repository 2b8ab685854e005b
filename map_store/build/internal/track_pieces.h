// SPDX-License-Identifier: Apache-2.0
// Pieces of a video's way that no track with a depth holds together, as on both
// sides of a turn on the spot: each is a TrackScene of its own, in a world of
// its own.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_PIECES_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_PIECES_H_

#include <optional>

#include "map_store/build/internal/track_scene.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/similarity3.h"

namespace groundlock::build::internal {

struct PieceJoint {
  geometry::Similarity3 whole_from_piece;
  // 1 sigma of the logarithm of its scale.
  double scale_log_sigma = 0.0;
  bool is_by_ground = false;  // else by points
};

// How a piece lies to the whole, of the same tracks, by the images that both
// have a pose for, all in one place if the camera turned there. Its scale is
// that of points that both have placed, else that of the camera's height over
// the ground, where both pieces show the same one. nullopt if they share no
// image, or if nothing tells the scale to a tenth. Deterministic.
std::optional<PieceJoint> FindJoint(const TrackScene& whole,
                                    const TrackScene& piece,
                                    const geometry::CameraModel& camera);

// Gives the images of a piece their poses in the whole, where they have none.
void AddPiece(const TrackScene& piece,
              const geometry::Similarity3& whole_from_piece,
              TrackScene& whole);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_PIECES_H_
