// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/map_info_json.h"

#include <array>
#include <nlohmann/json.hpp>
#include <span>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::storage::internal {
namespace {

using nlohmann::json;

// Larger than any info that we write.
constexpr std::size_t kMaxJsonBytes = 64 << 10;

absl::Status Damaged(std::string_view what) {
  return absl::DataLossError(
      absl::StrCat("map info in the catalogue: ", base::Abseil(what)));
}

// Reads members, and remembers the first that is not as it should be.
class Reader {
 public:
  explicit Reader(const json& object) : object_(object) {}

  void Read(const char* name, bool& out) {
    const json* member = Member(name);
    if (member == nullptr || !member->is_boolean()) return Fail(name);
    out = member->get<bool>();
  }
  void Read(const char* name, std::uint64_t& out) {
    const json* member = Member(name);
    if (member == nullptr || !member->is_number_unsigned()) return Fail(name);
    out = member->get<std::uint64_t>();
  }
  void Read(const char* name, double& out) {
    const json* member = Member(name);
    if (member == nullptr || !member->is_number()) return Fail(name);
    out = member->get<double>();
  }
  void Read(const char* name, std::string& out) {
    const json* member = Member(name);
    if (member == nullptr || !member->is_string()) return Fail(name);
    out = member->get<std::string>();
  }
  void Read(const char* name, std::span<double> out) {
    const json* member = Member(name);
    if (member == nullptr || !member->is_array() ||
        member->size() != out.size()) {
      return Fail(name);
    }
    for (std::size_t i = 0; i < out.size(); ++i) {
      if (!(*member)[i].is_number()) return Fail(name);
      out[i] = (*member)[i].get<double>();
    }
  }
  absl::Status status() const { return status_; }

 private:
  const json* Member(const char* name) const {
    const auto found = object_.find(name);
    return found == object_.end() ? nullptr : &*found;
  }
  void Fail(const char* name) {
    if (!status_.ok()) return;
    status_ =
        Damaged(absl::StrCat("'", name, "' is absent or of a wrong type"));
  }

  const json& object_;
  absl::Status status_;
};

}  // namespace

std::string MapInfoToJson(const map::MapInfo& info) {
  const Eigen::Vector4d rotation = info.world_from_source.rotation.coeffs();
  const Eigen::Vector3d& translation = info.world_from_source.translation;
  const Eigen::Vector3d& normal = info.ground_world.normal;
  json object = {
      {"content_hash", info.content_hash},
      {"source_format", info.source_format},
      {"metric", info.metric},
      {"num_cameras", info.num_cameras},
      {"num_views", info.num_views},
      {"num_landmarks", info.num_landmarks},
      {"num_observations", info.num_observations},
      {"has_descriptors", info.has_descriptors},
      {"file_bytes", info.file_bytes},
      {"mean_reprojection_error_px", info.mean_reprojection_error_px},
      {"scale", info.world_from_source.scale},
      {"rotation_xyzw", {rotation[0], rotation[1], rotation[2], rotation[3]}},
      {"translation", {translation[0], translation[1], translation[2]}},
      {"ground_normal", {normal[0], normal[1], normal[2]}},
      {"ground_d", info.ground_world.d},
  };
  if (info.origin.has_value()) {
    object["origin"] = {info.origin->latitude_deg,
                        info.origin->longitude_deg,
                        info.origin->height_m};
  }
  object["ground_state"] = static_cast<std::uint64_t>(info.ground_state);
  object["ground_sigma_rad"] = info.ground_sigma_rad;
  object["ground_height_sigma"] = info.ground_height_sigma;
  object["ground_relief_m"] = info.ground_relief_m;
  object["ground_relief_given"] = info.ground_relief_given;
  if (info.lens) object["lens"] = geometry::CameraModelToJson(*info.lens);
  return object.dump(-1, ' ', false, json::error_handler_t::replace);
}

absl::StatusOr<map::MapInfo> MapInfoFromJson(std::string_view text) {
  if (text.size() > kMaxJsonBytes) return Damaged("too long");
  const json object = json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!object.is_object()) return Damaged("no JSON object");
  map::MapInfo info;
  Reader reader(object);
  reader.Read("content_hash", info.content_hash);
  reader.Read("source_format", info.source_format);
  reader.Read("metric", info.metric);
  reader.Read("num_cameras", info.num_cameras);
  reader.Read("num_views", info.num_views);
  reader.Read("num_landmarks", info.num_landmarks);
  reader.Read("num_observations", info.num_observations);
  reader.Read("has_descriptors", info.has_descriptors);
  reader.Read("file_bytes", info.file_bytes);
  reader.Read("mean_reprojection_error_px", info.mean_reprojection_error_px);
  reader.Read("scale", info.world_from_source.scale);
  reader.Read("rotation_xyzw",
              std::span(info.world_from_source.rotation.coeffs().data(), 4));
  reader.Read("translation",
              std::span(info.world_from_source.translation.data(), 3));
  reader.Read("ground_normal", std::span(info.ground_world.normal.data(), 3));
  reader.Read("ground_d", info.ground_world.d);
  if (object.contains("origin")) {
    std::array<double, 3> origin{};
    reader.Read("origin", origin);
    info.origin = {origin[0], origin[1], origin[2]};
  }
  // Rows that older programs wrote do not have these.
  info.ground_state =
      info.metric ? map::GroundState::kMeasured : map::GroundState::kEstimated;
  if (object.contains("ground_state")) {
    std::uint64_t state = 0;
    reader.Read("ground_state", state);
    if (state > static_cast<std::uint64_t>(map::GroundState::kMeasured)) {
      return Damaged("'ground_state' is out of range");
    }
    info.ground_state = static_cast<map::GroundState>(state);
    reader.Read("ground_sigma_rad", info.ground_sigma_rad);
  }
  if (object.contains("ground_height_sigma")) {
    reader.Read("ground_height_sigma", info.ground_height_sigma);
  }
  if (object.contains("ground_relief_m")) {
    reader.Read("ground_relief_m", info.ground_relief_m);
  }
  if (object.contains("ground_relief_given")) {
    reader.Read("ground_relief_given", info.ground_relief_given);
  }
  if (object.contains("lens")) {
    std::string lens;
    reader.Read("lens", lens);
    RETURN_IF_ERROR(reader.status());
    auto camera = geometry::CameraModelFromJson(lens);
    if (!camera.ok()) return Damaged(base::Std(camera.status().message()));
    info.lens = *std::move(camera);
  }
  RETURN_IF_ERROR(reader.status());
  return info;
}

}  // namespace groundlock::storage::internal
