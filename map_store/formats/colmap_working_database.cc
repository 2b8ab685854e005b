// SPDX-License-Identifier: Apache-2.0
#include <cstring>
#include <system_error>
#include <unordered_map>
#include <utility>

#include "map_store/base/status.h"
#include "map_store/formats/colmap_database.h"
#include "map_store/formats/internal/colmap_schema.h"
#include "map_store/formats/internal/sqlite.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using internal::SqlDatabase;
using internal::SqlStatement;

constexpr std::int64_t kMaxImages = 2'147'483'647;  // COLMAP's pair ids
constexpr std::int64_t kMaxFeatures = 1 << 24;      // of one image

// COLMAP's two_view_geometries.config.
constexpr std::int64_t kPlanar = 4;
constexpr std::int64_t kPlanarOrPanoramic = 6;

template <typename T>
std::string_view BytesOf(const std::vector<T>& items) {
  return {reinterpret_cast<const char*>(items.data()),
          items.size() * sizeof(T)};
}

absl::Status InsertMatrix(std::int64_t id,
                          std::size_t rows,
                          std::int64_t cols,
                          std::string_view data,
                          SqlStatement* insert) {
  insert->Bind(1, id);
  insert->Bind(2, static_cast<std::int64_t>(rows));
  insert->Bind(3, cols);
  insert->BindBlob(4, data);
  return insert->RunOnce();
}

absl::Status InsertCameras(std::span<const ColmapDatabaseCamera> cameras,
                           SqlDatabase* db) {
  ASSIGN_OR_RETURN(
      SqlStatement insert,
      db->Prepare("INSERT INTO cameras VALUES (?1, ?2, ?3, ?4, ?5, ?6)"));
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const geometry::CameraModel& camera = cameras[i].camera;
    const std::vector<double> params(camera.params().begin(),
                                     camera.params().end());
    insert.Bind(1, static_cast<std::int64_t>(i) + 1);
    insert.Bind(2, static_cast<std::int64_t>(camera.id()));
    insert.Bind(3, camera.width_px());
    insert.Bind(4, camera.height_px());
    insert.BindBlob(5, BytesOf(params));
    insert.Bind(6, cameras[i].focal_length_is_known ? 1 : 0);
    RETURN_IF_ERROR(insert.RunOnce());
  }
  return absl::OkStatus();
}

absl::Status InsertImages(std::span<const ColmapDatabaseImage> images,
                          std::size_t num_cameras,
                          SqlDatabase* db) {
  ASSIGN_OR_RETURN(SqlStatement insert,
                   db->Prepare("INSERT INTO images (image_id, name, camera_id) "
                               "VALUES (?1, ?2, ?3)"));
  ASSIGN_OR_RETURN(
      SqlStatement keypoints,
      db->Prepare("INSERT INTO keypoints VALUES (?1, ?2, ?3, ?4)"));
  ASSIGN_OR_RETURN(
      SqlStatement descriptors,
      db->Prepare("INSERT INTO descriptors VALUES (?1, ?2, ?3, ?4)"));
  static_assert(sizeof(Eigen::Vector2f) == 2 * sizeof(float));
  for (std::size_t i = 0; i < images.size(); ++i) {
    const ColmapDatabaseImage& image = images[i];
    if (image.camera >= num_cameras ||
        image.keypoints_px.size() != image.descriptors.size()) {
      return absl::InvalidArgumentError(
          absl::StrCat("image ",
                       image.name,
                       ": camera ",
                       image.camera,
                       ", ",
                       image.keypoints_px.size(),
                       " features and ",
                       image.descriptors.size(),
                       " descriptors do not fit together"));
    }
    const std::int64_t id = static_cast<std::int64_t>(i) + 1;
    insert.Bind(1, id);
    insert.BindText(2, image.name);
    insert.Bind(3, std::int64_t{image.camera} + 1);
    RETURN_IF_ERROR(base::Annotate(insert.RunOnce(), "image " + image.name));
    RETURN_IF_ERROR(InsertMatrix(id,
                                 image.keypoints_px.size(),
                                 2,
                                 BytesOf(image.keypoints_px),
                                 &keypoints));
    RETURN_IF_ERROR(InsertMatrix(id,
                                 image.descriptors.size(),
                                 128,
                                 BytesOf(image.descriptors),
                                 &descriptors));
  }
  return absl::OkStatus();
}

absl::Status WriteDatabase(const fs::path& path,
                           std::span<const ColmapDatabaseCamera> cameras,
                           std::span<const ColmapDatabaseImage> images) {
  ASSIGN_OR_RETURN(SqlDatabase db, SqlDatabase::CreateNew(path));
  RETURN_IF_ERROR(db.Execute("BEGIN"));
  RETURN_IF_ERROR(db.Execute(internal::kColmapSchema));
  RETURN_IF_ERROR(InsertCameras(cameras, &db));
  RETURN_IF_ERROR(InsertImages(images, cameras.size(), &db));
  return db.Execute("COMMIT");
}

// image_id -> index among the images in the order of their ids.
absl::StatusOr<std::unordered_map<std::int64_t, std::uint32_t>> ImageIndices(
    SqlDatabase* db) {
  std::unordered_map<std::int64_t, std::uint32_t> indices;
  ASSIGN_OR_RETURN(
      SqlStatement select,
      db->Prepare("SELECT image_id FROM images ORDER BY image_id"));
  for (;;) {
    ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return indices;
    indices.emplace(select.Int(0), static_cast<std::uint32_t>(indices.size()));
  }
}

}  // namespace

absl::Status CreateColmapDatabase(const fs::path& path,
                                  std::span<const ColmapDatabaseCamera> cameras,
                                  std::span<const ColmapDatabaseImage> images) {
  const fs::path temporary = path.string() + ".tmp";
  std::error_code error;
  fs::remove(temporary, error);
  RETURN_IF_ERROR(
      base::Annotate(WriteDatabase(temporary, cameras, images), path.string()));
  for (const char* suffix : {"-journal", "-wal", "-shm"}) {
    fs::remove(path.string() + suffix, error);
  }
  fs::rename(temporary, path, error);
  if (error) {
    return absl::FailedPreconditionError(
        absl::StrCat("cannot create ", path.string(), ": ", error.message()));
  }
  return absl::OkStatus();
}

absl::Status AddColmapMatches(const fs::path& path,
                              std::span<const ColmapPairMatches> pairs) {
  ASSIGN_OR_RETURN(SqlDatabase db, SqlDatabase::OpenForWriting(path));
  RETURN_IF_ERROR(db.Execute("BEGIN IMMEDIATE"));
  ASSIGN_OR_RETURN(
      SqlStatement insert,
      db.Prepare("INSERT OR REPLACE INTO matches VALUES (?1, ?2, ?3, ?4)"));
  ASSIGN_OR_RETURN(
      SqlStatement forget,
      db.Prepare("DELETE FROM two_view_geometries WHERE pair_id = ?1"));
  for (const ColmapPairMatches& pair : pairs) {
    std::int64_t id1 = std::int64_t{pair.image1} + 1;
    std::int64_t id2 = std::int64_t{pair.image2} + 1;
    std::vector<std::array<std::uint32_t, 2>> features = pair.features;
    if (id1 > id2) {
      std::swap(id1, id2);
      for (auto& match : features) std::swap(match[0], match[1]);
    }
    const std::int64_t pair_id = kMaxImages * id1 + id2;
    forget.Bind(1, pair_id);
    RETURN_IF_ERROR(forget.RunOnce());
    RETURN_IF_ERROR(
        InsertMatrix(pair_id, features.size(), 2, BytesOf(features), &insert));
  }
  return db.Execute("COMMIT");
}

absl::StatusOr<std::vector<ColmapDatabaseImage>> ReadColmapFeatures(
    const fs::path& path) {
  ASSIGN_OR_RETURN(SqlDatabase db, SqlDatabase::OpenUntrusted(path));
  ASSIGN_OR_RETURN(
      SqlStatement select,
      db.Prepare("SELECT i.name, i.camera_id, k.rows, k.cols, k.data, d.rows, "
                 "d.cols, d.data FROM images i "
                 "LEFT JOIN keypoints k ON k.image_id = i.image_id "
                 "LEFT JOIN descriptors d ON d.image_id = i.image_id "
                 "ORDER BY i.image_id"));
  std::vector<ColmapDatabaseImage> images;
  for (;;) {
    ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return images;
    ColmapDatabaseImage image;
    image.name = std::string(select.Text(0));
    image.camera = static_cast<std::uint32_t>(select.Int(1) - 1);
    const std::int64_t rows = select.Int(2);
    const std::int64_t cols = select.Int(3);
    const std::string_view points = select.Blob(4);
    if (rows < 0 || rows > kMaxFeatures || cols < 0 || cols > 16 ||
        points.size() != static_cast<std::size_t>(rows * cols) * 4 ||
        (rows > 0 && cols < 2)) {
      return absl::InvalidArgumentError(absl::StrCat(
          path.string(), ": image ", image.name, ": damaged keypoints"));
    }
    for (std::int64_t i = 0; i < rows; ++i) {
      Eigen::Vector2f xy;
      std::memcpy(xy.data(), points.data() + i * cols * 4, 8);
      image.keypoints_px.push_back(xy);
    }
    const std::string_view bytes = select.Blob(7);
    if (select.Int(5) != rows ||
        bytes.size() != static_cast<std::size_t>(rows) * 128) {
      return absl::InvalidArgumentError(absl::StrCat(
          path.string(), ": image ", image.name, ": damaged descriptors"));
    }
    image.descriptors.resize(static_cast<std::size_t>(rows));
    if (rows > 0) {
      std::memcpy(image.descriptors.data(), bytes.data(), bytes.size());
    }
    images.push_back(std::move(image));
  }
}

absl::StatusOr<std::vector<ColmapVerifiedPair>> ReadColmapVerifiedPairs(
    const fs::path& path) {
  ASSIGN_OR_RETURN(SqlDatabase db, SqlDatabase::OpenUntrusted(path));
  ASSIGN_OR_RETURN(const auto indices, ImageIndices(&db));
  ASSIGN_OR_RETURN(
      SqlStatement select,
      db.Prepare("SELECT pair_id, rows, config FROM two_view_geometries "
                 "ORDER BY pair_id"));
  std::vector<ColmapVerifiedPair> pairs;
  for (;;) {
    ASSIGN_OR_RETURN(const bool row, select.Step());
    if (!row) return pairs;
    const auto first = indices.find(select.Int(0) / kMaxImages);
    const auto second = indices.find(select.Int(0) % kMaxImages);
    if (first == indices.end() || second == indices.end()) continue;
    const std::int64_t config = select.Int(2);
    pairs.push_back({.image1 = first->second,
                     .image2 = second->second,
                     .num_inliers = static_cast<int>(select.Int(1)),
                     .is_planar_or_rotation =
                         config >= kPlanar && config <= kPlanarOrPanoramic});
  }
}

}  // namespace groundlock::formats
