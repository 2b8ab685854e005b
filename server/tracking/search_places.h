// SPDX-License-Identifier: Apache-2.0
// Where to look for a target that is not where it was predicted.
#ifndef GROUNDLOCK_SERVER_TRACKING_SEARCH_PLACES_H_
#define GROUNDLOCK_SERVER_TRACKING_SEARCH_PLACES_H_

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <vector>

namespace groundlock::tracking {

// Offsets (pixels) of a grid of `step_px` over the two-sigma ellipse of
// `covariance_px2`, nearest in Mahalanobis distance first, without the centre,
// at most kMaxSearchPlaces. With a step of twice a tracker's reach, it finds
// what lies anywhere in the ellipse.
inline constexpr int kMaxSearchPlaces = 64;
std::vector<Eigen::Vector2d> SearchOffsets(
    const Eigen::Vector2d& step_px, const Eigen::Matrix2d& covariance_px2);

// Centres of a grid of `step_px` over an image of `size_px`, row by row; the
// grid is widened to at most kMaxImagePlaces. Empty if a step or a size is not
// positive.
inline constexpr int kMaxImagePlaces = 1'024;
std::vector<Eigen::Vector2d> ImagePlaces(const Eigen::Vector2d& step_px,
                                         const Eigen::Vector2d& size_px);

// The same where the step depends on the place, as of a target that looks
// smaller farther away: rows as high and places as wide as it is there; without
// those where it has none.
//   step_at  of the pixel; nullopt, or not positive: the target is not there.
using StepAt = std::function<std::optional<Eigen::Vector2d>(
    const Eigen::Vector2d& pixel_px)>;
std::vector<Eigen::Vector2d> ImagePlaces(const StepAt& step_at,
                                         const Eigen::Vector2d& size_px);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_SEARCH_PLACES_H_
