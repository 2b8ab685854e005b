// SPDX-License-Identifier: Apache-2.0
// Whether the pictures were taken with the lens that the session was given: the
// landmarks that a frame sees fix the focal length as well as the pose, where
// they are not all at one distance, and the distortion where they reach the
// corners.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_LENS_CHECK_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_LENS_CHECK_H_

#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/localization/localizer.h"

namespace groundlock::localization {

// What one frame says, with standard deviations.
struct LensMeasurement {
  double log_focal = 0.0;  // logarithm of the seen over the given focal length
  double log_focal_sigma = 0.0;
  // What the distortion leaves unexplained in the image's corner, as a share of
  // its distance from the principal point.
  double corner = 0.0;
  double corner_sigma = 0.0;
};

// A wrong lens moves what a pose projects by up to so much.
inline constexpr double kLensMatchRadius_px = 48.0;

// Fits pose, focal length and one coefficient of radial distortion together,
// from several focal lengths, and takes what explains most of the matches.
// nullopt if they do not fix them all. Thread-safe. Source of the refinement:
// as RefinePoseRobustly (robust_pose.h).
//   matches  also those that the lens does not explain: within
//            kLensMatchRadius_px of where the pose projects them.
std::optional<LensMeasurement> MeasureLens(
    const map::Map& map,
    const geometry::CameraModel& camera,
    std::span<const LandmarkMatch> matches,
    const geometry::Rigid3& world_from_camera);

// The camera with a focal length of `ratio` times its own; nullopt if that is
// beyond what a camera may have.
std::optional<geometry::CameraModel> WithFocalRatio(
    const geometry::CameraModel& camera, double ratio);

// Gathers what frames say until they agree. Not thread-safe.
class LensCheck {
 public:
  bool WantsMore() const;
  void Add(const LensMeasurement& measurement);
  // By which other focal length to look for a camera that was not found with
  // its own, as a ratio: several in turn, then what a frame has shown. nullopt
  // once frames have confirmed or contradicted the lens, or after a dozen.
  std::optional<double> NextProbe();
  // Set once the frames agree that the lens is another one.
  const std::optional<LensContradiction>& contradiction() const {
    return contradiction_;
  }

 private:
  friend struct StateFields;

  std::vector<LensMeasurement> measurements_;
  std::size_t next_probe_ = 0;
  std::size_t num_probes_ = 0;
  std::optional<double> suspected_ratio_;
  bool is_confirmed_ = false;
  std::optional<LensContradiction> contradiction_;
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_LENS_CHECK_H_
