// SPDX-License-Identifier: Apache-2.0
#include "client/cli/map_lens.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/status.h"

namespace groundlock::cli {

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

}  // namespace groundlock::cli
