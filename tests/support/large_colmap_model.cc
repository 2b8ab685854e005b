// SPDX-License-Identifier: Apache-2.0
#include "tests/support/large_colmap_model.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/colmap_schema.h"
#include "map_store/formats/internal/sqlite.h"
#include "map_store/map/map_data.h"

namespace groundlock::test_support {
namespace {

using formats::internal::SqlDatabase;
using formats::internal::SqlStatement;

constexpr double kFocal_px = 1'000.0;
constexpr int kWidth_px = 1'280;
constexpr int kHeight_px = 960;
constexpr double kHeight = 20.0;  // of the cameras above the ground
constexpr double kSpacing = 1.0;  // between cameras along a strip
constexpr double kStrip = 8.0;    // between strips
constexpr double kNoise_px = 0.5;
// COLMAP's own extractor writes x, y, scale and orientation as an affine
// shape: six columns.
constexpr int kKeypointColumns = 6;
constexpr std::uint64_t kNoPoint = ~std::uint64_t{0};

struct Feature {
  Eigen::Vector2f xy_px;
  std::uint64_t point_id = kNoPoint;
};

class Binary {
 public:
  explicit Binary(const std::filesystem::path& path)
      : path_(path), stream_(path, std::ios::binary) {}
  template <typename T>
  void Put(T value) {
    stream_.write(reinterpret_cast<const char*>(&value), sizeof(value));
  }
  void PutText(const std::string& text) {
    stream_.write(text.c_str(), static_cast<std::streamsize>(text.size() + 1));
  }
  absl::Status Close() {
    stream_.close();
    if (stream_) return absl::OkStatus();
    return absl::InternalError(absl::StrCat(path_.string(), ": cannot write"));
  }

 private:
  std::filesystem::path path_;
  std::ofstream stream_;
};

class Generator {
 public:
  explicit Generator(const LargeModelOptions& options)
      : options_(options),
        columns_(std::max(
            options.observations_per_landmark,
            static_cast<std::uint32_t>(std::sqrt(4.0 * options.num_views)))),
        engine_(options.seed) {}

  absl::Status Write(const std::filesystem::path& folder) {
    features_.resize(options_.num_views);
    RETURN_IF_ERROR(WriteCameras(folder / "cameras.bin"));
    RETURN_IF_ERROR(WritePoints(folder / "points3D.bin"));
    RETURN_IF_ERROR(WriteImages(folder / "images.bin"));
    return WriteDatabase(folder / "database.db");
  }

 private:
  double Uniform(double from, double to) {
    return std::uniform_real_distribution<double>(from, to)(engine_);
  }
  Eigen::Vector3d CentreOf(std::uint32_t view) const {
    return {kSpacing * (view % columns_), kStrip * (view / columns_), kHeight};
  }
  static std::string NameOf(std::uint32_t view) {
    return absl::StrCat("flight/image", view, ".jpg");
  }

  absl::Status WriteCameras(const std::filesystem::path& path) const {
    Binary file(path);
    file.Put<std::uint64_t>(1);
    file.Put<std::uint32_t>(1);
    file.Put<std::int32_t>(0);  // SIMPLE_PINHOLE
    file.Put<std::uint64_t>(kWidth_px);
    file.Put<std::uint64_t>(kHeight_px);
    for (const double p : {kFocal_px, 0.5 * kWidth_px, 0.5 * kHeight_px}) {
      file.Put(p);
    }
    return file.Close();
  }

  // A landmark, below the middle of a run of cameras of one strip, becomes a
  // feature of each.
  absl::Status WritePoints(const std::filesystem::path& path) {
    Binary file(path);
    file.Put<std::uint64_t>(options_.num_landmarks);
    const std::uint32_t run = options_.observations_per_landmark;
    for (std::uint32_t i = 0; i < options_.num_landmarks; ++i) {
      std::uint32_t first = static_cast<std::uint32_t>(
          engine_() % (options_.num_views - run + 1));
      // Not across the end of a strip.
      const std::uint32_t strip = first / columns_;
      if ((first + run - 1) / columns_ != strip) {
        first = (strip + 1) * columns_ - run;
      }
      const Eigen::Vector3d middle = CentreOf(first + run / 2);
      const Eigen::Vector3d point(middle.x() + Uniform(-4.0, 4.0),
                                  middle.y() + Uniform(-4.0, 4.0),
                                  Uniform(-0.03, 0.03));
      const std::uint64_t id = std::uint64_t{i} + 1;
      file.Put(id);
      for (const double value : point) file.Put(value);
      for (const int colour : {120, 110, 100}) {
        file.Put(static_cast<std::uint8_t>(colour));
      }
      file.Put<double>(kNoise_px);
      file.Put<std::uint64_t>(run);
      for (std::uint32_t view = first; view < first + run; ++view) {
        // Turned half about x: y and z of the camera are -y and -z.
        const Eigen::Vector3d p = point - CentreOf(view);
        std::vector<Feature>& features = features_[view];
        file.Put<std::uint32_t>(view + 1);
        file.Put<std::uint32_t>(static_cast<std::uint32_t>(features.size()));
        features.push_back(
            {{static_cast<float>(0.5 * kWidth_px - kFocal_px * p.x() / p.z() +
                                 Uniform(-kNoise_px, kNoise_px)),
              static_cast<float>(0.5 * kHeight_px + kFocal_px * p.y() / p.z() +
                                 Uniform(-kNoise_px, kNoise_px))},
             id});
      }
    }
    return file.Close();
  }

  absl::Status WriteImages(const std::filesystem::path& path) {
    Binary file(path);
    file.Put<std::uint64_t>(options_.num_views);
    for (std::uint32_t view = 0; view < options_.num_views; ++view) {
      std::vector<Feature>& features = features_[view];
      for (std::uint32_t i = 0; i < options_.loose_features_per_view; ++i) {
        features.push_back({{static_cast<float>(Uniform(0.0, kWidth_px)),
                             static_cast<float>(Uniform(0.0, kHeight_px))},
                            kNoPoint});
      }
      const Eigen::Vector3d centre = CentreOf(view);
      file.Put<std::uint32_t>(view + 1);
      for (const double q : {0.0, 1.0, 0.0, 0.0}) file.Put(q);
      for (const double t : {-centre.x(), centre.y(), centre.z()}) file.Put(t);
      file.Put<std::uint32_t>(1);
      file.PutText(NameOf(view));
      file.Put<std::uint64_t>(features.size());
      for (const Feature& feature : features) {
        file.Put<double>(feature.xy_px.x());
        file.Put<double>(feature.xy_px.y());
        file.Put(feature.point_id);
      }
    }
    return file.Close();
  }

  // A landmark's own, the same whoever asks; SIFT's are a quarter to a half
  // empty.
  static map::Descriptor DescriptorOf(std::uint64_t seed) {
    std::mt19937_64 engine(seed);
    map::Descriptor descriptor;
    for (std::size_t i = 0; i < descriptor.size(); i += 4) {
      std::uint64_t bits = engine();
      for (std::size_t k = 0; k < 4; ++k, bits >>= 16U) {
        descriptor[i + k] = static_cast<std::uint8_t>(
            (bits & 3U) == 0 ? (bits >> 2U) % 120 : 0);
      }
    }
    return descriptor;
  }

  std::vector<map::Descriptor> DescriptorsOf(std::uint32_t view) {
    std::vector<map::Descriptor> descriptors;
    descriptors.reserve(features_[view].size());
    for (const Feature& feature : features_[view]) {
      map::Descriptor descriptor = DescriptorOf(
          feature.point_id == kNoPoint ? engine_() : feature.point_id);
      // As far apart as two of one landmark in real photos, some 180 of 512.
      for (int n = 0; n < 48; ++n) {
        const std::uint64_t bits = engine_();
        std::uint8_t& value = descriptor[bits % descriptor.size()];
        value = static_cast<std::uint8_t>(
            std::min<std::uint64_t>(255, value + (bits >> 8U) % 32));
      }
      descriptors.push_back(descriptor);
    }
    return descriptors;
  }

  absl::Status WriteDatabase(const std::filesystem::path& path) {
    ASSIGN_OR_RETURN(SqlDatabase db, SqlDatabase::CreateNew(path));
    RETURN_IF_ERROR(db.Execute("BEGIN"));
    RETURN_IF_ERROR(db.Execute(formats::internal::kColmapSchema));
    ASSIGN_OR_RETURN(
        SqlStatement image,
        db.Prepare("INSERT INTO images (image_id, name, camera_id) "
                   "VALUES (?1, ?2, 1)"));
    ASSIGN_OR_RETURN(
        SqlStatement keypoints,
        db.Prepare("INSERT INTO keypoints VALUES (?1, ?2, ?3, ?4)"));
    ASSIGN_OR_RETURN(
        SqlStatement descriptors,
        db.Prepare("INSERT INTO descriptors VALUES (?1, ?2, 128, ?3)"));
    for (std::uint32_t view = 0; view < options_.num_views; ++view) {
      const std::vector<Feature>& features = features_[view];
      const std::int64_t id = std::int64_t{view} + 1;
      const auto rows = static_cast<std::int64_t>(features.size());
      const std::string name = NameOf(view);
      image.Bind(1, id);
      image.BindText(2, name);
      RETURN_IF_ERROR(image.RunOnce());
      std::vector<std::array<float, kKeypointColumns>> table;
      table.reserve(features.size());
      for (const Feature& feature : features) {
        table.push_back(
            {feature.xy_px.x(), feature.xy_px.y(), 2.0F, 0.0F, 0.0F, 2.0F});
      }
      keypoints.Bind(1, id);
      keypoints.Bind(2, rows);
      keypoints.Bind(3, kKeypointColumns);
      keypoints.BindBlob(4,
                         {reinterpret_cast<const char*>(table.data()),
                          table.size() * sizeof(table[0])});
      RETURN_IF_ERROR(keypoints.RunOnce());
      const std::vector<map::Descriptor> own = DescriptorsOf(view);
      descriptors.Bind(1, id);
      descriptors.Bind(2, rows);
      descriptors.BindBlob(3,
                           {reinterpret_cast<const char*>(own.data()),
                            own.size() * sizeof(own[0])});
      RETURN_IF_ERROR(descriptors.RunOnce());
    }
    return db.Execute("COMMIT");
  }

  const LargeModelOptions options_;
  const std::uint32_t columns_;
  std::mt19937_64 engine_;
  std::vector<std::vector<Feature>> features_;  // per view
};

}  // namespace

absl::Status WriteLargeColmapModel(const LargeModelOptions& options,
                                   const std::filesystem::path& folder) {
  if (options.num_views < options.observations_per_landmark ||
      options.observations_per_landmark == 0) {
    return absl::InvalidArgumentError(
        "a landmark cannot be observed by more views than there are");
  }
  return Generator(options).Write(folder);
}

}  // namespace groundlock::test_support
