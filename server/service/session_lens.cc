// SPDX-License-Identifier: Apache-2.0
#include "server/service/session_lens.h"

#include <algorithm>
#include <array>

#include "absl/strings/str_cat.h"

namespace groundlock::service {

absl::StatusOr<geometry::CameraModel> LensOfMap(const map::Map& map,
                                                const std::string& name) {
  if (map.info().lens) return *map.info().lens;
  return absl::InvalidArgumentError(
      absl::StrCat("camera: missing, and map '",
                   name,
                   "' does not tell it: its views were taken with ",
                   map.info().num_cameras,
                   " lenses"));
}

absl::StatusOr<geometry::CameraModel> LensForSize(
    const std::optional<geometry::CameraModel>& lens, const cv::Size& size_px) {
  if (!lens) {
    return geometry::CameraModel::Create(
        geometry::CameraModelId::kSimplePinhole,
        size_px.width,
        size_px.height,
        std::array<double, 3>{
            static_cast<double>(std::max(size_px.width, size_px.height)),
            0.5 * size_px.width,
            0.5 * size_px.height});
  }
  if (auto fitting =
          geometry::ScaledToFit(*lens, size_px.width, size_px.height)) {
    return *std::move(fitting);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("the frame has ",
                   size_px.width,
                   " x ",
                   size_px.height,
                   " px, the map's lens is for ",
                   lens->width_px(),
                   " x ",
                   lens->height_px(),
                   ": give the camera's own lens"));
}

}  // namespace groundlock::service
