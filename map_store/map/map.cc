// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/map.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/map/internal/file_layout.h"
#include "map_store/map/internal/mapped_file.h"

namespace groundlock::map {
namespace {

using internal::Damaged;
using internal::FileHeader;
using internal::IsRange;
using internal::Mapping;
using internal::SectionId;

// Layout bytes to numbers: text that was read from the file is only ever a
// view into it.
Eigen::Quaterniond Quaternion(const std::array<double, 4>& xyzw) {
  return Eigen::Quaterniond(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
}

Eigen::Vector3d Vector(const std::array<double, 3>& v) {
  return Eigen::Vector3d(v.data());
}

bool IsUnit(double norm) { return std::abs(norm - 1.0) < 1e-9; }

const internal::SectionRecord& Section(const FileHeader& header, SectionId id) {
  return header.sections.at(static_cast<std::uint32_t>(id) - 1);
}

template <typename T>
std::span<const T> SpanOf(const Mapping& mapping,
                          const FileHeader& header,
                          SectionId id) {
  const internal::SectionRecord& section = Section(header, id);
  return {reinterpret_cast<const T*>(mapping.data + section.offset),
          section.count};
}

// A record of an older version ends before the fields that it does not have.
internal::MetaRecord MetaOf(const Mapping& mapping, const FileHeader& header) {
  const internal::SectionRecord& section = Section(header, SectionId::kMeta);
  internal::MetaRecord meta;
  std::memcpy(&meta,
              mapping.data + section.offset,
              std::min<std::size_t>(section.element_bytes, sizeof(meta)));
  return meta;
}

absl::Status ReadMeta(const internal::MetaRecord& meta,
                      std::uint32_t format_version,
                      std::string_view strings,
                      MapInfo& info) {
  info.world_from_source = {
      meta.scale, Quaternion(meta.rotation_xyzw), Vector(meta.translation)};
  info.ground_world = {Vector(meta.ground_normal), meta.ground_d};
  if (!info.world_from_source.IsFinite() || !(meta.scale > 0.0) ||
      !IsUnit(info.world_from_source.rotation.norm()) ||
      !IsUnit(info.ground_world.normal.norm()) ||
      !std::isfinite(meta.ground_d) || meta.metric > 1 ||
      !std::isfinite(meta.mean_reprojection_error_px) ||
      meta.source_format_bytes > internal::kMaxSourceFormatBytes ||
      !IsRange(meta.source_format_offset,
               meta.source_format_bytes,
               strings.size())) {
    return Damaged("section 'meta' holds values out of range");
  }
  info.metric = meta.metric == 1;
  if (format_version < 3) {
    info.ground_state =
        info.metric ? GroundState::kMeasured : GroundState::kEstimated;
  } else {
    if (meta.ground_state >
            static_cast<std::uint64_t>(GroundState::kMeasured) ||
        !(meta.ground_sigma_rad >= 0.0 &&
          std::isfinite(meta.ground_sigma_rad)) ||
        !(meta.ground_height_sigma >= 0.0 &&
          std::isfinite(meta.ground_height_sigma))) {
      return Damaged("section 'meta' holds a ground out of range");
    }
    info.ground_state = static_cast<GroundState>(meta.ground_state);
    info.ground_sigma_rad = meta.ground_sigma_rad;
    info.ground_height_sigma = meta.ground_height_sigma;
  }
  if (meta.has_origin != 0) {
    info.origin = {meta.origin_latitude_deg,
                   meta.origin_longitude_deg,
                   meta.origin_height_m};
    if (meta.has_origin != 1 || !info.metric || !info.origin->Validate().ok()) {
      return Damaged("section 'meta' holds an origin out of range");
    }
  }
  info.mean_reprojection_error_px = meta.mean_reprojection_error_px;
  info.source_format =
      strings.substr(meta.source_format_offset, meta.source_format_bytes);
  return absl::OkStatus();
}

absl::StatusOr<geometry::CameraModel> ReadCamera(
    const internal::CameraRecord& record) {
  constexpr std::uint32_t kMaxSize = geometry::CameraModel::kMaxSizePx;
  if (record.model >
          static_cast<std::uint32_t>(geometry::CameraModelId::kOpenCvFisheye) ||
      record.width_px > kMaxSize || record.height_px > kMaxSize) {
    return Damaged("model or size out of range");
  }
  const auto id = static_cast<geometry::CameraModelId>(record.model);
  auto camera = geometry::CameraModel::Create(
      id,
      static_cast<int>(record.width_px),
      static_cast<int>(record.height_px),
      std::span(record.params)
          .first(static_cast<std::size_t>(geometry::NumCameraModelParams(id))));
  if (!camera.ok()) return Damaged(base::Std(camera.status().message()));
  return camera;
}

absl::StatusOr<GroundRelief> ReadRelief(
    const internal::MetaRecord& meta,
    std::span<const GroundRelief::Knot> knots) {
  GroundRelief relief;
  if (knots.empty()) return relief;
  if (knots.size() > GroundRelief::kMaxKnots) {
    return Damaged("section 'ground relief' is too long");
  }
  relief.origin_plane = {meta.relief_origin[0], meta.relief_origin[1]};
  relief.step = meta.relief_step;
  relief.columns = meta.relief_columns;
  relief.knots.assign(knots.begin(), knots.end());
  if (const absl::Status valid = relief.Validate(); !valid.ok()) {
    return Damaged("section 'ground relief' holds values out of range");
  }
  return relief;
}

struct Limits {
  std::string_view strings;
  std::size_t num_cameras = 0;
  std::size_t num_features = 0;
};

absl::StatusOr<MapView> ReadView(const internal::ViewRecord& record,
                                 const Limits& limits) {
  MapView view;
  view.camera_from_world = {Quaternion(record.rotation_xyzw),
                            Vector(record.translation)};
  if (!view.camera_from_world.IsFinite() ||
      !IsUnit(view.camera_from_world.rotation.norm())) {
    return Damaged("pose is not rigid");
  }
  if (record.camera >= limits.num_cameras) return Damaged("no such camera");
  if (!IsRange(record.name_offset, record.name_bytes, limits.strings.size())) {
    return Damaged("name lies outside section 'strings'");
  }
  if (!IsRange(
          record.first_feature, record.num_features, limits.num_features)) {
    return Damaged("features lie outside section 'features'");
  }
  view.name = limits.strings.substr(record.name_offset, record.name_bytes);
  view.camera = record.camera;
  view.center_world = view.camera_from_world.Inverse().translation;
  view.first_feature = record.first_feature;
  view.num_features = record.num_features;
  return view;
}

// Some formats repeat the lens for each view.
std::optional<geometry::CameraModel> CommonLens(
    const std::vector<geometry::CameraModel>& cameras,
    const std::vector<MapView>& views) {
  if (views.empty()) return std::nullopt;
  const geometry::CameraModel& first = cameras[views.front().camera];
  for (const MapView& view : views) {
    if (cameras[view.camera] != first) return std::nullopt;
  }
  return first;
}

}  // namespace

absl::StatusOr<std::shared_ptr<const Map>> Map::Open(
    const std::filesystem::path& path) {
  auto mapping = internal::MapFile(path);
  if (!mapping.ok()) return base::Annotate(mapping.status(), path.string());
  std::shared_ptr<Map> map(new Map());  // unmaps on any error below
  map->mapping_ = mapping->data;
  map->mapping_bytes_ = mapping->bytes;
  RETURN_IF_ERROR(base::Annotate(map->Read(), path.string()));
  return map;
}

absl::Status Map::Read() {
  const Mapping mapping{mapping_, mapping_bytes_};
  ASSIGN_OR_RETURN(const FileHeader header, internal::ReadHeader(mapping));
  const auto strings = SpanOf<char>(mapping, header, SectionId::kStrings);
  const auto cameras =
      SpanOf<internal::CameraRecord>(mapping, header, SectionId::kCameras);
  const auto views =
      SpanOf<internal::ViewRecord>(mapping, header, SectionId::kViews);
  landmarks_ = SpanOf<Landmark>(mapping, header, SectionId::kLandmarks);
  features_ = SpanOf<Feature>(mapping, header, SectionId::kFeatures);
  observations_ =
      SpanOf<std::uint64_t>(mapping, header, SectionId::kObservations);
  descriptors_ = SpanOf<Descriptor>(mapping, header, SectionId::kDescriptors);
  if (Section(header, SectionId::kMeta).count != 1) {
    return Damaged("section 'meta' must hold one record");
  }
  if (observations_.size() != features_.size() ||
      (!descriptors_.empty() && descriptors_.size() != features_.size())) {
    return Damaged(
        "sections 'features', 'observations' and 'descriptors' differ in size");
  }

  landmark_index_.inner_words =
      SpanOf<Descriptor>(mapping, header, SectionId::kIndexInnerWords);
  landmark_index_.leaf_words =
      SpanOf<Descriptor>(mapping, header, SectionId::kIndexLeafWords);
  landmark_index_.list_begin =
      SpanOf<std::uint64_t>(mapping, header, SectionId::kIndexListBegin);
  landmark_index_.entry_landmarks =
      SpanOf<std::uint32_t>(mapping, header, SectionId::kIndexLandmarks);
  landmark_index_.entry_descriptors =
      SpanOf<Descriptor>(mapping, header, SectionId::kIndexDescriptors);
  landmark_index_.num_landmarks = landmarks_.size();
  landmark_index_.branching =
      static_cast<std::uint32_t>(landmark_index_.inner_words.size());
  if (!HasConsistentSizes(landmark_index_)) {
    return Damaged("the sections of the landmark index differ in size");
  }

  const Limits limits{
      {strings.data(), strings.size()}, cameras.size(), features_.size()};
  const internal::MetaRecord meta = MetaOf(mapping, header);
  RETURN_IF_ERROR(ReadMeta(meta, header.format_version, limits.strings, info_));
  if (header.format_version >= 4) {
    ASSIGN_OR_RETURN(
        ground_relief_,
        ReadRelief(meta,
                   SpanOf<GroundRelief::Knot>(
                       mapping, header, SectionId::kGroundRelief)));
    info_.ground_relief_m = ground_relief_.Range();
    info_.ground_relief_given = meta.relief_is_given != 0;
  }
  cameras_.reserve(cameras.size());
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    auto camera = ReadCamera(cameras[i]);
    if (!camera.ok()) {
      return base::Annotate(camera.status(), "camera " + std::to_string(i));
    }
    cameras_.push_back(*camera);
  }
  views_.reserve(views.size());
  std::uint64_t next_feature = 0;
  for (std::size_t i = 0; i < views.size(); ++i) {
    auto view = ReadView(views[i], limits);
    if (!view.ok()) {
      return base::Annotate(view.status(), "view " + std::to_string(i));
    }
    // One after the other without gap: no feature belongs to two views.
    if (view->first_feature != next_feature) {
      return Damaged("view " + std::to_string(i) +
                     ": features do not follow those of the view before");
    }
    next_feature += view->num_features;
    views_.push_back(*view);
  }
  BeginIntegrity();
  info_.content_hash = internal::HexOf(header.content_hash);
  info_.num_cameras = cameras_.size();
  info_.lens = CommonLens(cameras_, views_);
  info_.num_views = views_.size();
  info_.num_landmarks = landmarks_.size();
  info_.num_observations = features_.size();
  info_.has_descriptors = !descriptors_.empty();
  info_.file_bytes = mapping_bytes_;
  return absl::OkStatus();
}

const geometry::CameraModel& Map::camera(std::uint32_t index) const {
  return cameras_[index];
}

MapData Map::ToData() const {
  MapData data;
  data.source_format = info_.source_format;
  data.cameras = cameras_;
  data.world_from_source = info_.world_from_source;
  data.metric = info_.metric;
  data.origin = info_.origin;
  data.ground = info_.ground_world;
  data.ground_state = info_.ground_state;
  data.ground_sigma_rad = info_.ground_sigma_rad;
  data.ground_height_sigma = info_.ground_height_sigma;
  if (info_.ground_relief_given) data.given_relief = ground_relief_;
  data.in_world = true;
  data.views.reserve(views_.size());
  for (const MapView& view : views_) {
    MapViewData& target = data.views.emplace_back();
    target.name = view.name;
    target.camera = view.camera;
    target.camera_from_world = view.camera_from_world;
    for (const Feature& feature : FeaturesOf(view)) {
      target.keypoints_px.emplace_back(feature.x_px, feature.y_px);
      target.landmarks.push_back(feature.landmark);
    }
    const std::span<const Descriptor> descriptors = DescriptorsOf(view);
    target.descriptors.assign(descriptors.begin(), descriptors.end());
  }
  data.landmarks.reserve(landmarks_.size());
  for (const Landmark& landmark : landmarks_) {
    data.landmarks.push_back(
        {landmark.Position(),
         {landmark.rgb[0], landmark.rgb[1], landmark.rgb[2]},
         landmark.error_px});
  }
  return data;
}

}  // namespace groundlock::map
