// SPDX-License-Identifier: Apache-2.0
// What in a picture of which each pixel is the ground or not is a body's
// silhouette. Boxes and pixels of that picture, the first one's centre at
// (0.5, 0.5).
#ifndef GROUNDLOCK_SERVER_TRACKING_SILHOUETTE_PARTS_H_
#define GROUNDLOCK_SERVER_TRACKING_SILHOUETTE_PARTS_H_

#include <Eigen/Core>
#include <opencv2/core/types.hpp>
#include <optional>

#include "map_store/geometry/box.h"
#include "server/tracking/ground_comparison.h"

namespace groundlock::tracking {

// What is surely in a silhouette, and how far what may be of it reaches.
struct PixelSilhouette {
  cv::Rect sure;
  cv::Rect possible;
};

// The silhouette of what is expected there. nullopt: too little stands out.
// Thread-safe, as are the others.
std::optional<PixelSilhouette> FindSilhouette(const GroundLabels& labels,
                                              const geometry::Box2& expected);

// The middle of the largest part that surely stands out, if some of it is where
// the body is expected.
std::optional<Eigen::Vector2d> MiddleOfNextPart(const GroundLabels& labels,
                                                const geometry::Box2& expected);

// Much of the expected box lies beside what is seen and shows the ground.
bool IsGroundBeside(const GroundLabels& labels,
                    const geometry::Box2& expected,
                    const geometry::Box2& seen);

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_SILHOUETTE_PARTS_H_
