// SPDX-License-Identifier: Apache-2.0
// What a camera that turns on the spot sees: tracks that show no depth.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_TURN_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_TURN_H_

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "map_store/build/internal/track_scene.h"

namespace groundlock::build::internal {

struct TurnFit {
  Eigen::Quaterniond second_from_first = Eigen::Quaterniond::Identity();
  RadialLens lens;
  std::size_t num_tracks = 0;
  // Half of the tracks are nearer to where the turn takes them.
  double median_px = 0.0;
  // Half of the tracks are moved by less in the image.
  double median_shift_px = 0.0;
  // Of the tracks, within the gate.
  double share = 0.0;
  // 1 sigma of the logarithm of the lens' focal length, where it was sought;
  // 0 = it was not.
  double focal_log_sigma = 0.0;

  // Half of what both images show is where a turn takes it: whatever depth or
  // way it has, these two images do not tell them. Of a picture that has hardly
  // moved a short way is not told from a turn; then neither is said.
  bool ExplainsTheTracks() const {
    return median_px <= kTurnGate_px &&
           median_px <= kLeftOfShift * median_shift_px;
  }
  static constexpr double kLeftOfShift = 0.1;
  // Three sigma of the difference of two sights.
  static constexpr double kTurnGate_px = 3.0 * 1.4142 * kTrackSigma_px;
};

// The turn that takes pixels of one image (from the principal point) to those
// of another, in the sense of least absolute errors; several such f and k of
// the lens are tried and adjusted along unless it is known. nullopt if there
// are fewer than 30 of them.
// Source: Hartley & Zisserman, 2nd ed., section 13.4 (the infinite homography
// K R K^-1).
std::optional<TurnFit> FitTurn(std::span<const Eigen::Vector2d> first_px,
                               std::span<const Eigen::Vector2d> second_px,
                               const RadialLens& lens,
                               const LensPrior* prior_of_unknown);

// Of two images of a scene, by all tracks that both see.
std::optional<TurnFit> FitTurn(const TrackScene& scene,
                               std::uint32_t first,
                               std::uint32_t second,
                               bool lens_is_known);

// A camera that turns on the spot tells its focal length: the picture's edges
// move faster than its middle by what the angles between rays say. That of the
// turn in the video that tells it best, with its sigma; nullopt if none does to
// a tenth.
// Source: Hartley & Zisserman, 2nd ed., section 19.6 (a rotating camera).
std::optional<TurnFit> LensOfTurns(const TrackScene& scene);

// Per image, which turn it belongs to: images of one number follow each other,
// and all that they see of the same tracks is explained by turns. By the lens
// as it is.
std::vector<std::uint32_t> FindTurns(const TrackScene& scene);

// Gives `image` the place of a neighbour in time of the same turn, turned as
// the tracks say. False: no such neighbour has a pose.
bool PlaceByTurn(std::uint32_t image, TrackScene& scene);

// The pose of an image by its turn, else from the points that it sees; one that
// fewer of the tracks shared with a neighbour agree with than with a turn,
// which is the least that any motion explains, is none. False: not placed.
bool PlaceImage(std::uint32_t image, TrackScene& scene);

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_TRACK_TURN_H_
