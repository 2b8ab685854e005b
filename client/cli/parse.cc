// SPDX-License-Identifier: Apache-2.0
#include "client/cli/parse.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

using base::Abseil;

// A camera.json or align.json takes some hundred bytes.
constexpr std::uint64_t kMaxJsonBytes = 1 << 20;

absl::Status Expected(std::string_view text, std::string_view expected) {
  return absl::InvalidArgumentError(
      absl::StrCat("\"", Abseil(text), "\": expected ", Abseil(expected)));
}

bool IsId(std::string_view id) {
  if (id.empty() || id.size() > 64) return false;
  for (const char c : id) {
    const bool allowed = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                         (c >= '0' && c <= '9') || c == '.' || c == '_' ||
                         c == '-';
    if (!allowed) return false;
  }
  return true;
}

// The numbers of an array field; `count` of them.
absl::StatusOr<std::vector<double>> NumbersField(const nlohmann::json& object,
                                                 const char* field,
                                                 size_t count) {
  const auto it = object.find(field);
  if (it == object.end()) {
    return absl::InvalidArgumentError(
        absl::StrCat("field \"", field, "\" is missing"));
  }
  const auto wrong = [&] {
    return absl::InvalidArgumentError(absl::StrCat(
        "field \"", field, "\" must be an array of ", count, " numbers"));
  };
  if (!it->is_array() || it->size() != count) return wrong();
  std::vector<double> numbers;
  for (const nlohmann::json& element : *it) {
    if (!element.is_number()) return wrong();
    numbers.push_back(element.get<double>());
    if (!std::isfinite(numbers.back())) return wrong();
  }
  return numbers;
}

}  // namespace

std::optional<double> ParseFinite(absl::string_view text) {
  double value = 0.0;
  if (!absl::SimpleAtod(text, &value) || !std::isfinite(value)) {
    return std::nullopt;
  }
  return value;
}

absl::StatusOr<geometry::Box2> ParseBox(std::string_view text) {
  constexpr std::string_view kForm =
      "X,Y,W,H in pixels with W and H above 0, say 373,323,170,84";
  const std::vector<absl::string_view> parts =
      absl::StrSplit(Abseil(text), ',');
  if (parts.size() != 4) return Expected(text, kForm);
  double values[4];
  for (size_t i = 0; i < 4; ++i) {
    const std::optional<double> value = ParseFinite(parts[i]);
    if (!value) return Expected(text, kForm);
    values[i] = *value;
  }
  if (values[2] <= 0.0 || values[3] <= 0.0) return Expected(text, kForm);
  return geometry::Box2::FromXywh(values[0], values[1], values[2], values[3]);
}

absl::StatusOr<TargetSpec> ParseTarget(std::string_view text) {
  constexpr std::string_view kForm = "ID:X,Y,W,H or ID:X,Y,W,H@FRAME";
  const size_t colon = text.find(':');
  if (colon == std::string_view::npos) return Expected(text, kForm);
  TargetSpec target;
  target.id = text.substr(0, colon);
  if (!IsId(target.id)) {
    return Expected(text, "an ID of 1 to 64 of [A-Za-z0-9._-] before the ':'");
  }
  std::string_view box = text.substr(colon + 1);
  if (const size_t at = box.find('@'); at != std::string_view::npos) {
    std::uint64_t frame = 0;
    if (!absl::SimpleAtoi(Abseil(box.substr(at + 1)), &frame)) {
      return Expected(text, kForm);
    }
    target.frame = frame;
    box = box.substr(0, at);
  }
  auto parsed = ParseBox(box);
  if (!parsed.ok()) return base::Annotate(parsed.status(), text);
  target.box_px = *parsed;
  return target;
}

absl::StatusOr<BodySpec> ParseBody(std::string_view text,
                                   const std::vector<std::string>& kinds) {
  const std::string form = absl::StrCat(
      "[ID:]KIND, [ID:]LxWxH or [ID:]KIND,LxWxH, where KIND is ",
      absl::StrJoin(kinds, ", "),
      " and L, W and H are lengths > 0, say car or car,4.4x1.8x1.5");
  BodySpec spec;
  std::string_view rest = text;
  if (const size_t colon = rest.find(':'); colon != std::string_view::npos) {
    spec.id = rest.substr(0, colon);
    if (!IsId(spec.id)) return Expected(text, form);
    rest = rest.substr(colon + 1);
  }
  const std::vector<absl::string_view> parts =
      absl::StrSplit(Abseil(rest), ',');
  if (parts.size() > 2) return Expected(text, form);
  for (const absl::string_view part : parts) {
    if (std::find(kinds.begin(), kinds.end(), part) != kinds.end()) {
      if (!spec.body.kind.empty()) return Expected(text, form);
      spec.body.kind = std::string(part);
      continue;
    }
    const std::vector<absl::string_view> extents = absl::StrSplit(part, 'x');
    if (extents.size() != 3 || spec.body.size_m) return Expected(text, form);
    spec.body.size_m.emplace();
    for (int k = 0; k < 3; ++k) {
      const auto extent = ParseFinite(extents[static_cast<size_t>(k)]);
      if (!extent || !(*extent > 0.0)) return Expected(text, form);
      (*spec.body.size_m)[k] = *extent;
    }
  }
  return spec;
}

absl::StatusOr<media::FrameRange> ParseFrameRange(std::string_view text) {
  constexpr std::string_view kForm =
      "FROM:TO, FROM: or :TO with FROM below TO (TO itself is left out)";
  const size_t colon = text.find(':');
  if (colon == std::string_view::npos) return Expected(text, kForm);
  media::FrameRange range;
  const std::string_view from = text.substr(0, colon);
  const std::string_view to = text.substr(colon + 1);
  if (!from.empty() && !absl::SimpleAtoi(Abseil(from), &range.begin)) {
    return Expected(text, kForm);
  }
  if (!to.empty() && !absl::SimpleAtoi(Abseil(to), &range.end)) {
    return Expected(text, kForm);
  }
  if (range.begin >= range.end) return Expected(text, kForm);
  return range;
}

absl::StatusOr<SizePx> ParseSize(std::string_view text) {
  constexpr std::string_view kForm = "WIDTHxHEIGHT in pixels, say 1280x720";
  const std::vector<absl::string_view> parts =
      absl::StrSplit(Abseil(text), 'x');
  SizePx size;
  if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &size.width) ||
      !absl::SimpleAtoi(parts[1], &size.height)) {
    return Expected(text, kForm);
  }
  constexpr int kMax = geometry::CameraModel::kMaxSizePx;
  if (size.width < 1 || size.height < 1 || size.width > kMax ||
      size.height > kMax) {
    return Expected(text, kForm);
  }
  return size;
}

absl::StatusOr<geometry::Similarity3> SimilarityFromJson(
    std::string_view json) {
  const nlohmann::json object =
      nlohmann::json::parse(json, nullptr, /*allow_exceptions=*/false);
  if (!object.is_object()) {
    return absl::InvalidArgumentError("not a JSON object");
  }
  const auto scale = object.find("scale");
  if (scale == object.end()) {
    return absl::InvalidArgumentError("field \"scale\" is missing");
  }
  geometry::Similarity3 similarity;
  if (scale->is_number()) similarity.scale = scale->get<double>();
  if (!scale->is_number() || !std::isfinite(similarity.scale) ||
      similarity.scale <= 0.0) {
    return absl::InvalidArgumentError(
        "field \"scale\" must be a number above 0");
  }
  ASSIGN_OR_RETURN(const std::vector<double> q,
                   NumbersField(object, "rotation_wxyz", 4));
  similarity.rotation = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  const double norm = similarity.rotation.norm();
  if (!(std::abs(norm - 1.0) <= 1e-3)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "field \"rotation_wxyz\" must be a unit quaternion; its length is ",
        norm));
  }
  similarity.rotation.normalize();
  ASSIGN_OR_RETURN(const std::vector<double> t,
                   NumbersField(object, "translation", 3));
  similarity.translation = Eigen::Vector3d(t[0], t[1], t[2]);
  return similarity;
}

absl::StatusOr<geometry::Similarity3> ReadAlignment(
    const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string json, base::ReadFile(path, kMaxJsonBytes));
  auto similarity = SimilarityFromJson(json);
  if (!similarity.ok()) {
    return base::Annotate(similarity.status(), path.string());
  }
  return similarity;
}

absl::StatusOr<geometry::CameraModel> ReadCamera(
    const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string json, base::ReadFile(path, kMaxJsonBytes));
  auto camera = geometry::CameraModelFromJson(json);
  if (!camera.ok()) return base::Annotate(camera.status(), path.string());
  return camera;
}

}  // namespace groundlock::cli
