// SPDX-License-Identifier: Apache-2.0
// Ties a frame to the map's own descriptors: around a known pose, or from
// nothing. Costs a SIFT extraction, so it runs off the frame path.
//
// search/ holds what finds a camera in a map by what single frames look like,
// whatever came before:
//   anchoring             the way of a frame: around a prior, else anywhere,
//                         and whether what was found is believed
//   place_search          which places of the map it may show, a pose for each
//   guided_matching       around a pose, which feature is which landmark
//   one_surface           whether a picture that hangs elsewhere explains it
//   anchor_pose           what the matches say of the pose, and how surely
//   landmark_uncertainty  what the map says of a landmark's place
//   lens_check            whether the pictures are another lens's
//   pose_prior            what other sensors say, to narrow the search
//   anchor_job            all of this on a thread of its own
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHORING_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHORING_H_

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/localization/localizer.h"
#include "server/localization/solvers/robust_pose.h"

namespace groundlock::localization {

struct AnchorRequest {
  cv::Mat luma;
  geometry::CameraModel camera;
  std::vector<geometry::Box2> masks_px;
  // Where the camera is thought to be; a wrong prior costs time, not the
  // result.
  std::optional<geometry::Rigid3> prior_world_from_camera;
  // What other sensors say; its position is in world (PlaceInWorld).
  std::optional<PosePrior> prior;
  std::uint64_t seed = 0;
  bool wants_lens_matches = false;
};

struct AnchorOptions {
  // Of a frame without a prior. With one, most of them would match anyway, and
  // the strongest are the best placed.
  int max_features = 4'000;
  int max_features_with_prior = 1'000;
  // The frame is halved while its longer side stays this long. Of 1280 x 720,
  // features of half the size give more inliers than those of the finest octave
  // that they replace, half the pose error, and cost a third
  // (relocalization_benchmark).
  int min_longer_side_px = 640;
  // A photograph's pose is found by features of the frame at twice that size: a
  // fifth more accurate (docs/benchmarks.md), and slower.
  bool is_photograph = false;
  // False: only around a predicted pose, or that of other sensors.
  bool search_anywhere = true;
  double sift_contrast_threshold = 0.02;
  int min_landmark_views = 3;
};

struct Anchor {
  RobustPose pose;
  std::vector<LandmarkMatch> inliers;
  // If wanted: also those that the pose does not explain (lens_check.h).
  std::vector<LandmarkMatch> lens_matches;
  bool used_prior = false;
  double log_false_alarms = 0.0;  // agreement.h
};

// nullopt if no pose is believed (agreement.h, one_surface.h). Thread-safe;
// deterministic by seed.
std::optional<Anchor> FindAnchor(const map::Map& map,
                                 const AnchorRequest& request,
                                 const AnchorOptions& options);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_ANCHORING_H_
