// SPDX-License-Identifier: Apache-2.0
// A database.db that COLMAP opens: the tables of its documentation ("Database
// Format"), those of the matching left empty.
#include "map_store/base/status.h"
#include "map_store/formats/internal/colmap_schema.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/sqlite.h"

namespace groundlock::formats::internal {
namespace {

template <typename T>
std::string_view BytesOf(const T* items, std::size_t count) {
  return {reinterpret_cast<const char*>(items), count * sizeof(T)};
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

absl::Status InsertCameras(const map::MapData& data, SqlDatabase* db) {
  ASSIGN_OR_RETURN(
      SqlStatement insert,
      db->Prepare("INSERT INTO cameras VALUES (?1, ?2, ?3, ?4, ?5, 1)"));
  for (std::size_t i = 0; i < data.cameras.size(); ++i) {
    const geometry::CameraModel& camera = data.cameras[i];
    insert.Bind(1, static_cast<std::int64_t>(i) + 1);
    insert.Bind(2, static_cast<std::int64_t>(camera.id()));
    insert.Bind(3, camera.width_px());
    insert.Bind(4, camera.height_px());
    insert.BindBlob(5, BytesOf(camera.params().data(), camera.params().size()));
    RETURN_IF_ERROR(insert.RunOnce());
  }
  return absl::OkStatus();
}

absl::Status InsertViews(const map::MapData& data, SqlDatabase* db) {
  ASSIGN_OR_RETURN(SqlStatement image,
                   db->Prepare("INSERT INTO images (image_id, name, camera_id) "
                               "VALUES (?1, ?2, ?3)"));
  ASSIGN_OR_RETURN(
      SqlStatement keypoints,
      db->Prepare("INSERT INTO keypoints VALUES (?1, ?2, ?3, ?4)"));
  ASSIGN_OR_RETURN(
      SqlStatement descriptors,
      db->Prepare("INSERT INTO descriptors VALUES (?1, ?2, ?3, ?4)"));
  static_assert(sizeof(Eigen::Vector2f) == 2 * sizeof(float));
  for (std::size_t i = 0; i < data.views.size(); ++i) {
    const map::MapViewData& view = data.views[i];
    const std::int64_t id = static_cast<std::int64_t>(i) + 1;
    image.Bind(1, id);
    image.BindText(2, view.name);
    image.Bind(3, std::int64_t{view.camera} + 1);
    RETURN_IF_ERROR(base::Annotate(image.RunOnce(), "image " + view.name));
    RETURN_IF_ERROR(InsertMatrix(
        id,
        view.keypoints_px.size(),
        2,
        BytesOf(view.keypoints_px.data(), view.keypoints_px.size()),
        &keypoints));
    RETURN_IF_ERROR(
        InsertMatrix(id,
                     view.descriptors.size(),
                     128,
                     BytesOf(view.descriptors.data(), view.descriptors.size()),
                     &descriptors));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status WriteColmapDatabase(const map::MapData& data,
                                 const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(SqlDatabase db, SqlDatabase::CreateNew(path));
  RETURN_IF_ERROR(db.Execute("BEGIN"));
  RETURN_IF_ERROR(db.Execute(kColmapSchema));
  RETURN_IF_ERROR(InsertCameras(data, &db));
  RETURN_IF_ERROR(InsertViews(data, &db));
  return db.Execute("COMMIT");
}

}  // namespace groundlock::formats::internal
