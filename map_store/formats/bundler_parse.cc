// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include "map_store/base/status.h"
#include "map_store/formats/internal/bundler_model.h"
#include "map_store/formats/internal/colmap_model.h"
#include "map_store/formats/internal/text_reader.h"

namespace groundlock::formats::internal {
namespace {

using base::Abseil;

// The shortest that can be: five lines with 15 numbers, and three with seven.
constexpr std::size_t kMinBundlerCameraBytes = 30;
constexpr std::size_t kMinBundlerPointBytes = 14;
// "0 0 0 0 ".
constexpr std::size_t kMinBundlerObservationBytes = 8;
constexpr std::string_view kSignature = "# Bundle file v0.3";
// Rotations are printed with ten digits, and written by other tools with six.
constexpr double kRotationTolerance = 1e-3;

// The file's words, whatever its lines are.
class WordReader {
 public:
  WordReader(TextReader* reader) : reader_(reader), words_({}) {}

  template <typename T>
  bool Next(T* value) {
    while (words_.Rest().empty()) {
      std::string_view line;
      if (!reader_->NextLine(&line)) return false;
      words_ = Words(line);
    }
    return words_.Next(value);
  }
  std::size_t remaining() const {
    return words_.Rest().size() + 1 + reader_->remaining();
  }

 private:
  TextReader* reader_;
  Words words_;
};

absl::Status CheckCount(std::uint64_t count,
                        std::size_t min_item_bytes,
                        std::string_view what,
                        const WordReader& words,
                        const TextReader& reader) {
  if (count <= words.remaining() / min_item_bytes) return absl::OkStatus();
  return reader.Error(absl::StrCat(count,
                                   " ",
                                   Abseil(what),
                                   " announced, but only ",
                                   words.remaining(),
                                   " bytes follow"));
}

absl::Status ReadCamera(std::size_t index,
                        WordReader* words,
                        const TextReader& reader,
                        BundlerCamera* camera) {
  const std::string where = absl::StrCat("camera ", index);
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
  bool ok = words->Next(&camera->focal_px) && words->Next(&camera->k1) &&
            words->Next(&camera->k2);
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      ok = ok && words->Next(&rotation(row, column));
    }
  }
  for (double& value : translation) ok = ok && words->Next(&value);
  if (!ok) {
    return reader.Error(where + ": a number is missing or wrong");
  }
  if (camera->focal_px == 0.0) return absl::OkStatus();  // all are zero then
  if (camera->focal_px < 0.0) {
    return reader.Error(where + ": the focal length is negative");
  }
  if (!((rotation * rotation.transpose() - Eigen::Matrix3d::Identity())
            .cwiseAbs()
            .maxCoeff() < kRotationTolerance) ||
      !(rotation.determinant() > 0.0)) {
    return reader.Error(where + ": its matrix is no rotation");
  }
  // Bundler's camera looks along -z with y up: half a turn about x.
  const Eigen::Quaterniond turn(0.0, 1.0, 0.0, 0.0);
  camera->camera_from_world.rotation =
      (turn * Eigen::Quaterniond(rotation)).normalized();
  camera->camera_from_world.translation = turn * translation;
  return absl::OkStatus();
}

absl::Status ReadPoint(WordReader* words,
                       const TextReader& reader,
                       BundlerModel* model) {
  const auto index = static_cast<std::uint32_t>(model->points.size());
  const std::string where = absl::StrCat("point ", index);
  map::MapLandmarkData point;
  bool ok = true;
  for (double& value : point.p_world) ok = ok && words->Next(&value);
  for (std::uint8_t& c : point.rgb) ok = ok && words->Next(&c);
  std::uint32_t count = 0;
  if (!ok || !words->Next(&count)) {
    return reader.Error(where +
                        ": position, colour or number of views is wrong");
  }
  RETURN_IF_ERROR(
      CheckCount(count, kMinBundlerObservationBytes, "views", *words, reader));
  for (std::uint32_t i = 0; i < count; ++i) {
    BundlerObservation observation;
    observation.point = index;
    if (!words->Next(&observation.camera) || !words->Next(&observation.key) ||
        !words->Next(&observation.xy_px.x()) ||
        !words->Next(&observation.xy_px.y())) {
      return reader.Error(
          absl::StrCat(where, ": view ", i, " is not CAMERA KEY X Y"));
    }
    if (observation.camera >= model->cameras.size()) {
      return reader.Error(absl::StrCat(where,
                                       ": camera ",
                                       observation.camera,
                                       " of ",
                                       model->cameras.size()));
    }
    observation.xy_px.y() = -observation.xy_px.y();
    model->observations.push_back(observation);
  }
  model->points.push_back(point);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<BundlerModel> ParseBundler(std::string_view text,
                                          std::string_view file) {
  TextReader reader(text, file);
  std::string_view line;
  if (!reader.NextLine(&line) || Trim(line) != kSignature) {
    return reader.Error(absl::StrCat("expected \"",
                                     Abseil(kSignature),
                                     "\": other versions are not supported"));
  }
  WordReader words(&reader);
  std::uint32_t num_cameras = 0;
  std::uint32_t num_points = 0;
  if (!words.Next(&num_cameras) || !words.Next(&num_points)) {
    return reader.Error("expected the numbers of cameras and points");
  }
  RETURN_IF_ERROR(CheckCount(
      num_cameras, kMinBundlerCameraBytes, "cameras", words, reader));
  RETURN_IF_ERROR(
      CheckCount(num_points, kMinBundlerPointBytes, "points", words, reader));
  BundlerModel model;
  model.cameras.resize(num_cameras);
  for (std::size_t i = 0; i < model.cameras.size(); ++i) {
    RETURN_IF_ERROR(ReadCamera(i, &words, reader, &model.cameras[i]));
  }
  model.points.reserve(num_points);
  for (std::uint32_t i = 0; i < num_points; ++i) {
    RETURN_IF_ERROR(ReadPoint(&words, reader, &model));
  }
  return model;
}

absl::StatusOr<std::vector<std::string>> ParseBundlerList(
    std::string_view text, std::string_view file) {
  TextReader reader(text, file);
  std::vector<std::string> names;
  std::string_view line;
  while (reader.NextLine(&line)) {
    line = Trim(line);
    if (line.empty()) continue;
    // Names may hold blanks: " 0 F" at the end is what is not the name.
    std::string_view name = line;
    const std::size_t last = line.find_last_of(" \t");
    if (last != std::string_view::npos) {
      const std::string_view before = Trim(line.substr(0, last));
      double focal_px = 0.0;
      Words tail(line.substr(last));
      if (tail.Next(&focal_px) && before.size() > 2 &&
          before.substr(before.size() - 2) == " 0") {
        name = Trim(before.substr(0, before.size() - 2));
      }
    }
    if (const absl::Status valid = CheckImageName(name); !valid.ok()) {
      return reader.Error(base::Std(valid.message()));
    }
    names.emplace_back(name);
  }
  return names;
}

absl::StatusOr<KeyFile> ParseKeyFile(std::string_view text,
                                     std::string_view file) {
  TextReader reader(text, file);
  WordReader words(&reader);
  std::uint32_t count = 0;
  std::uint32_t length = 0;
  if (!words.Next(&count) || !words.Next(&length) || length != 128) {
    return reader.Error("expected the number of keypoints and 128");
  }
  // Four numbers and 128 more, each with a blank.
  RETURN_IF_ERROR(CheckCount(count, 2 * 132, "keypoints", words, reader));
  KeyFile keys;
  keys.xy_px.reserve(count);
  keys.descriptors.reserve(count);
  for (std::uint32_t i = 0; i < count; ++i) {
    Eigen::Vector2f& xy = keys.xy_px.emplace_back();
    std::array<std::uint8_t, 128>& descriptor = keys.descriptors.emplace_back();
    float scale = 0.0F;
    float orientation = 0.0F;
    bool ok = words.Next(&xy.y()) && words.Next(&xy.x()) &&
              words.Next(&scale) && words.Next(&orientation);
    for (std::uint8_t& value : descriptor) ok = ok && words.Next(&value);
    if (!ok) {
      return reader.Error(absl::StrCat(
          "keypoint ", i, " is not ROW COLUMN SCALE ANGLE and 128 bytes"));
    }
  }
  return keys;
}

}  // namespace groundlock::formats::internal
