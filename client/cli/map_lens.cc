// SPDX-License-Identifier: Apache-2.0
#include "client/cli/map_lens.h"

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

// Of the logarithm of the focal length: twice what the lenses found from
// flights differed by from those of the same camera's other flights.
constexpr double kOtherLens = 0.07;

}  // namespace

std::string LensText(const geometry::CameraModel& lens) {
  return absl::StrFormat("%dx%d, %s, focal length %.1f px",
                         lens.width_px(),
                         lens.height_px(),
                         std::string(geometry::CameraModelName(lens.id())),
                         lens.mean_focal_px());
}

absl::StatusOr<geometry::CameraModel> LensOfMap(sdk::Client& client,
                                                const std::string& map_name) {
  ASSIGN_OR_RETURN(const sdk::MapInfo map,
                   client.GetMap(map_name, /*version=*/0));
  if (map.lens) return *map.lens;
  return absl::InvalidArgumentError(
      absl::StrCat("--camera camera.json is missing: the lens of the camera "
                   "that took the input. Map ",
                   map_name,
                   " does not tell it: its views were taken with ",
                   map.num_cameras,
                   " lenses"));
}

absl::StatusOr<geometry::CameraModel> LensForSize(
    const geometry::CameraModel& lens,
    const std::string& map_name,
    int width_px,
    int height_px) {
  if (auto fitting = geometry::ScaledToFit(lens, width_px, height_px)) {
    return *std::move(fitting);
  }
  return absl::InvalidArgumentError(absl::StrFormat(
      "--camera camera.json is missing: the pictures are %dx%d, and the lens "
      "of map %s is for %dx%d, another picture",
      width_px,
      height_px,
      map_name,
      lens.width_px(),
      lens.height_px()));
}

std::string LensWarning(const geometry::CameraModel& given,
                        const geometry::CameraModel& of_map) {
  const auto fitting =
      geometry::ScaledToFit(of_map, given.width_px(), given.height_px());
  if (!fitting) return "";
  const double ratio = given.mean_focal_px() / fitting->mean_focal_px();
  if (std::abs(std::log(ratio)) < kOtherLens) return "";
  return absl::StrFormat(
      "the lens given (%s) is not the one that the map was made with (focal "
      "length %.1f px at this size): right only if another camera took the "
      "input; without --camera the map's is used",
      LensText(given),
      fitting->mean_focal_px());
}

std::string SeenLensWarning(const geometry::CameraModel& lens,
                            const sdk::LensContradiction& seen) {
  std::string text = absl::StrFormat(
      "in this map the frames show another lens than the one given (%s):",
      LensText(lens));
  if (seen.focal_ratio != 1.0) {
    absl::StrAppendFormat(&text,
                          " a focal length of about %.0f px",
                          seen.focal_ratio * lens.mean_focal_px());
  }
  if (seen.corner_share != 0.0) {
    absl::StrAppendFormat(
        &text,
        "%s its distortion leaves the corners %.0f %% too far %s",
        seen.focal_ratio != 1.0 ? ", and" : "",
        100.0 * std::abs(seen.corner_share),
        seen.corner_share > 0.0 ? "in" : "out");
  }
  return text + "; poses and boxes are off as long as camera and map differ";
}

}  // namespace groundlock::cli
