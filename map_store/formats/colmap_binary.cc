// SPDX-License-Identifier: Apache-2.0
// COLMAP's binary model: cameras.bin, images.bin, points3D.bin.
#include <limits>
#include <optional>

#include "map_store/base/status.h"
#include "map_store/formats/internal/binary_reader.h"
#include "map_store/formats/internal/colmap_model.h"

namespace groundlock::formats::internal {
namespace {

using base::Abseil;

constexpr std::uint64_t kNoPoint = std::numeric_limits<std::uint64_t>::max();
constexpr std::size_t kMaxNameBytes = 4'096;

// The smallest records: a camera has 3 parameters, an image and a track none.
constexpr std::size_t kMinBinaryCameraBytes = 4 + 4 + 8 + 8 + 3 * 8;
constexpr std::size_t kMinBinaryImageBytes = 4 + 7 * 8 + 4 + 1 + 8;
constexpr std::size_t kPoint2dBytes = 8 + 8 + 8;
constexpr std::size_t kMinBinaryPointBytes = 8 + 3 * 8 + 3 + 8 + 8;
constexpr std::size_t kTrackElementBytes = 4 + 4;

// COLMAP's models that we do not have, by id, for the message.
std::string_view UnsupportedModelName(int id) {
  switch (id) {
    case 6:
      return "FULL_OPENCV";
    case 7:
      return "FOV";
    case 8:
      return "SIMPLE_RADIAL_FISHEYE";
    case 9:
      return "RADIAL_FISHEYE";
    case 10:
      return "THIN_PRISM_FISHEYE";
    case 11:
      return "RAD_TAN_THIN_PRISM_FISHEYE";
    default:
      return "unknown";
  }
}

absl::StatusOr<std::uint64_t> ReadCount(BinaryReader* reader,
                                        std::string_view bytes,
                                        std::string_view file,
                                        std::size_t min_item_bytes,
                                        std::string_view what) {
  if (LooksLikeText(bytes)) {
    return absl::InvalidArgumentError(absl::StrCat(
        Abseil(file),
        ": this is text, not COLMAP's binary format; COLMAP's text files end "
        "in .txt"));
  }
  const auto count = reader->Read<std::uint64_t>();
  RETURN_IF_ERROR(reader->CheckOk("the count of its items"));
  RETURN_IF_ERROR(reader->CheckCount(count, min_item_bytes, what));
  return count;
}

absl::Status ReadCamera(BinaryReader* reader, ColmapCamera* camera) {
  camera->id = reader->Read<std::uint32_t>();
  const auto model = reader->Read<std::int32_t>();
  const auto width_px = reader->Read<std::uint64_t>();
  const auto height_px = reader->Read<std::uint64_t>();
  RETURN_IF_ERROR(reader->CheckOk("a camera"));
  const std::string where = absl::StrCat("camera ", camera->id);
  if (model < 0 || model > 5) {
    return absl::UnimplementedError(
        absl::StrCat(reader->Error(where).message(),
                     ": camera model ",
                     model,
                     " (",
                     Abseil(UnsupportedModelName(model)),
                     ") is not supported; undistort the images first"));
  }
  constexpr int kMax = geometry::CameraModel::kMaxSizePx;
  if (width_px > kMax || height_px > kMax) {
    return reader->Error(absl::StrCat(
        where, ": size ", width_px, "x", height_px, ", at most ", kMax));
  }
  const auto id = static_cast<geometry::CameraModelId>(model);
  std::array<double, geometry::CameraModel::kMaxParams> params{};
  const auto num_params =
      static_cast<std::size_t>(geometry::NumCameraModelParams(id));
  for (std::size_t i = 0; i < num_params; ++i) {
    params[i] = reader->Read<double>();
  }
  RETURN_IF_ERROR(reader->CheckOk(where));
  auto created = geometry::CameraModel::Create(id,
                                               static_cast<int>(width_px),
                                               static_cast<int>(height_px),
                                               {params.data(), num_params});
  if (!created.ok()) {
    return reader->Error(absl::StrCat(where, ": ", created.status().message()));
  }
  camera->camera = *created;
  return absl::OkStatus();
}

absl::Status ReadPoints2d(BinaryReader* reader, ColmapImage* image) {
  image->num_points2d = reader->Read<std::uint64_t>();
  const std::string where = absl::StrCat("image ", image->name);
  RETURN_IF_ERROR(reader->CheckOk(where));
  RETURN_IF_ERROR(reader->CheckCount(image->num_points2d,
                                     kPoint2dBytes,
                                     absl::StrCat("2D points of ", where)));
  if (image->num_points2d > std::numeric_limits<std::uint32_t>::max()) {
    return reader->Error(where + ": too many 2D points");
  }
  for (std::uint32_t i = 0; i < image->num_points2d; ++i) {
    const auto x = reader->Read<double>();
    const auto y = reader->Read<double>();
    const auto point_id = reader->Read<std::uint64_t>();
    if (point_id == kNoPoint) continue;
    const Eigen::Vector2f xy_px(static_cast<float>(x), static_cast<float>(y));
    if (!xy_px.allFinite()) {
      return reader->Error(
          absl::StrCat(where, ": 2D point ", i, " is not finite"));
    }
    image->features.push_back({point_id, xy_px, i});
  }
  image->features.shrink_to_fit();
  return absl::OkStatus();
}

absl::Status ReadImage(BinaryReader* reader, ColmapImage* image) {
  std::array<double, 4> q{};
  std::array<double, 3> t{};
  image->id = reader->Read<std::uint32_t>();
  for (double& value : q) value = reader->Read<double>();
  for (double& value : t) value = reader->Read<double>();
  image->camera_id = reader->Read<std::uint32_t>();
  image->name = std::string(reader->ReadCString(kMaxNameBytes));
  RETURN_IF_ERROR(reader->CheckOk(absl::StrCat("image ", image->id)));
  if (const absl::Status name = CheckImageName(image->name); !name.ok()) {
    return reader->Error(
        absl::StrCat("image ", image->id, ": ", name.message()));
  }
  auto camera_from_world = RigidFromFile(q, t);
  if (!camera_from_world.ok()) {
    return reader->Error(absl::StrCat(
        "image ", image->name, ": ", camera_from_world.status().message()));
  }
  image->camera_from_world = *camera_from_world;
  return ReadPoints2d(reader, image);
}

absl::Status ReadPoint(BinaryReader* reader,
                       ColmapPoint* point,
                       std::vector<ColmapTrackElement>* tracks) {
  point->id = reader->Read<std::uint64_t>();
  map::MapLandmarkData& landmark = point->landmark;
  for (int i = 0; i < 3; ++i) landmark.p_world[i] = reader->Read<double>();
  for (std::uint8_t& c : landmark.rgb) c = reader->Read<std::uint8_t>();
  const auto error_px = reader->Read<double>();
  point->track_length = reader->Read<std::uint64_t>();
  const std::string where = absl::StrCat("point ", point->id);
  RETURN_IF_ERROR(reader->CheckOk(where));
  if (!landmark.p_world.allFinite()) {
    return reader->Error(where + ": position is not finite");
  }
  // COLMAP writes -1 where it has not computed the error.
  const auto error_or_0 = static_cast<float>(error_px > 0.0 ? error_px : 0.0);
  landmark.error_px = std::isfinite(error_or_0) ? error_or_0 : 0.0F;
  RETURN_IF_ERROR(reader->CheckCount(point->track_length,
                                     kTrackElementBytes,
                                     absl::StrCat("observations of ", where)));
  for (std::uint64_t i = 0; i < point->track_length; ++i) {
    const auto image_id = reader->Read<std::uint32_t>();
    const auto index = reader->Read<std::uint32_t>();
    tracks->push_back({image_id, index});
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status ParseColmapCamerasBinary(std::string_view bytes,
                                      std::string_view file,
                                      ColmapModel* model) {
  BinaryReader reader(bytes, file);
  ASSIGN_OR_RETURN(
      const std::uint64_t count,
      ReadCount(&reader, bytes, file, kMinBinaryCameraBytes, "cameras"));
  model->cameras.resize(count);
  for (ColmapCamera& camera : model->cameras) {
    RETURN_IF_ERROR(ReadCamera(&reader, &camera));
  }
  return reader.CheckAtEnd();
}

absl::Status ParseColmapImagesBinary(std::string_view bytes,
                                     std::string_view file,
                                     ColmapModel* model) {
  BinaryReader reader(bytes, file);
  ASSIGN_OR_RETURN(
      const std::uint64_t count,
      ReadCount(&reader, bytes, file, kMinBinaryImageBytes, "images"));
  for (std::uint64_t i = 0; i < count; ++i) {
    RETURN_IF_ERROR(ReadImage(&reader, &model->images.emplace_back()));
  }
  return reader.CheckAtEnd();
}

absl::Status ParseColmapPointsBinary(std::string_view bytes,
                                     std::string_view file,
                                     ColmapModel* model) {
  BinaryReader reader(bytes, file);
  ASSIGN_OR_RETURN(
      const std::uint64_t count,
      ReadCount(&reader, bytes, file, kMinBinaryPointBytes, "3D points"));
  model->points.reserve(count);
  for (std::uint64_t i = 0; i < count; ++i) {
    RETURN_IF_ERROR(
        ReadPoint(&reader, &model->points.emplace_back(), &model->tracks));
  }
  return reader.CheckAtEnd();
}

}  // namespace groundlock::formats::internal
