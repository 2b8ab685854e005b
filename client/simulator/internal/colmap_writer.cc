// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/colmap_writer.h"

#include <sqlite3.h>

#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::simulator {
namespace {

constexpr std::uint32_t kCameraId = 1;
constexpr std::int32_t kSimpleRadial = 2;  // COLMAP's model id
constexpr std::uint64_t kNoPoint = ~0ULL;

// Little-endian, packed: COLMAP's binary form on the machines we build for.
class Bytes {
 public:
  template <typename T>
  void Add(T value) {
    static_assert(std::is_arithmetic_v<T>);
    const std::size_t at = data_.size();
    data_.resize(at + sizeof(T));
    std::memcpy(data_.data() + at, &value, sizeof(T));
  }
  void AddName(const std::string& name) {
    data_ += name;
    data_ += '\0';
  }
  const std::string& data() const { return data_; }

 private:
  std::string data_;
};

std::uint32_t ImageId(int view) { return static_cast<std::uint32_t>(view) + 1; }
std::uint64_t PointId(int landmark) {
  return static_cast<std::uint64_t>(landmark) + 1;
}

Bytes Cameras(const YardMap& map) {
  Bytes out;
  out.Add<std::uint64_t>(1);
  out.Add<std::uint32_t>(kCameraId);
  out.Add<std::int32_t>(kSimpleRadial);
  out.Add<std::uint64_t>(map.lens.width_px);
  out.Add<std::uint64_t>(map.lens.height_px);
  for (const double p : {map.lens.f, map.lens.cx, map.lens.cy, map.lens.k}) {
    out.Add<double>(p);
  }
  return out;
}

Bytes Images(const YardMap& map, const geometry::Similarity3& w) {
  Bytes out;
  out.Add<std::uint64_t>(map.views.size());
  for (std::size_t i = 0; i < map.views.size(); ++i) {
    const MapView& view = map.views[i];
    // x_camera / s = R_c R p_model + (R_c t + t_c) / s.
    const geometry::Rigid3& camera = view.camera_from_world;
    const Eigen::Quaterniond q = (camera.rotation * w.rotation).normalized();
    const Eigen::Vector3d t = (camera * w.translation) / w.scale;
    out.Add<std::uint32_t>(ImageId(static_cast<int>(i)));
    for (const double v : {q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()}) {
      out.Add<double>(v);
    }
    out.Add<std::uint32_t>(kCameraId);
    out.AddName(view.name);
    out.Add<std::uint64_t>(view.p_px.size());
    for (std::size_t f = 0; f < view.p_px.size(); ++f) {
      out.Add<double>(view.p_px[f].x());
      out.Add<double>(view.p_px[f].y());
      out.Add<std::uint64_t>(
          view.landmarks[f] < 0 ? kNoPoint : PointId(view.landmarks[f]));
    }
  }
  return out;
}

Bytes Points(const YardMap& map, const geometry::Similarity3& w) {
  Bytes out;
  out.Add<std::uint64_t>(map.landmarks.size());
  for (std::size_t i = 0; i < map.landmarks.size(); ++i) {
    const MapLandmark& landmark = map.landmarks[i];
    const Eigen::Vector3d p =
        w.rotation.conjugate() * (landmark.p_world - w.translation) / w.scale;
    out.Add<std::uint64_t>(PointId(static_cast<int>(i)));
    for (const double v : {p.x(), p.y(), p.z()}) out.Add<double>(v);
    for (const std::uint8_t c : landmark.rgb) out.Add<std::uint8_t>(c);
    out.Add<double>(landmark.error_px);
    out.Add<std::uint64_t>(landmark.track.size());
    for (const auto& [view, feature] : landmark.track) {
      out.Add<std::uint32_t>(ImageId(view));
      out.Add<std::uint32_t>(static_cast<std::uint32_t>(feature));
    }
  }
  return out;
}

// The tables of COLMAP 3.8 that hold features (its documentation, "Database
// format"); matches are not kept, the model holds the tracks.
constexpr char kSchema[] =
    "PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF;"
    "CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT "
    "NULL,"
    " model INTEGER NOT NULL, width INTEGER NOT NULL, height INTEGER NOT NULL,"
    " params BLOB, prior_focal_length INTEGER NOT NULL);"
    "CREATE TABLE images (image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,"
    " name TEXT NOT NULL UNIQUE, camera_id INTEGER NOT NULL, prior_qw REAL,"
    " prior_qx REAL, prior_qy REAL, prior_qz REAL, prior_tx REAL,"
    " prior_ty REAL, prior_tz REAL);"
    "CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY NOT NULL,"
    " rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);"
    "CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY NOT NULL,"
    " rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);"
    "CREATE TABLE matches (pair_id INTEGER PRIMARY KEY NOT NULL,"
    " rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);"
    "CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY NOT NULL,"
    " rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,"
    " config INTEGER NOT NULL, F BLOB, E BLOB, H BLOB, qvec BLOB, tvec BLOB);"
    "BEGIN;";

class Database {
 public:
  explicit Database(const std::filesystem::path& path) : path_(path.string()) {
    Check(sqlite3_open(path_.c_str(), &db_));
  }
  Database(const Database&) = delete;
  Database& operator=(const Database&) = delete;
  ~Database() { sqlite3_close(db_); }

  void Run(const char* sql) {
    if (status_.ok()) Check(sqlite3_exec(db_, sql, nullptr, nullptr, nullptr));
  }
  // INSERT of integers, then one blob (name if is_text).
  void Insert(const char* sql,
              const std::vector<std::int64_t>& integers,
              const void* blob,
              std::size_t bytes,
              bool is_text) {
    if (!status_.ok()) return;
    sqlite3_stmt* statement = nullptr;
    Check(sqlite3_prepare_v2(db_, sql, -1, &statement, nullptr));
    if (!status_.ok()) return;
    int at = 1;
    for (const std::int64_t value : integers) {
      sqlite3_bind_int64(statement, at++, value);
    }
    const int size = static_cast<int>(bytes);
    if (is_text) {
      sqlite3_bind_text(
          statement, at, static_cast<const char*>(blob), size, SQLITE_STATIC);
    } else {
      sqlite3_bind_blob(statement, at, blob, size, SQLITE_STATIC);
    }
    if (sqlite3_step(statement) != SQLITE_DONE) Check(sqlite3_errcode(db_));
    sqlite3_finalize(statement);
  }
  const absl::Status& status() const { return status_; }

 private:
  void Check(int code) {
    if (code != SQLITE_OK && status_.ok()) {
      status_ = absl::UnavailableError(
          absl::StrCat(path_, ": ", sqlite3_errmsg(db_)));
    }
  }

  std::string path_;
  sqlite3* db_ = nullptr;
  absl::Status status_;
};

absl::Status WriteDatabase(const YardMap& map,
                           const std::filesystem::path& path) {
  std::error_code ignored;  // absent is fine; another failure shows on opening
  std::filesystem::remove(path, ignored);
  Database database(path);
  database.Run(kSchema);
  Bytes params;
  for (const double p : {map.lens.f, map.lens.cx, map.lens.cy, map.lens.k}) {
    params.Add<double>(p);
  }
  database.Insert(
      "INSERT INTO cameras(camera_id, model, width, height,"
      " prior_focal_length, params) VALUES(?,?,?,?,?,?)",
      {kCameraId, kSimpleRadial, map.lens.width_px, map.lens.height_px, 1},
      params.data().data(),
      params.data().size(),
      false);
  for (std::size_t i = 0; i < map.views.size(); ++i) {
    const MapView& view = map.views[i];
    const std::int64_t id = ImageId(static_cast<int>(i));
    database.Insert(
        "INSERT INTO images(image_id, camera_id, name) VALUES(?,?,?)",
        {id, kCameraId},
        view.name.data(),
        view.name.size(),
        true);
    Bytes keypoints;  // x, y, scale, orientation
    for (std::size_t f = 0; f < view.p_px.size(); ++f) {
      keypoints.Add(static_cast<float>(view.p_px[f].x()));
      keypoints.Add(static_cast<float>(view.p_px[f].y()));
      keypoints.Add(view.scale_angle[f][0]);
      keypoints.Add(view.scale_angle[f][1]);
    }
    const auto rows = static_cast<std::int64_t>(view.p_px.size());
    database.Insert(
        "INSERT INTO keypoints(image_id, rows, cols, data) VALUES(?,?,?,?)",
        {id, rows, 4},
        keypoints.data().data(),
        keypoints.data().size(),
        false);
    database.Insert(
        "INSERT INTO descriptors(image_id, rows, cols, data) VALUES(?,?,?,?)",
        {id, rows, 128},
        view.descriptors.data,
        view.descriptors.total(),
        false);
  }
  database.Run("COMMIT;");
  return database.status();
}

}  // namespace

absl::Status WriteColmap(const YardMap& map,
                         const geometry::Similarity3& world_from_model,
                         const std::filesystem::path& folder) {
  const std::filesystem::path model = folder / "sparse" / "0";
  std::error_code error;
  std::filesystem::create_directories(model, error);
  if (error) {
    return absl::UnavailableError(
        absl::StrCat(model.string(), ": ", error.message()));
  }
  RETURN_IF_ERROR(
      base::WriteFileAtomically(model / "cameras.bin", Cameras(map).data()));
  RETURN_IF_ERROR(base::WriteFileAtomically(
      model / "images.bin", Images(map, world_from_model).data()));
  RETURN_IF_ERROR(base::WriteFileAtomically(
      model / "points3D.bin", Points(map, world_from_model).data()));
  return WriteDatabase(map, folder / "database.db");
}

}  // namespace groundlock::simulator
