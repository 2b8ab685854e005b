// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/status.h"
#include "map_store/decoding/image_reader.h"
#include "map_store/features/describe_points.h"
#include "map_store/formats/internal/named_files.h"

namespace groundlock::formats::internal {

absl::Status DescribeFromImages(std::span<const ViewImage> images,
                                const std::function<bool()>& go_on,
                                map::MapData* data,
                                std::vector<std::string>* lacking,
                                std::vector<std::string>* warnings) {
  std::size_t num_points = 0;
  std::size_t num_detected = 0;
  std::size_t num_images = 0;
  std::string first_failure;
  decoding::ImageReader reader;
  for (std::size_t v = 0; v < data->views.size(); ++v) {
    map::MapViewData& view = data->views[v];
    if (view.keypoints_px.empty()) continue;
    if (images[v].path.empty()) {
      lacking->push_back(view.name);
      continue;
    }
    if (go_on != nullptr && !go_on()) {
      return absl::CancelledError("the import was ended");
    }
    auto described = features::DescribePoints(
        reader, images[v].path, view.keypoints_px, images[v].sizes_px);
    const geometry::CameraModel& camera = data->cameras[view.camera];
    absl::Status status = described.status();
    if (status.ok() && (described->width_px != camera.width_px() ||
                        described->height_px != camera.height_px())) {
      status =
          absl::InvalidArgumentError(absl::StrCat(images[v].path.string(),
                                                  ": has ",
                                                  described->width_px,
                                                  "x",
                                                  described->height_px,
                                                  " pixels, the model says ",
                                                  camera.width_px(),
                                                  "x",
                                                  camera.height_px()));
    }
    if (!status.ok()) {
      if (first_failure.empty()) first_failure = std::string(status.message());
      lacking->push_back(view.name);
      continue;
    }
    view.descriptors = std::move(described->descriptors);
    num_points += view.keypoints_px.size();
    num_detected += described->num_detected;
    ++num_images;
  }
  if (!first_failure.empty()) {
    warnings->push_back("an image is of no use: " + first_failure);
  }
  if (num_images > 0) {
    warnings->push_back(absl::StrCat("computed descriptors from ",
                                     num_images,
                                     " images; SIFT detects ",
                                     num_detected,
                                     " of the ",
                                     num_points,
                                     " features itself"));
  }
  return absl::OkStatus();
}

}  // namespace groundlock::formats::internal
