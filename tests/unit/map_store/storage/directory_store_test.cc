// SPDX-License-Identifier: Apache-2.0
// What lies in the folder of a directory store.
#include <gmock/gmock.h>
#include <sqlite3.h>

#include <fstream>

#include "map_store/storage/store.h"
#include "tests/unit/map_store/map/synthetic_map.h"
#include "tests/unit/map_store/storage/store_fixture.h"

namespace groundlock::storage {
namespace {

namespace fs = std::filesystem;
using map::testing_map::MakeMapData;
using testing::HasSubstr;

class DirectoryStoreTest : public StoreFixture {
 protected:
  void SetUp() override {
    MakeDirectory();
    root_ = location_;
  }
  void Execute(const char* sql) const {
    sqlite3* database = nullptr;
    ASSERT_EQ(sqlite3_open((root_ / "catalogue.sqlite").c_str(), &database),
              SQLITE_OK);
    char* message = nullptr;
    EXPECT_EQ(sqlite3_exec(database, sql, nullptr, nullptr, &message),
              SQLITE_OK)
        << message;
    sqlite3_free(message);
    sqlite3_close(database);
  }

  fs::path root_;
};

TEST_F(DirectoryStoreTest, FilesGoWithTheirRows) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  EXPECT_EQ(NumEntries(root_ / "maps"), 2U);
  ASSERT_TRUE(store->CollectGarbage(1).ok());
  EXPECT_EQ(NumEntries(root_ / "maps"), 1U);
  const auto map = store->Open("yard");
  ASSERT_TRUE(store->Delete("yard").ok());
  EXPECT_EQ(NumEntries(root_ / "maps"), 0U);
}

TEST_F(DirectoryStoreTest, SweepsWhatCrashesLeaveAndNothingElse) {
  ASSERT_TRUE(OpenOrDie()->Publish("yard", MakeMapData()).ok());
  std::ofstream(root_ / "maps/yard.2.glmap") << "renamed, not committed";
  std::ofstream(root_ / "maps/notes.txt") << "the user's own";
  const auto store = OpenOrDie();
  EXPECT_FALSE(fs::exists(root_ / "maps/yard.2.glmap"));
  EXPECT_TRUE(fs::exists(root_ / "maps/notes.txt"));
  EXPECT_TRUE(store->Open("yard").ok());
  EXPECT_EQ(store->Publish("yard", MakeMapData())->version, 2U);
}

TEST_F(DirectoryStoreTest, NamesAForeignNewerOrDamagedCatalogue) {
  OpenOrDie();
  Execute("PRAGMA user_version = 99");
  const absl::Status newer = OpenStore(location_).status();
  EXPECT_EQ(newer.code(), absl::StatusCode::kUnimplemented);
  EXPECT_THAT(std::string(newer.message()), HasSubstr("schema version 99"));
  EXPECT_THAT(std::string(newer.message()), HasSubstr(location_));
  Execute("PRAGMA application_id = 1");
  EXPECT_EQ(OpenStore(location_).status().code(),
            absl::StatusCode::kFailedPrecondition);
  std::ofstream(root_ / "catalogue.sqlite", std::ios::trunc)
      << std::string(5000, 'x');
  EXPECT_EQ(OpenStore(location_).status().code(), absl::StatusCode::kDataLoss);
}

TEST_F(DirectoryStoreTest, BringsACatalogueOfVersion1UpToDate) {
  MapVersion published;
  {
    auto store = OpenOrDie();
    ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
    published = *store->Publish("yard", MakeMapData({.seed = 2}));
  }
  // The tables as version 1 had them, with the rows that are there.
  Execute(R"sql(
ALTER TABLE maps RENAME TO now;
CREATE TABLE maps (
  name TEXT NOT NULL, version INTEGER NOT NULL, file TEXT NOT NULL UNIQUE,
  created_ns INTEGER NOT NULL, content_hash TEXT NOT NULL,
  source_format TEXT NOT NULL, metric INTEGER NOT NULL,
  num_cameras INTEGER NOT NULL, num_views INTEGER NOT NULL,
  num_landmarks INTEGER NOT NULL, num_observations INTEGER NOT NULL,
  has_descriptors INTEGER NOT NULL, file_bytes INTEGER NOT NULL,
  mean_reprojection_error_px REAL NOT NULL, scale REAL NOT NULL,
  qx REAL NOT NULL, qy REAL NOT NULL, qz REAL NOT NULL, qw REAL NOT NULL,
  tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL,
  ground_nx REAL NOT NULL, ground_ny REAL NOT NULL, ground_nz REAL NOT NULL,
  ground_d REAL NOT NULL, PRIMARY KEY (name, version)
) WITHOUT ROWID;
INSERT INTO maps SELECT name, version, file, created_ns,
  info ->> 'content_hash', info ->> 'source_format', info ->> 'metric',
  info ->> 'num_cameras', info ->> 'num_views', info ->> 'num_landmarks',
  info ->> 'num_observations', info ->> 'has_descriptors',
  info ->> 'file_bytes', info ->> 'mean_reprojection_error_px', 0.25,
  0.5, 0.5, 0.5, 0.5, 1.5, -2.5, 3.5, 0, 0, 1, -0.125 FROM now;
DROP TABLE now;
PRAGMA user_version = 1;
)sql");
  const auto store = OpenOrDie();
  ASSERT_NE(store, nullptr);
  ASSERT_EQ(store->ListVersions("yard")->size(), 2U);
  const auto entry = store->Get("yard");
  ASSERT_TRUE(entry.ok()) << entry.status();
  EXPECT_EQ(entry->version, 2U);
  EXPECT_EQ(entry->created, published.created);
  EXPECT_EQ(entry->info.content_hash, published.info.content_hash);
  EXPECT_EQ(entry->info.source_format, "synthetic");
  EXPECT_TRUE(entry->info.metric);
  EXPECT_EQ(entry->info.num_observations, published.info.num_observations);
  EXPECT_EQ(entry->info.file_bytes, published.info.file_bytes);
  EXPECT_EQ(entry->info.mean_reprojection_error_px,
            published.info.mean_reprojection_error_px);
  EXPECT_EQ(entry->info.world_from_source.scale, 0.25);
  EXPECT_EQ(entry->info.world_from_source.rotation.w(), 0.5);
  EXPECT_EQ(entry->info.world_from_source.translation,
            Eigen::Vector3d(1.5, -2.5, 3.5));
  EXPECT_EQ(entry->info.ground_world.d, -0.125);
  EXPECT_TRUE(store->Check("yard", 1).ok());
  EXPECT_EQ(store->Publish("yard", MakeMapData())->version, 3U);
}

TEST_F(DirectoryStoreTest, ADamagedRowIsNamed) {
  ASSERT_TRUE(OpenOrDie()->Publish("yard", MakeMapData()).ok());
  Execute("UPDATE maps SET info = json_remove(info, '$.num_views')");
  const absl::Status status = OpenOrDie()->Get("yard").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
  EXPECT_THAT(std::string(status.message()), HasSubstr("num_views"));
  EXPECT_THAT(std::string(status.message()), HasSubstr("yard.1.glmap"));
}

TEST_F(DirectoryStoreTest, LeavesForeignFoldersAlone) {
  fs::create_directories(root_ / "maps");
  std::ofstream(root_ / "maps/old.glmap") << "precious";
  EXPECT_EQ(OpenStore(location_).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_TRUE(fs::exists(root_ / "maps/old.glmap"));
  const fs::path file = directory_->path() / "file";
  std::ofstream(file) << "x";
  EXPECT_FALSE(OpenStore(file.string()).ok());
  EXPECT_FALSE(OpenStore("").ok());
  EXPECT_EQ(OpenStore("mysql://host/db").status().code(),
            absl::StatusCode::kUnimplemented);
}

TEST_F(DirectoryStoreTest, DamagedOrExchangedMapFilesAreNamed) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("a", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("b", MakeMapData({.seed = 2})).ok());
  ASSERT_TRUE(store->Publish("c", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("d", MakeMapData()).ok());
  fs::copy_file(root_ / "maps/a.1.glmap",
                root_ / "maps/b.1.glmap",
                fs::copy_options::overwrite_existing);
  EXPECT_EQ(store->Open("b").status().code(), absl::StatusCode::kDataLoss);
  fs::resize_file(root_ / "maps/a.1.glmap", 5000);
  EXPECT_EQ(store->Open("a").status().code(), absl::StatusCode::kDataLoss);
  fs::remove(root_ / "maps/c.1.glmap");
  EXPECT_EQ(store->Open("c").status().code(), absl::StatusCode::kDataLoss);
  // A byte of the content: opening reads only the header, a check everything.
  std::fstream d(root_ / "maps/d.1.glmap",
                 std::ios::in | std::ios::out | std::ios::binary);
  d.seekp(12'345);
  d.put(static_cast<char>(d.peek() ^ 1));
  d.close();
  EXPECT_TRUE(store->Open("d").ok());
  EXPECT_EQ(store->Check("d").code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(store->List()->size(), 4U);  // the others can still be seen
}

}  // namespace
}  // namespace groundlock::storage
