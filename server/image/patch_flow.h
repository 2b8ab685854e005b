// SPDX-License-Identifier: Apache-2.0
// Where a small patch of one image is in another: pyramidal Lucas-Kanade.
// Source: Lucas & Kanade 1981; Bouguet 2001 (pyramidal implementation).
#ifndef GROUNDLOCK_SERVER_IMAGE_PATCH_FLOW_H_
#define GROUNDLOCK_SERVER_IMAGE_PATCH_FLOW_H_

#include <opencv2/core/types.hpp>
#include <optional>

#include "server/image/luma_pyramid.h"

namespace groundlock::image {

struct PatchFlowOptions {
  // Levels of the pyramid, from the coarsest (clipped to those there are) to
  // the finest.
  int coarsest_level = 0;
  int finest_level = 0;
  // On each level; fewer once a step is shorter than `epsilon_px` of it.
  int max_iterations = 12;
  double epsilon_px = 0.02;
};

struct PatchFlow {
  cv::Point2d point_px;
  // Mean absolute difference of the two patches on the finest level, 8-bit
  // levels.
  double difference = 0.0;
};

// Follows the patch of LumaPyramid::kWindowPx pixels a side around `from_px`,
// looked for around `start_px`. Both and the result are pixels of the whole
// image, whose first one's centre is (0.5, 0.5). nullopt: it leaves the image,
// or has no texture in some direction. Thread-safe.
std::optional<PatchFlow> FollowPatch(const LumaPyramid& from,
                                     const LumaPyramid& to,
                                     const cv::Point2d& from_px,
                                     const cv::Point2d& start_px,
                                     const PatchFlowOptions& options);

}  // namespace groundlock::image

#endif  // GROUNDLOCK_SERVER_IMAGE_PATCH_FLOW_H_
