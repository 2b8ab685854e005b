// SPDX-License-Identifier: Apache-2.0
// COLMAP's text model: cameras.txt, images.txt, points3D.txt.
#include <limits>
#include <string>

#include "map_store/base/status.h"
#include "map_store/formats/internal/colmap_model.h"
#include "map_store/formats/internal/text_reader.h"

namespace groundlock::formats::internal {
namespace {

using base::Abseil;

absl::Status ReadCamera(std::string_view line,
                        const TextReader& reader,
                        ColmapCamera* camera) {
  Words words(line);
  if (!words.Next(&camera->id)) return reader.Error("no camera id");
  const std::string where = absl::StrCat("camera ", camera->id);
  const std::string_view model = words.Next();
  const auto id = geometry::CameraModelIdFromName(model);
  if (!id.ok()) {
    return absl::UnimplementedError(absl::StrCat(
        reader.Error(where).message(), ": ", id.status().message()));
  }
  int width_px = 0;
  int height_px = 0;
  if (!words.Next(&width_px) || !words.Next(&height_px)) {
    return reader.Error(where + ": no width and height");
  }
  std::vector<double> params;
  while (!words.Rest().empty()) {
    if (params.size() == geometry::CameraModel::kMaxParams) {
      return reader.Error(where + ": too many parameters");
    }
    if (!words.Next(&params.emplace_back())) {
      return reader.Error(
          absl::StrCat(where, ": parameter ", params.size(), " is no number"));
    }
  }
  auto created =
      geometry::CameraModel::Create(*id, width_px, height_px, params);
  if (!created.ok()) {
    return reader.Error(absl::StrCat(where, ": ", created.status().message()));
  }
  camera->camera = *created;
  return absl::OkStatus();
}

absl::Status ReadImageHead(std::string_view line,
                           const TextReader& reader,
                           ColmapImage* image) {
  Words words(line);
  if (!words.Next(&image->id)) return reader.Error("no image id");
  const std::string where = absl::StrCat("image ", image->id);
  std::array<double, 4> q{};
  std::array<double, 3> t{};
  for (double& value : q) {
    if (!words.Next(&value)) return reader.Error(where + ": bad quaternion");
  }
  for (double& value : t) {
    if (!words.Next(&value)) return reader.Error(where + ": bad translation");
  }
  if (!words.Next(&image->camera_id)) {
    return reader.Error(where + ": no camera id");
  }
  image->name = std::string(words.Rest());
  if (const absl::Status name = CheckImageName(image->name); !name.ok()) {
    return reader.Error(absl::StrCat(where, ": ", name.message()));
  }
  auto camera_from_world = RigidFromFile(q, t);
  if (!camera_from_world.ok()) {
    return reader.Error(
        absl::StrCat(where, ": ", camera_from_world.status().message()));
  }
  image->camera_from_world = *camera_from_world;
  return absl::OkStatus();
}

absl::Status ReadPoints2d(std::string_view line,
                          const TextReader& reader,
                          ColmapImage* image) {
  Words words(line);
  while (!words.Rest().empty()) {
    Eigen::Vector2f xy_px;
    std::int64_t point_id = 0;  // -1 = no 3D point
    if (!words.Next(&xy_px.x()) || !words.Next(&xy_px.y()) ||
        !words.Next(&point_id) || point_id < -1) {
      return reader.Error(absl::StrCat("image ",
                                       image->name,
                                       ": 2D point ",
                                       image->num_points2d,
                                       " is not X Y POINT3D_ID"));
    }
    if (point_id >= 0) {
      image->features.push_back(
          {static_cast<std::uint64_t>(point_id),
           xy_px,
           static_cast<std::uint32_t>(image->num_points2d)});
    }
    if (++image->num_points2d > std::numeric_limits<std::uint32_t>::max()) {
      return reader.Error("too many 2D points");
    }
  }
  image->features.shrink_to_fit();
  return absl::OkStatus();
}

absl::Status ReadPoint(std::string_view line,
                       const TextReader& reader,
                       ColmapPoint* point,
                       std::vector<ColmapTrackElement>* tracks) {
  Words words(line);
  if (!words.Next(&point->id)) return reader.Error("no point id");
  const std::string where = absl::StrCat("point ", point->id);
  map::MapLandmarkData& landmark = point->landmark;
  for (int i = 0; i < 3; ++i) {
    if (!words.Next(&landmark.p_world[i])) {
      return reader.Error(where + ": bad position");
    }
  }
  for (std::uint8_t& c : landmark.rgb) {
    if (!words.Next(&c)) return reader.Error(where + ": bad colour");
  }
  float error_px = 0.0F;
  if (!words.Next(&error_px)) return reader.Error(where + ": bad error");
  landmark.error_px = error_px > 0.0F ? error_px : 0.0F;  // -1 = not computed
  while (!words.Rest().empty()) {
    ColmapTrackElement element;
    if (!words.Next(&element.image_id) || !words.Next(&element.index)) {
      return reader.Error(absl::StrCat(where,
                                       ": observation ",
                                       point->track_length,
                                       " is not IMAGE_ID POINT2D_IDX"));
    }
    tracks->push_back(element);
    ++point->track_length;
  }
  return absl::OkStatus();
}

// A line of a text model is never binary; saying so beats "no camera id".
absl::Status CheckIsText(std::string_view text, std::string_view file) {
  if (text.substr(0, 64).find('\0') == std::string_view::npos) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      absl::StrCat(Abseil(file), ": this is binary, not COLMAP's text format"));
}

}  // namespace

absl::Status ParseColmapCamerasText(std::string_view text,
                                    std::string_view file,
                                    ColmapModel* model) {
  RETURN_IF_ERROR(CheckIsText(text, file));
  TextReader reader(text, file);
  std::string_view line;
  while (reader.NextRecord(&line)) {
    RETURN_IF_ERROR(ReadCamera(line, reader, &model->cameras.emplace_back()));
  }
  return absl::OkStatus();
}

absl::Status ParseColmapImagesText(std::string_view text,
                                   std::string_view file,
                                   ColmapModel* model) {
  RETURN_IF_ERROR(CheckIsText(text, file));
  TextReader reader(text, file);
  std::string_view line;
  while (reader.NextRecord(&line)) {
    ColmapImage& image = model->images.emplace_back();
    RETURN_IF_ERROR(ReadImageHead(line, reader, &image));
    // The second line may be empty: an image without 2D points.
    if (!reader.NextLine(&line)) break;
    RETURN_IF_ERROR(ReadPoints2d(line, reader, &image));
  }
  return absl::OkStatus();
}

absl::Status ParseColmapPointsText(std::string_view text,
                                   std::string_view file,
                                   ColmapModel* model) {
  RETURN_IF_ERROR(CheckIsText(text, file));
  TextReader reader(text, file);
  std::string_view line;
  while (reader.NextRecord(&line)) {
    RETURN_IF_ERROR(
        ReadPoint(line, reader, &model->points.emplace_back(), &model->tracks));
  }
  return absl::OkStatus();
}

}  // namespace groundlock::formats::internal
