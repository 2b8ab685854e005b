// SPDX-License-Identifier: Apache-2.0
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/map/ground_relief.h"
#include "map_store/map/internal/file_layout.h"
#include "map_store/map/landmark_index.h"
#include "map_store/map/map.h"

namespace groundlock::map {
namespace {

using internal::FileHeader;
using internal::kPageBytes;
using internal::SectionId;

constexpr std::uint32_t kDropped = std::numeric_limits<std::uint32_t>::max();

template <typename T>
std::string_view BytesOf(const T* data, std::size_t count) {
  return {reinterpret_cast<const char*>(data), count * sizeof(T)};
}

// Writes sections one after the other, each on a page of its own, hashing as
// it goes; the header comes last, so that a file without one is no map.
class SectionWriter {
 public:
  explicit SectionWriter(base::AtomicFile* file) : file_(file) {}

  absl::Status Begin() { return Pad(kPageBytes); }

  // A section of `count` elements whose bytes come in pieces.
  template <typename Pieces>
  absl::Status WriteSection(SectionId id,
                            std::uint64_t count,
                            const Pieces& pieces) {
    internal::SectionRecord& section = header_.sections.at(next_section_++);
    section.id = id;
    section.element_bytes =
        internal::SectionElementBytes(id, internal::kFormatVersion);
    section.offset = position_;
    section.count = count;
    const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(
        XXH3_createState(), &XXH3_freeState);
    if (state == nullptr) return absl::ResourceExhaustedError("no memory");
    XXH3_128bits_reset(state.get());
    for (const std::string_view piece : pieces) {
      XXH3_128bits_update(state.get(), piece.data(), piece.size());
      RETURN_IF_ERROR(file_->Write(piece));
      position_ += piece.size();
    }
    const XXH128_hash_t hash = XXH3_128bits_digest(state.get());
    section.checksum = {hash.low64, hash.high64};
    const std::uint64_t used = position_ % kPageBytes;
    return used == 0 ? absl::OkStatus() : Pad(kPageBytes - used);
  }

  template <typename T>
  absl::Status WriteArray(SectionId id, const T* data, std::size_t count) {
    const std::array<std::string_view, 1> pieces = {BytesOf(data, count)};
    return WriteSection(id, count, pieces);
  }

  absl::Status Finish() {
    header_.file_bytes = position_;
    header_.content_hash = internal::HashHeader(header_);
    RETURN_IF_ERROR(file_->WriteAt(0, BytesOf(&header_, 1)));
    return file_->Commit();
  }

 private:
  absl::Status Pad(std::uint64_t bytes) {
    position_ += bytes;
    return file_->Write(std::string(bytes, '\0'));
  }

  base::AtomicFile* file_;
  FileHeader header_;
  std::size_t next_section_ = 0;
  std::uint64_t position_ = 0;
};

// The arrays of the file other than descriptors.
struct Tables {
  internal::MetaRecord meta;
  std::string strings;
  std::vector<internal::CameraRecord> cameras;
  std::vector<internal::ViewRecord> views;
  std::vector<Landmark> landmarks;
  std::vector<Feature> features;
  std::vector<std::uint64_t> observations;
};

template <std::size_t N, typename Vector>
void Store(const Vector& source, std::array<double, N>& target) {
  std::copy(source.data(), source.data() + N, target.begin());
}

// Of unit length; one that is already stays as it is to the last bit, so that a
// map which is read and written again is the same file.
Eigen::Quaterniond Unit(const Eigen::Quaterniond& q) {
  constexpr double kRounding = 8.0 * std::numeric_limits<double>::epsilon();
  return std::abs(q.squaredNorm() - 1.0) <= kRounding ? q : q.normalized();
}

geometry::Plane Unit(const geometry::Plane& plane) {
  constexpr double kRounding = 8.0 * std::numeric_limits<double>::epsilon();
  const double squared = plane.normal.squaredNorm();
  if (std::abs(squared - 1.0) <= kRounding) return plane;
  const double norm = std::sqrt(squared);
  return {plane.normal / norm, plane.d / norm};
}

void FillMeta(const MapData& data, const GroundRelief& relief, Tables& tables) {
  internal::MetaRecord& meta = tables.meta;
  meta.scale = data.world_from_source.scale;
  Store(Unit(data.world_from_source.rotation).coeffs(), meta.rotation_xyzw);
  Store(data.world_from_source.translation, meta.translation);
  const geometry::Plane ground = Unit(data.ground);
  Store(ground.normal, meta.ground_normal);
  meta.ground_d = ground.d;
  meta.mean_reprojection_error_px = ComputeReprojection(data).mean_error_px;
  meta.source_format_offset = tables.strings.size();
  meta.source_format_bytes =
      static_cast<std::uint32_t>(data.source_format.size());
  tables.strings += data.source_format;
  meta.metric = data.metric ? 1 : 0;
  if (data.origin) {
    meta.origin_latitude_deg = data.origin->latitude_deg;
    meta.origin_longitude_deg = data.origin->longitude_deg;
    meta.origin_height_m = data.origin->height_m;
    meta.has_origin = 1;
  }
  meta.ground_state = static_cast<std::uint64_t>(data.ground_state);
  meta.ground_sigma_rad = data.ground_sigma_rad;
  meta.ground_height_sigma = data.ground_height_sigma;
  if (relief.empty()) return;
  Store(relief.origin_plane, meta.relief_origin);
  meta.relief_step = relief.step;
  meta.relief_columns = relief.columns;
  meta.relief_is_given = data.given_relief.empty() ? 0 : 1;
}

void FillCameras(const MapData& data, Tables& tables) {
  for (const geometry::CameraModel& camera : data.cameras) {
    internal::CameraRecord& record = tables.cameras.emplace_back();
    record.model = static_cast<std::uint32_t>(camera.id());
    record.width_px = static_cast<std::uint32_t>(camera.width_px());
    record.height_px = static_cast<std::uint32_t>(camera.height_px());
    std::copy(
        camera.params().begin(), camera.params().end(), record.params.begin());
  }
}

void FillViewsAndFeatures(const MapData& data,
                          const std::vector<std::uint32_t>& new_index,
                          Tables& tables) {
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    const MapViewData& view = data.views[v];
    internal::ViewRecord& record = tables.views.emplace_back();
    Store(Unit(view.camera_from_world.rotation).coeffs(), record.rotation_xyzw);
    Store(view.camera_from_world.translation, record.translation);
    record.name_offset = tables.strings.size();
    record.name_bytes = static_cast<std::uint32_t>(view.name.size());
    tables.strings += view.name;
    record.first_feature = tables.features.size();
    record.num_features = static_cast<std::uint32_t>(view.keypoints_px.size());
    record.camera = view.camera;
    for (std::size_t i = 0; i < view.keypoints_px.size(); ++i) {
      tables.features.push_back({view.keypoints_px[i].x(),
                                 view.keypoints_px[i].y(),
                                 new_index[view.landmarks[i]],
                                 static_cast<std::uint32_t>(v)});
    }
  }
}

// Landmarks that are observed, in their order, each with the range of its
// observations. Returns each landmark's new index, or kDropped.
std::vector<std::uint32_t> FillLandmarks(const MapData& data, Tables& tables) {
  std::vector<std::uint32_t> num_observations(data.landmarks.size(), 0);
  for (const MapViewData& view : data.views) {
    for (const std::uint32_t landmark : view.landmarks) {
      ++num_observations[landmark];
    }
  }
  std::vector<std::uint32_t> new_index(data.landmarks.size(), kDropped);
  std::uint64_t first = 0;
  for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
    if (num_observations[i] == 0) continue;
    const MapLandmarkData& source = data.landmarks[i];
    new_index[i] = static_cast<std::uint32_t>(tables.landmarks.size());
    Landmark& landmark = tables.landmarks.emplace_back();
    std::copy(source.p_world.data(),
              source.p_world.data() + 3,
              std::begin(landmark.p_world));
    landmark.error_px = source.error_px;
    std::copy(source.rgb.begin(), source.rgb.end(), std::begin(landmark.rgb));
    landmark.first_observation = first;
    landmark.num_observations = num_observations[i];
    first += num_observations[i];
  }
  return new_index;
}

void FillObservations(Tables& tables) {
  tables.observations.resize(tables.features.size());
  std::vector<std::uint64_t> next;
  next.reserve(tables.landmarks.size());
  for (const Landmark& landmark : tables.landmarks) {
    next.push_back(landmark.first_observation);
  }
  for (std::uint64_t i = 0; i < tables.features.size(); ++i) {
    tables.observations[next[tables.features[i].landmark]++] = i;
  }
}

absl::Status WriteIndex(const MapData& data,
                        const std::vector<std::uint32_t>& new_index,
                        SectionWriter& writer) {
  LandmarkIndexData index = BuildLandmarkIndex(data);
  for (std::uint32_t& landmark : index.entry_landmarks) {
    landmark = new_index[landmark];
  }
  RETURN_IF_ERROR(writer.WriteArray(SectionId::kIndexInnerWords,
                                    index.inner_words.data(),
                                    index.inner_words.size()));
  RETURN_IF_ERROR(writer.WriteArray(SectionId::kIndexLeafWords,
                                    index.leaf_words.data(),
                                    index.leaf_words.size()));
  RETURN_IF_ERROR(writer.WriteArray(SectionId::kIndexListBegin,
                                    index.list_begin.data(),
                                    index.list_begin.size()));
  RETURN_IF_ERROR(writer.WriteArray(SectionId::kIndexLandmarks,
                                    index.entry_landmarks.data(),
                                    index.entry_landmarks.size()));
  return writer.WriteArray(SectionId::kIndexDescriptors,
                           index.entry_descriptors.data(),
                           index.entry_descriptors.size());
}

}  // namespace

absl::Status WriteMapFile(const MapData& data,
                          const std::filesystem::path& path) {
  RETURN_IF_ERROR(data.Validate());
  Tables tables;
  const GroundRelief relief = data.given_relief.empty()
                                  ? EstimateGroundRelief(data)
                                  : data.given_relief;
  FillMeta(data, relief, tables);
  FillCameras(data, tables);
  const std::vector<std::uint32_t> new_index = FillLandmarks(data, tables);
  FillViewsAndFeatures(data, new_index, tables);
  FillObservations(tables);
  std::vector<std::string_view> descriptors;
  std::uint64_t num_descriptors = 0;
  for (const MapViewData& view : data.views) {
    descriptors.push_back(
        BytesOf(view.descriptors.data(), view.descriptors.size()));
    num_descriptors += view.descriptors.size();
  }

  ASSIGN_OR_RETURN(base::AtomicFile file, base::AtomicFile::Create(path));
  SectionWriter writer(&file);
  RETURN_IF_ERROR(writer.Begin());
  RETURN_IF_ERROR(writer.WriteArray(SectionId::kMeta, &tables.meta, 1));
  RETURN_IF_ERROR(writer.WriteArray(
      SectionId::kStrings, tables.strings.data(), tables.strings.size()));
  RETURN_IF_ERROR(writer.WriteArray(
      SectionId::kCameras, tables.cameras.data(), tables.cameras.size()));
  RETURN_IF_ERROR(writer.WriteArray(
      SectionId::kViews, tables.views.data(), tables.views.size()));
  RETURN_IF_ERROR(writer.WriteArray(
      SectionId::kLandmarks, tables.landmarks.data(), tables.landmarks.size()));
  RETURN_IF_ERROR(writer.WriteArray(
      SectionId::kFeatures, tables.features.data(), tables.features.size()));
  RETURN_IF_ERROR(writer.WriteArray(SectionId::kObservations,
                                    tables.observations.data(),
                                    tables.observations.size()));
  RETURN_IF_ERROR(writer.WriteSection(
      SectionId::kDescriptors, num_descriptors, descriptors));
  RETURN_IF_ERROR(WriteIndex(data, new_index, writer));
  RETURN_IF_ERROR(writer.WriteArray(
      SectionId::kGroundRelief, relief.knots.data(), relief.knots.size()));
  return writer.Finish();
}

}  // namespace groundlock::map
