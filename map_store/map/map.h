// SPDX-License-Identifier: Apache-2.0
// The map: one immutable, versioned, checksummed file, memory-mapped and shared
// by all sessions. Opening costs the same whatever the map's size: arrays are
// used where they lie, and every index was built when the file was written.
// The file's layout is described in docs/map_file.md.
#ifndef GROUNDLOCK_MAP_STORE_MAP_MAP_H_
#define GROUNDLOCK_MAP_STORE_MAP_MAP_H_

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/geometry/similarity3.h"
#include "map_store/map/ground_relief.h"
#include "map_store/map/landmark_index.h"
#include "map_store/map/map_data.h"

namespace groundlock::map {

// A landmark as it lies in the file.
struct Landmark {
  double p_world[3];  // m (map units if not metric)
  float error_px;     // 0 if unknown
  std::uint8_t rgb[3];
  std::uint8_t reserved;
  std::uint64_t first_observation;  // into Map::ObservationsOf
  std::uint32_t num_observations;
  std::uint32_t reserved2;

  Eigen::Vector3d Position() const {
    return {p_world[0], p_world[1], p_world[2]};
  }
};

// A feature of a view as it lies in the file; every one observes a landmark.
struct Feature {
  float x_px;  // first pixel's centre (0.5, 0.5)
  float y_px;
  std::uint32_t landmark;
  std::uint32_t view;
};

struct MapView {
  std::string_view name;
  std::uint32_t camera = 0;  // index for Map::camera
  geometry::Rigid3 camera_from_world;
  Eigen::Vector3d center_world;
  std::uint64_t first_feature = 0;  // into Map::features
  std::uint32_t num_features = 0;
};

struct MapInfo {
  // 32 hex digits: XXH3-128 over the header, which holds that of each section.
  // Equal data gives equal hashes.
  std::string content_hash;
  std::string source_format;
  bool metric = false;
  geometry::Similarity3 world_from_source;
  geometry::Plane ground_world;
  // Files of older versions do not say how sure their ground is: measured in
  // metric maps, else estimated, without a sigma.
  GroundState ground_state = GroundState::kUnknown;
  double ground_sigma_rad = 0.0;     // 0 = not stated
  double ground_height_sigma = 0.0;  // MapData's; 0 = not stated
  // From the lowest to the highest known ground over the plane; 0 = it is the
  // plane (Map::ground_relief tells where).
  double ground_relief_m = 0.0;
  // That relief is a terrain that was given, not what the landmarks tell.
  bool ground_relief_given = false;
  // The lens of all views, if they have one and the same.
  std::optional<geometry::CameraModel> lens;
  // Set if world is georeferenced: x east, y north and z up here.
  std::optional<geometry::GeodeticPosition> origin;
  std::uint64_t num_cameras = 0;
  std::uint64_t num_views = 0;
  std::uint64_t num_landmarks = 0;
  std::uint64_t num_observations = 0;
  double mean_reprojection_error_px = 0.0;  // over observations
  bool has_descriptors = false;
  std::uint64_t file_bytes = 0;
};

// Thread-safe. A file that is damaged leads nobody outside its arrays:
// landmarks named by FeaturesOf, by the features that ObservationsOf names and
// by FindLandmark (landmark_index.h) exist.
class Map {
 public:
  // Maps the file and checks its header, table of sections and bounds.
  // kNotFound, kDataLoss (truncated, damaged, not a map), kUnimplemented (a
  // newer format version; the message gives both). Content checksums are not
  // read here: see Verify and VerifyInBackground.
  static absl::StatusOr<std::shared_ptr<const Map>> Open(
      const std::filesystem::path& path);

  ~Map();
  Map(const Map&) = delete;
  Map& operator=(const Map&) = delete;

  const MapInfo& info() const { return info_; }
  const geometry::CameraModel& camera(std::uint32_t index) const;
  std::size_t num_views() const { return views_.size(); }
  const MapView& view(std::size_t index) const { return views_[index]; }

  std::span<const Landmark> landmarks() const { return landmarks_; }
  std::span<const Feature> features() const { return features_; }
  // `view` is one of this map's. Looked through when first asked for; empty if
  // it is damaged.
  std::span<const Feature> FeaturesOf(const MapView& view) const;
  // Descriptors of features(), in the same order; empty if the map has none.
  std::span<const Descriptor> descriptors() const { return descriptors_; }
  // One for each of FeaturesOf.
  std::span<const Descriptor> DescriptorsOf(const MapView& view) const;
  // Indices into features() of the observations of one landmark, in views that
  // exist; empty if they are damaged.
  std::span<const std::uint64_t> ObservationsOf(const Landmark& landmark) const;

  // From a descriptor to landmarks; empty if the map has no descriptors.
  const LandmarkIndex& landmark_index() const { return landmark_index_; }

  // Over info().ground_world; empty where the ground is a plane.
  const GroundRelief& ground_relief() const { return ground_relief_; }

  // Reads everything: checksums of all sections and all indices in range.
  // kDataLoss names the section.
  absl::Status Verify() const;
  // Compares the checksums of all sections once, however often it is asked for,
  // on a thread that takes a fifth of a core where nothing else wants it; what
  // it finds, damage() tells. Returns at once.
  void VerifyInBackground() const;
  // What was found to be damaged so far, by whoever looked; kDataLoss.
  absl::Status damage() const;

  // Back to the editable form (for exporters and extension).
  MapData ToData() const;

 private:
  class Integrity;

  Map();
  absl::Status Read();
  absl::Status VerifyIndices() const;
  // kDataLoss names the section; kCancelled if `go_on` says so between two
  // parts of it.
  absl::Status VerifyChecksums(const std::function<bool()>& go_on) const;
  void BeginIntegrity();
  absl::Status CheckFeatures(std::size_t view) const;
  bool IsViewWhole(const MapView& view) const;

  MapInfo info_;
  std::vector<geometry::CameraModel> cameras_;
  std::vector<MapView> views_;
  std::span<const Landmark> landmarks_;
  std::span<const Feature> features_;
  std::span<const Descriptor> descriptors_;
  std::span<const std::uint64_t> observations_;
  LandmarkIndex landmark_index_;
  GroundRelief ground_relief_;
  const std::byte* mapping_ = nullptr;
  std::size_t mapping_bytes_ = 0;
  std::unique_ptr<Integrity> integrity_;
};

// Validates `data` and writes it as a map file, whole or not at all.
// Landmarks without an observation are dropped.
absl::Status WriteMapFile(const MapData& data,
                          const std::filesystem::path& path);

}  // namespace groundlock::map

#endif  // GROUNDLOCK_MAP_STORE_MAP_MAP_H_
