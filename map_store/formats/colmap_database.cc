// SPDX-License-Identifier: Apache-2.0
// COLMAP's database.db: where its SIFT descriptors are.
// Source: COLMAP's documentation, "Database Format".
#include <cstring>

#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/sqlite.h"

namespace groundlock::formats::internal {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kDescriptorBytes = 128;

// The blob of a rows x cols matrix; kInvalidArgument (without the image) if its
// size says otherwise.
absl::Status CheckMatrix(std::int64_t rows,
                         std::int64_t cols,
                         std::int64_t item_bytes,
                         std::size_t blob_bytes) {
  constexpr std::int64_t kMaxRows = 1 << 28;
  if (rows < 0 || rows > kMaxRows || cols < 0 || cols > 1'024 ||
      static_cast<std::size_t>(rows * cols * item_bytes) != blob_bytes) {
    return absl::InvalidArgumentError(absl::StrCat(
        rows, " x ", cols, " announced, but ", blob_bytes, " bytes are there"));
  }
  return absl::OkStatus();
}

// The statements that run once per view.
struct Queries {
  SqlStatement image_id;     // name -> image_id
  SqlStatement keypoints;    // image_id -> rows, cols, bytes
  SqlStatement descriptors;  // image_id -> rows, cols, data
};

absl::StatusOr<Queries> PrepareQueries(SqlDatabase* db) {
  for (const char* table : {"images", "keypoints", "descriptors"}) {
    ASSIGN_OR_RETURN(const bool there, db->HasTable(table));
    if (!there) {
      return absl::InvalidArgumentError(
          absl::StrCat("no table ", table, ": not COLMAP's database"));
    }
  }
  ASSIGN_OR_RETURN(SqlStatement image_id,
                   db->Prepare("SELECT image_id FROM images WHERE name = ?1"));
  ASSIGN_OR_RETURN(SqlStatement keypoints,
                   db->Prepare("SELECT rows, cols, length(data) FROM keypoints "
                               "WHERE image_id = ?1"));
  ASSIGN_OR_RETURN(SqlStatement descriptors,
                   db->Prepare("SELECT rows, cols, data FROM descriptors "
                               "WHERE image_id = ?1"));
  return Queries{
      std::move(image_id), std::move(keypoints), std::move(descriptors)};
}

// False if the database does not know the image or has as many keypoints as
// the model has 2D points. Errors are damage.
absl::StatusOr<bool> HasSameKeypoints(std::int64_t image_id,
                                      std::uint64_t num_features,
                                      Queries* queries) {
  SqlStatement& keypoints = queries->keypoints;
  RETURN_IF_ERROR(keypoints.Reset());
  keypoints.Bind(1, image_id);
  ASSIGN_OR_RETURN(const bool there, keypoints.Step());
  if (!there) return false;
  const std::int64_t rows = keypoints.Int(0);
  const std::int64_t cols = keypoints.Int(1);
  RETURN_IF_ERROR(
      base::Annotate(CheckMatrix(rows,
                                 cols,
                                 sizeof(float),
                                 static_cast<std::size_t>(keypoints.Int(2))),
                     "keypoints"));
  if (rows > 0 && cols != 2 && cols != 4 && cols != 6) {
    return absl::InvalidArgumentError(
        absl::StrCat("keypoints have ", cols, " columns, expected 2, 4 or 6"));
  }
  return static_cast<std::uint64_t>(rows) == num_features;
}

// Fills in view->descriptors; false if the database has none that match.
absl::StatusOr<bool> ReadView(const FeatureOrigin& origin,
                              Queries* queries,
                              map::MapViewData* view) {
  RETURN_IF_ERROR(queries->image_id.Reset());
  queries->image_id.BindText(1, view->name);
  ASSIGN_OR_RETURN(const bool known, queries->image_id.Step());
  if (!known) return false;
  const std::int64_t image_id = queries->image_id.Int(0);
  ASSIGN_OR_RETURN(const bool same,
                   HasSameKeypoints(image_id, origin.num_features, queries));
  if (!same) return false;

  SqlStatement& descriptors = queries->descriptors;
  RETURN_IF_ERROR(descriptors.Reset());
  descriptors.Bind(1, image_id);
  ASSIGN_OR_RETURN(const bool there, descriptors.Step());
  if (!there) return false;
  const std::int64_t rows = descriptors.Int(0);
  const std::int64_t cols = descriptors.Int(1);
  const std::string_view data = descriptors.Blob(2);
  RETURN_IF_ERROR(
      base::Annotate(CheckMatrix(rows, cols, 1, data.size()), "descriptors"));
  if (rows > 0 && cols != kDescriptorBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("descriptors have ", cols, " bytes, SIFT has 128"));
  }
  if (static_cast<std::uint64_t>(rows) != origin.num_features) return false;
  view->descriptors.resize(origin.index.size());
  for (std::size_t i = 0; i < origin.index.size(); ++i) {
    std::memcpy(view->descriptors[i].data(),
                data.data() + std::size_t{origin.index[i]} * kDescriptorBytes,
                kDescriptorBytes);
  }
  return true;
}

}  // namespace

absl::Status ReadColmapDescriptors(const fs::path& database,
                                   LinkedModel* linked,
                                   std::vector<std::string>* lacking) {
  ASSIGN_OR_RETURN(SqlDatabase db, SqlDatabase::OpenUntrusted(database));
  auto queries = PrepareQueries(&db);
  if (!queries.ok()) {
    return base::Annotate(queries.status(), database.string());
  }
  for (std::size_t i = 0; i < linked->data.views.size(); ++i) {
    map::MapViewData& view = linked->data.views[i];
    if (view.landmarks.empty()) continue;
    const auto found = ReadView(linked->origins[i], &*queries, &view);
    if (!found.ok()) {
      return base::Annotate(
          found.status(),
          absl::StrCat(database.string(), ": image ", view.name));
    }
    if (!*found) lacking->push_back(view.name);
  }
  return absl::OkStatus();
}

}  // namespace groundlock::formats::internal
