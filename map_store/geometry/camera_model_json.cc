// SPDX-License-Identifier: Apache-2.0
#include <cstdint>
#include <nlohmann/json.hpp>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::geometry {
namespace {

using nlohmann::json;

// A camera.json holds some hundred bytes.
constexpr std::size_t kMaxJsonBytes = 64 * 1024;

absl::Status FieldError(std::string_view field, std::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat(
      "camera field '", base::Abseil(field), "' ", base::Abseil(what)));
}

absl::StatusOr<int> SizeField(const json& object, const char* field) {
  const auto found = object.find(field);
  if (found == object.end()) return FieldError(field, "is missing");
  if (!found->is_number_integer()) {
    return FieldError(field, "must be an integer");
  }
  // A large unsigned number would wrap around in get<int64_t>.
  const bool too_large =
      found->is_number_unsigned() &&
      found->get<std::uint64_t>() > std::uint64_t{CameraModel::kMaxSizePx};
  const std::int64_t value = too_large ? -1 : found->get<std::int64_t>();
  if (value < 1 || value > CameraModel::kMaxSizePx) {
    return FieldError(
        field,
        "must lie between 1 and " + std::to_string(CameraModel::kMaxSizePx));
  }
  return static_cast<int>(value);
}

}  // namespace

absl::StatusOr<CameraModel> CameraModelFromJson(std::string_view text) {
  if (text.size() > kMaxJsonBytes) {
    return absl::InvalidArgumentError(absl::StrCat(
        "camera: ", text.size(), " bytes are too many for a camera.json"));
  }
  const json object = json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (object.is_discarded()) {
    return absl::InvalidArgumentError("camera: not valid JSON");
  }
  if (!object.is_object()) {
    return absl::InvalidArgumentError("camera: must be a JSON object");
  }
  ASSIGN_OR_RETURN(const int width_px, SizeField(object, "width"));
  ASSIGN_OR_RETURN(const int height_px, SizeField(object, "height"));
  const auto model = object.find("model");
  if (model == object.end()) return FieldError("model", "is missing");
  if (!model->is_string()) return FieldError("model", "must be a string");
  const auto id = CameraModelIdFromName(model->get_ref<const std::string&>());
  if (!id.ok()) return base::Annotate(id.status(), "camera field 'model'");
  const auto params = object.find("params");
  if (params == object.end()) return FieldError("params", "is missing");
  if (!params->is_array()) {
    return FieldError("params", "must be an array of numbers");
  }
  std::vector<double> values;
  for (const json& value : *params) {
    if (!value.is_number()) {
      return FieldError("params", "must be an array of numbers");
    }
    values.push_back(value.get<double>());
  }
  auto camera = CameraModel::Create(*id, width_px, height_px, values);
  if (!camera.ok()) {
    return base::Annotate(camera.status(), "camera field 'params'");
  }
  return camera;
}

std::string CameraModelToJson(const CameraModel& camera) {
  nlohmann::ordered_json object;
  object["width"] = camera.width_px();
  object["height"] = camera.height_px();
  object["model"] = std::string(CameraModelName(camera.id()));
  object["params"] =
      std::vector<double>(camera.params().begin(), camera.params().end());
  return object.dump();
}

}  // namespace groundlock::geometry
