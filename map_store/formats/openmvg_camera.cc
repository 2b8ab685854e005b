// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/openmvg_camera.h"

#include "map_store/base/status.h"
#include "map_store/formats/internal/brown_lens.h"

namespace groundlock::formats::internal {
namespace {

using geometry::CameraModel;
using geometry::CameraModelId;

// The type's own field tells it, too.
std::string TypeFromFields(const JsonNode& data) {
  if (data.Has("disto_k1")) return "pinhole_radial_k1";
  if (data.Has("disto_k3")) return "pinhole_radial_k3";
  if (data.Has("disto_t2")) return "pinhole_brown_t2";
  if (data.Has("fisheye")) return "fisheye";
  return data.Has("focal_length") ? "pinhole" : "spherical";
}

absl::StatusOr<int> SizePx(const JsonNode& data, const char* key) {
  ASSIGN_OR_RETURN(const std::int64_t size, data.Integer(key));
  if (size < 1 || size > CameraModel::kMaxSizePx) {
    return data.Error(absl::StrCat(key, " ", size, " is out of range"));
  }
  return static_cast<int>(size);
}

absl::Status Coefficients(const JsonNode& data,
                          const char* key,
                          std::size_t count,
                          double* target) {
  ASSIGN_OR_RETURN(const JsonNode field, data.Field(key));
  return field.Numbers(count, target);
}

}  // namespace

absl::StatusOr<CameraModel> ReadOpenMvgCamera(
    std::string_view type,
    const JsonNode& data,
    std::vector<std::string>* warnings) {
  const std::string name =
      type.empty() ? TypeFromFields(data) : std::string(type);
  // Pinhole lenses nest their base class in a field of its own ("value0").
  std::optional<JsonNode> nested;
  if (!data.Has("focal_length") && data.Has("value0")) {
    ASSIGN_OR_RETURN(nested, data.Field("value0"));
  }
  const JsonNode& base = nested ? *nested : data;
  if (name != "pinhole" && name != "pinhole_radial_k1" &&
      name != "pinhole_radial_k3" && name != "pinhole_brown_t2" &&
      name != "fisheye") {
    return absl::UnimplementedError(
        absl::StrCat(data.Path(),
                     " camera type \"",
                     name.substr(0, 80),
                     "\" is not supported; known are pinhole, "
                     "pinhole_radial_k1, pinhole_radial_k3, pinhole_brown_t2, "
                     "fisheye"));
  }
  ASSIGN_OR_RETURN(const int width_px, SizePx(base, "width"));
  ASSIGN_OR_RETURN(const int height_px, SizePx(base, "height"));
  BrownLens lens;
  ASSIGN_OR_RETURN(lens.fx_px, base.Number("focal_length"));
  lens.fy_px = lens.fx_px;
  ASSIGN_OR_RETURN(const JsonNode center, base.Field("principal_point"));
  RETURN_IF_ERROR(center.Numbers(2, lens.principal_point_px.data()));
  // OpenMVG's first pixel's centre is (0, 0).
  lens.principal_point_px.array() += 0.5;
  if (name == "fisheye") {
    std::array<double, 4> k{};
    RETURN_IF_ERROR(Coefficients(data, "fisheye", k.size(), k.data()));
    auto camera = CameraModel::Create(CameraModelId::kOpenCvFisheye,
                                      width_px,
                                      height_px,
                                      std::array{lens.fx_px,
                                                 lens.fy_px,
                                                 lens.principal_point_px.x(),
                                                 lens.principal_point_px.y(),
                                                 k[0],
                                                 k[1],
                                                 k[2],
                                                 k[3]});
    return camera.ok() ? camera
                       : data.Error(base::Std(camera.status().message()));
  }
  if (name == "pinhole_radial_k1") {
    RETURN_IF_ERROR(Coefficients(data, "disto_k1", 1, lens.k.data()));
  } else if (name == "pinhole_radial_k3") {
    RETURN_IF_ERROR(Coefficients(data, "disto_k3", 3, lens.k.data()));
  } else if (name == "pinhole_brown_t2") {
    std::array<double, 5> all{};
    RETURN_IF_ERROR(Coefficients(data, "disto_t2", all.size(), all.data()));
    lens.k = {all[0], all[1], all[2]};
    lens.p = {all[3], all[4]};
  }
  return CameraFromBrown(lens, width_px, height_px, data.Path(), warnings);
}

}  // namespace groundlock::formats::internal
