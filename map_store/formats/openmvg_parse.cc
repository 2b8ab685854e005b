// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <limits>

#include "absl/container/flat_hash_map.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/binary_reader.h"
#include "map_store/formats/internal/colmap_model.h"
#include "map_store/formats/internal/json_node.h"
#include "map_store/formats/internal/openmvg_camera.h"
#include "map_store/formats/internal/openmvg_model.h"
#include "map_store/formats/internal/text_reader.h"

namespace groundlock::formats::internal {
namespace {

// OpenMVG's first pixel's centre is (0, 0).
constexpr float kPixelCenter = 0.5F;
constexpr double kRotationTolerance = 1e-3;

template <typename Value>
using ById = absl::flat_hash_map<std::int64_t, Value>;

// cereal writes maps as arrays of {"key": K, "value": V}; calls use(id, V) for
// each.
template <typename Use>
absl::Status ForEachEntry(const JsonNode& document,
                          const char* name,
                          const Use& use) {
  ASSIGN_OR_RETURN(const JsonNode list, document.Field(name));
  RETURN_IF_ERROR(list.CheckIsArray());
  for (std::size_t i = 0; i < list.size(); ++i) {
    const JsonNode entry = list.Element(i);
    ASSIGN_OR_RETURN(const std::int64_t id, entry.Integer("key"));
    ASSIGN_OR_RETURN(const JsonNode value, entry.Field("value"));
    RETURN_IF_ERROR(use(id, value));
  }
  return absl::OkStatus();
}

absl::StatusOr<geometry::Rigid3> ReadPose(const JsonNode& pose) {
  ASSIGN_OR_RETURN(const JsonNode rows, pose.Field("rotation"));
  if (!rows.is_array() || rows.size() != 3) {
    return rows.Error("is no 3x3 matrix");
  }
  Eigen::Matrix3d rotation;
  for (int row = 0; row < 3; ++row) {
    Eigen::Vector3d values;
    RETURN_IF_ERROR(
        rows.Element(static_cast<std::size_t>(row)).Numbers(3, values.data()));
    rotation.row(row) = values;
  }
  if (!((rotation * rotation.transpose() - Eigen::Matrix3d::Identity())
            .cwiseAbs()
            .maxCoeff() < kRotationTolerance) ||
      !(rotation.determinant() > 0.0)) {
    return rows.Error("is no rotation");
  }
  ASSIGN_OR_RETURN(const Eigen::Vector3d center, pose.Vector3("center"));
  geometry::Rigid3 camera_from_world;
  camera_from_world.rotation = Eigen::Quaterniond(rotation).normalized();
  camera_from_world.translation = -(camera_from_world.rotation * center);
  return camera_from_world;
}

class OpenMvgParser {
 public:
  explicit OpenMvgParser(const JsonNode& document) : document_(document) {}

  absl::StatusOr<OpenMvgModel> Run() {
    if (document_.Has("root_path")) {
      ASSIGN_OR_RETURN(model_.root_path, document_.String("root_path"));
    }
    RETURN_IF_ERROR(ReadIntrinsics());
    RETURN_IF_ERROR(ReadPoses());
    RETURN_IF_ERROR(ForEachEntry(
        document_, "views", [&](std::int64_t id, const JsonNode& value) {
          return ReadView(id, value);
        }));
    RETURN_IF_ERROR(
        ForEachEntry(document_,
                     "structure",
                     [&](std::int64_t /*id*/, const JsonNode& value) {
                       return ReadPoint(value);
                     }));
    return std::move(model_);
  }

 private:
  absl::Status ReadIntrinsics() {
    // A polymorphic type has its name only where it first occurs; there, the
    // highest bit of its number is set.
    absl::flat_hash_map<std::int64_t, std::string> type_names;
    return ForEachEntry(
        document_,
        "intrinsics",
        [&](std::int64_t id, const JsonNode& value) -> absl::Status {
          std::string type;
          if (value.Has("polymorphic_id")) {
            ASSIGN_OR_RETURN(const std::int64_t number,
                             value.Integer("polymorphic_id"));
            constexpr std::int64_t kNumberBits = 0x7FFF'FFFF;
            if (value.Has("polymorphic_name")) {
              ASSIGN_OR_RETURN(type_names[number & kNumberBits],
                               value.String("polymorphic_name"));
            }
            type = type_names[number & kNumberBits];
          }
          ASSIGN_OR_RETURN(const JsonNode wrapper, value.Field("ptr_wrapper"));
          ASSIGN_OR_RETURN(const JsonNode data, wrapper.Field("data"));
          ASSIGN_OR_RETURN(const geometry::CameraModel camera,
                           ReadOpenMvgCamera(type, data, &model_.warnings));
          camera_by_id_[id] = static_cast<std::uint32_t>(model_.cameras.size());
          model_.cameras.push_back(camera);
          return absl::OkStatus();
        });
  }

  absl::Status ReadPoses() {
    return ForEachEntry(
        document_,
        "extrinsics",
        [&](std::int64_t id, const JsonNode& value) -> absl::Status {
          ASSIGN_OR_RETURN(pose_by_id_[id], ReadPose(value));
          return absl::OkStatus();
        });
  }

  absl::Status ReadView(std::int64_t id, const JsonNode& value) {
    ASSIGN_OR_RETURN(const JsonNode wrapper, value.Field("ptr_wrapper"));
    ASSIGN_OR_RETURN(const JsonNode data, wrapper.Field("data"));
    OpenMvgView view;
    ASSIGN_OR_RETURN(view.image, data.String("filename"));
    if (data.Has("local_path")) {
      ASSIGN_OR_RETURN(std::string folder, data.String("local_path"));
      while (!folder.empty() && folder.front() == '/') folder.erase(0, 1);
      while (!folder.empty() && folder.back() == '/') folder.pop_back();
      if (!folder.empty()) view.image = folder + "/" + view.image;
    }
    if (const absl::Status valid = CheckImageName(view.image); !valid.ok()) {
      return data.Error(base::Std(valid.message()));
    }
    // An undefined id is 2^32 - 1: a view that was not registered.
    ASSIGN_OR_RETURN(const std::int64_t pose, data.Integer("id_pose"));
    ASSIGN_OR_RETURN(const std::int64_t camera, data.Integer("id_intrinsic"));
    const auto found_pose = pose_by_id_.find(pose);
    const auto found_camera = camera_by_id_.find(camera);
    if (found_pose == pose_by_id_.end() ||
        found_camera == camera_by_id_.end()) {
      return absl::OkStatus();
    }
    view.camera_from_world = found_pose->second;
    view.camera = found_camera->second;
    if (!view_by_id_
             .emplace(id, static_cast<std::uint32_t>(model_.views.size()))
             .second) {
      return value.Error(absl::StrCat("view ", id, " is there twice"));
    }
    model_.views.push_back(std::move(view));
    return absl::OkStatus();
  }

  absl::Status ReadPoint(const JsonNode& value) {
    const auto index = static_cast<std::uint32_t>(model_.points.size());
    map::MapLandmarkData& point = model_.points.emplace_back();
    ASSIGN_OR_RETURN(point.p_world, value.Vector3("X"));
    return ForEachEntry(
        value,
        "observations",
        [&](std::int64_t view, const JsonNode& seen) -> absl::Status {
          const auto found = view_by_id_.find(view);
          if (found == view_by_id_.end()) {
            return seen.Error(absl::StrCat(
                "view ", view, " is not in the model or has no pose"));
          }
          OpenMvgObservation observation;
          observation.view = found->second;
          observation.point = index;
          ASSIGN_OR_RETURN(const std::int64_t feature, seen.Integer("id_feat"));
          // An undefined feature is 2^32 - 1, as in control points.
          if (feature < 0 ||
              feature > std::numeric_limits<std::uint32_t>::max()) {
            return seen.Error("id_feat is out of range");
          }
          observation.feature = static_cast<std::uint32_t>(feature);
          ASSIGN_OR_RETURN(const JsonNode x, seen.Field("x"));
          Eigen::Vector2d xy_px;
          RETURN_IF_ERROR(x.Numbers(2, xy_px.data()));
          if (!(xy_px.cwiseAbs().maxCoeff() < 1e9)) {
            return x.Error("is far outside of any image");
          }
          observation.xy_px =
              xy_px.cast<float>() + Eigen::Vector2f::Constant(kPixelCenter);
          model_.observations.push_back(observation);
          return absl::OkStatus();
        });
  }

  const JsonNode& document_;
  OpenMvgModel model_;
  ById<std::uint32_t> camera_by_id_;
  ById<std::uint32_t> view_by_id_;
  ById<geometry::Rigid3> pose_by_id_;
};

}  // namespace

absl::StatusOr<OpenMvgModel> ParseOpenMvg(std::string_view text,
                                          std::string_view file) {
  ASSIGN_OR_RETURN(const nlohmann::json json, ParseJson(text, file));
  const JsonNode document(json, file);
  RETURN_IF_ERROR(document.CheckIsObject());
  if (!document.Has("sfm_data_version") || !document.Has("views")) {
    return document.Error("is not OpenMVG's sfm_data.json");
  }
  if (!document.Has("structure") || !document.Has("extrinsics") ||
      !document.Has("intrinsics")) {
    return document.Error(
        "holds no reconstruction: take the file that the reconstruction wrote, "
        "with intrinsics, extrinsics and structure");
  }
  return OpenMvgParser(document).Run();
}

absl::StatusOr<FeatFile> ParseFeatFile(std::string_view text,
                                       std::string_view file) {
  FeatFile features;
  TextReader reader(text, file);
  std::string_view line;
  while (reader.NextLine(&line)) {
    if (Trim(line).empty()) continue;
    Words words(line);
    Eigen::Vector2f xy;
    float scale = 0.0F;
    if (!words.Next(&xy.x()) || !words.Next(&xy.y()) || !words.Next(&scale)) {
      return reader.Error("a feature is X Y SCALE ANGLE");
    }
    features.xy_px.emplace_back(xy + Eigen::Vector2f::Constant(kPixelCenter));
    features.sizes_px.push_back(2.0F * scale);  // sigma to diameter
  }
  return features;
}

absl::StatusOr<std::span<const std::array<std::uint8_t, 128>>> ParseDescFile(
    std::string_view bytes, std::string_view file) {
  using Raw = std::array<std::uint8_t, 128>;
  BinaryReader reader(bytes, file);
  const auto count = reader.Read<std::uint64_t>();
  RETURN_IF_ERROR(reader.CheckOk("the count"));
  if (count > reader.remaining() / sizeof(Raw) ||
      count * sizeof(Raw) != reader.remaining()) {
    return reader.Error(absl::StrCat(count,
                                     " descriptors of 128 bytes announced, ",
                                     reader.remaining(),
                                     " bytes follow"));
  }
  const std::string_view raw = reader.ReadBytes(count * sizeof(Raw));
  return std::span<const Raw>(reinterpret_cast<const Raw*>(raw.data()), count);
}

map::Descriptor ReorderOpenMvgDescriptor(
    const std::array<std::uint8_t, 128>& descriptor) {
  constexpr std::size_t kCells = 4;
  constexpr std::size_t kAngles = 8;
  map::Descriptor result{};
  for (std::size_t across = 0; across < kCells; ++across) {
    for (std::size_t along = 0; along < kCells; ++along) {
      for (std::size_t angle = 0; angle < kAngles; ++angle) {
        result[(across * kCells + along) * kAngles + angle] =
            descriptor[(along * kCells + across) * kAngles +
                       (kAngles - angle) % kAngles];
      }
    }
  }
  return result;
}

}  // namespace groundlock::formats::internal
