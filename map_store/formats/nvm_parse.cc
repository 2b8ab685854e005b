// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>

#include "map_store/base/status.h"
#include "map_store/formats/internal/colmap_model.h"
#include "map_store/formats/internal/nvm_model.h"
#include "map_store/formats/internal/text_reader.h"

namespace groundlock::formats::internal {
namespace {

using base::Abseil;

// The shortest lines that can be: "a 1 1 0 0 0 0 0 0 0 0\n" and
// "0 0 0 0 0 0 0\n".
constexpr std::size_t kMinNvmCameraBytes = 22;
constexpr std::size_t kMinNvmPointBytes = 13;
constexpr int kNumbersOfCamera = 10;  // f q c r 0

// Splits "name f qw qx qy qz cx cy cz r 0" before its ten last words: names may
// hold blanks (VisualSFM ends them with a tab and writes a blank as '"').
bool SplitCameraLine(std::string_view line,
                     std::string_view* name,
                     std::string_view* numbers) {
  line = Trim(line);
  std::size_t begin = line.size();
  for (int i = 0; i < kNumbersOfCamera; ++i) {
    while (begin > 0 && IsBlank(line[begin - 1])) --begin;
    while (begin > 0 && !IsBlank(line[begin - 1])) --begin;
  }
  *name = Trim(line.substr(0, begin));
  *numbers = line.substr(begin);
  return !name->empty();
}

std::string DecodeName(std::string_view name) {
  if (name.size() > 2 && name.front() == '"' && name.back() == '"') {
    return std::string(name.substr(1, name.size() - 2));
  }
  std::string decoded(name);
  std::replace(decoded.begin(), decoded.end(), '"', ' ');
  return decoded;
}

absl::Status ReadCamera(std::string_view line,
                        const TextReader& reader,
                        NvmCamera* camera) {
  std::string_view name;
  std::string_view numbers;
  if (!SplitCameraLine(line, &name, &numbers)) {
    return reader.Error("a camera is a name and ten numbers");
  }
  camera->name = DecodeName(name);
  if (const absl::Status valid = CheckImageName(camera->name); !valid.ok()) {
    return reader.Error(absl::StrCat("camera: ", valid.message()));
  }
  const std::string where = absl::StrCat("camera ", camera->name);
  Words words(numbers);
  std::array<double, 4> q{};
  Eigen::Vector3d center;
  bool ok = words.Next(&camera->focal_px);
  for (double& value : q) ok = ok && words.Next(&value);
  for (double& value : center) ok = ok && words.Next(&value);
  if (!ok || !words.Next(&camera->r)) {
    return reader.Error(where + ": a number is missing or wrong");
  }
  if (!(camera->focal_px > 0.0)) {
    return reader.Error(where + ": the focal length is not positive");
  }
  auto camera_from_world = RigidFromFile(q, {0.0, 0.0, 0.0});
  if (!camera_from_world.ok()) {
    return reader.Error(
        absl::StrCat(where, ": ", camera_from_world.status().message()));
  }
  camera->camera_from_world = *camera_from_world;
  // The file gives the camera's centre, not the translation.
  camera->camera_from_world.translation =
      -(camera_from_world->rotation * center);
  return absl::OkStatus();
}

absl::Status ReadPoint(std::string_view line,
                       const TextReader& reader,
                       NvmModel* model) {
  Words words(line);
  map::MapLandmarkData point;
  for (double& value : point.p_world) {
    if (!words.Next(&value)) return reader.Error("point: bad position");
  }
  for (std::uint8_t& c : point.rgb) {
    if (!words.Next(&c)) return reader.Error("point: bad colour");
  }
  std::uint32_t count = 0;
  if (!words.Next(&count)) return reader.Error("point: no measurement count");
  // A measurement takes at least "0 0 0 0 ".
  if (count > (words.Rest().size() + 1) / 8 + 1) {
    return reader.Error(absl::StrCat(
        "point: ", count, " measurements announced, the line is too short"));
  }
  const auto index = static_cast<std::uint32_t>(model->points.size());
  for (std::uint32_t i = 0; i < count; ++i) {
    NvmMeasurement measurement;
    measurement.point = index;
    if (!words.Next(&measurement.camera) || !words.Next(&measurement.feature) ||
        !words.Next(&measurement.xy_px.x()) ||
        !words.Next(&measurement.xy_px.y())) {
      return reader.Error(
          absl::StrCat("point: measurement ", i, " is not IMAGE FEATURE X Y"));
    }
    if (measurement.camera >= model->cameras.size()) {
      return reader.Error(absl::StrCat(
          "point: image ", measurement.camera, " of ", model->cameras.size()));
    }
    model->measurements.push_back(measurement);
  }
  model->points.push_back(point);
  return absl::OkStatus();
}

absl::StatusOr<std::size_t> ReadCount(std::string_view line,
                                      const TextReader& reader,
                                      std::size_t min_item_bytes,
                                      std::string_view what) {
  Words words(line);
  std::uint32_t count = 0;
  if (!words.Next(&count) || !words.Rest().empty()) {
    return reader.Error(absl::StrCat("expected the number of ", Abseil(what)));
  }
  // The last line may lack its end.
  if (count > (reader.remaining() + 1) / min_item_bytes) {
    return reader.Error(absl::StrCat(count,
                                     " ",
                                     Abseil(what),
                                     " announced, but only ",
                                     reader.remaining(),
                                     " bytes follow"));
  }
  return count;
}

// `line` holds the number of cameras.
absl::Status ReadModel(std::string_view line,
                       TextReader* reader,
                       NvmModel* model) {
  ASSIGN_OR_RETURN(const std::size_t num_cameras,
                   ReadCount(line, *reader, kMinNvmCameraBytes, "cameras"));
  for (std::size_t i = 0; i < num_cameras; ++i) {
    if (!reader->NextRecord(&line)) {
      return reader->Error("the file ends inside its cameras");
    }
    RETURN_IF_ERROR(ReadCamera(line, *reader, &model->cameras.emplace_back()));
  }
  if (num_cameras == 0) return absl::OkStatus();
  if (!reader->NextRecord(&line)) {
    return reader->Error("the file ends before its points");
  }
  ASSIGN_OR_RETURN(const std::size_t num_points,
                   ReadCount(line, *reader, kMinNvmPointBytes, "points"));
  for (std::size_t i = 0; i < num_points; ++i) {
    if (!reader->NextRecord(&line)) {
      return reader->Error("the file ends inside its points");
    }
    RETURN_IF_ERROR(ReadPoint(line, *reader, model));
  }
  return absl::OkStatus();
}

// "NVM_V3 [FixedK fx cx fy cy [r]]".
absl::Status ReadHeader(std::string_view line,
                        const TextReader& reader,
                        NvmFile* file) {
  Words words(line);
  const std::string_view version = words.Next();
  if (version != "NVM_V3") {
    return reader.Error(
        version.substr(0, 3) == "NVM"
            ? "only NVM_V3 can be read"
            : "not VisualSFM's NVM format: the first word is not NVM_V3");
  }
  if (words.Next() != "FixedK") return absl::OkStatus();
  NvmCalibration k;
  if (!words.Next(&k.fx_px) || !words.Next(&k.cx_px) || !words.Next(&k.fy_px) ||
      !words.Next(&k.cy_px)) {
    return reader.Error("FixedK needs fx cx fy cy");
  }
  if (!(k.fx_px > 0.0 && k.fy_px > 0.0)) {
    return reader.Error("FixedK: the focal lengths are not positive");
  }
  file->calibration = k;
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<NvmFile> ParseNvm(std::string_view text, std::string_view file) {
  TextReader reader(text, file);
  NvmFile result;
  std::string_view line;
  if (!reader.NextRecord(&line)) return reader.Error("the file is empty");
  RETURN_IF_ERROR(ReadHeader(line, reader, &result));
  // After the models comes an empty one, then the .ply files' numbers.
  while (reader.NextRecord(&line)) {
    NvmModel model;
    RETURN_IF_ERROR(ReadModel(line, &reader, &model));
    if (model.cameras.empty()) break;
    if (model.points.empty()) continue;  // the images that found no place
    ++result.num_models;
    if (model.points.size() > result.model.points.size()) {
      result.model = std::move(model);
    }
  }
  if (result.num_models == 0) return reader.Error("no model with points");
  return result;
}

}  // namespace groundlock::formats::internal
