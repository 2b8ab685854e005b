// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sqlite3.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <fstream>
#include <thread>

#include "map_store/base/file.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::storage {
namespace {

namespace fs = std::filesystem;
using map::testing_map::MakeMapData;
using testing::HasSubstr;

class StoreTest : public testing::Test {
 protected:
  void SetUp() override {
    auto made = base::TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(made.ok()) << made.status();
    directory_.emplace(*std::move(made));
    root_ = directory_->path() / "store";
  }
  std::unique_ptr<Store> OpenOrDie() const {
    auto store = OpenStore(root_.string());
    EXPECT_TRUE(store.ok()) << store.status();
    return store.ok() ? *std::move(store) : nullptr;
  }
  static std::size_t NumEntries(const fs::path& folder) {
    return static_cast<std::size_t>(std::distance(
        fs::directory_iterator(folder), fs::directory_iterator()));
  }
  void Execute(const char* sql) const {
    sqlite3* database = nullptr;
    ASSERT_EQ(sqlite3_open((root_ / "catalogue.sqlite").c_str(), &database),
              SQLITE_OK);
    EXPECT_EQ(sqlite3_exec(database, sql, nullptr, nullptr, nullptr),
              SQLITE_OK);
    sqlite3_close(database);
  }

  std::optional<base::TemporaryDirectory> directory_;
  fs::path root_;
};

TEST_F(StoreTest, PublishesVersionsAndListsTheNewest) {
  const auto store = OpenOrDie();
  const auto first = store->Publish("yard", MakeMapData());
  ASSERT_TRUE(first.ok()) << first.status();
  EXPECT_EQ(first->version, 1U);
  const auto second = store->Publish("yard", MakeMapData({.seed = 2}));
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ(second->version, 2U);
  ASSERT_TRUE(store->Publish("alley", MakeMapData()).ok());

  const auto list = store->List();
  ASSERT_TRUE(list.ok()) << list.status();
  ASSERT_EQ(list->size(), 2U);
  EXPECT_EQ((*list)[0].name, "alley");
  EXPECT_EQ((*list)[1].name, "yard");
  EXPECT_EQ((*list)[1].version, 2U);

  EXPECT_EQ(store->Get("yard")->info.content_hash, second->info.content_hash);
  EXPECT_EQ(store->Get("yard", 1)->info.content_hash, first->info.content_hash);
  EXPECT_EQ(store->Get("yard", 3).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store->Get("none").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(NumEntries(root_ / "imports"), 0U);
}

TEST_F(StoreTest, CatalogueGivesTheInfoOfTheFile) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  const auto entry = store->Get("yard");
  const auto map = store->Open("yard");
  ASSERT_TRUE(entry.ok() && map.ok()) << entry.status() << map.status();
  const map::MapInfo& a = entry->info;
  const map::MapInfo& b = (*map)->info();
  EXPECT_EQ(a.content_hash, b.content_hash);
  EXPECT_EQ(a.source_format, b.source_format);
  EXPECT_EQ(a.metric, b.metric);
  EXPECT_EQ(a.num_cameras, b.num_cameras);
  EXPECT_EQ(a.num_views, b.num_views);
  EXPECT_EQ(a.num_landmarks, b.num_landmarks);
  EXPECT_EQ(a.num_observations, b.num_observations);
  EXPECT_EQ(a.has_descriptors, b.has_descriptors);
  EXPECT_EQ(a.file_bytes, b.file_bytes);
  EXPECT_EQ(a.mean_reprojection_error_px, b.mean_reprojection_error_px);
  EXPECT_EQ(a.world_from_source.scale, b.world_from_source.scale);
  EXPECT_EQ(a.world_from_source.rotation.coeffs(),
            b.world_from_source.rotation.coeffs());
  EXPECT_EQ(a.world_from_source.translation, b.world_from_source.translation);
  EXPECT_EQ(a.ground_world.normal, b.ground_world.normal);
  EXPECT_EQ(a.ground_world.d, b.ground_world.d);
  EXPECT_LT(std::chrono::system_clock::now() - entry->created,
            std::chrono::minutes(5));
}

TEST_F(StoreTest, OpensOnceAndSharesAcrossHolders) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  const auto a = store->Open("yard");
  const auto b = store->Open("yard", 1);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(a->get(), b->get());
}

TEST_F(StoreTest, DeletedMapsLiveOnWithTheirHolders) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  const auto map = store->Open("yard", 1);
  ASSERT_TRUE(map.ok());
  ASSERT_TRUE(store->Delete("yard").ok());
  EXPECT_EQ(NumEntries(root_ / "maps"), 0U);
  EXPECT_TRUE((*map)->Verify().ok());
  EXPECT_EQ(store->Open("yard").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store->Delete("yard").code(), absl::StatusCode::kNotFound);
  // A version number never means two different maps.
  EXPECT_EQ(store->Publish("yard", MakeMapData())->version, 3U);
}

TEST_F(StoreTest, SurvivesReopening) {
  ASSERT_TRUE(OpenOrDie()->Publish("yard", MakeMapData()).ok());
  const auto store = OpenOrDie();
  const auto map = store->Open("yard");
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok());
}

TEST_F(StoreTest, RefusesBadNamesAndBadMaps) {
  const auto store = OpenOrDie();
  for (const char* name :
       {"", ".", "..", ".a", "-a", "a/b", "a b", "ä", "a\n"}) {
    EXPECT_EQ(store->Publish(name, MakeMapData()).status().code(),
              absl::StatusCode::kInvalidArgument)
        << name;
    EXPECT_EQ(store->Get(name).status().code(),
              absl::StatusCode::kInvalidArgument);
  }
  EXPECT_TRUE(ValidateMapName(std::string(64, 'a')).ok());
  EXPECT_FALSE(ValidateMapName(std::string(65, 'a')).ok());
  map::MapData bad = MakeMapData();
  bad.views[0].camera = 5;
  EXPECT_EQ(store->Publish("yard", bad).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_TRUE(store->List()->empty());
  EXPECT_EQ(NumEntries(root_ / "imports"), 0U);
  EXPECT_EQ(NumEntries(root_ / "maps"), 0U);
}

TEST_F(StoreTest, SweepsWhatCrashesLeaveAndNothingElse) {
  ASSERT_TRUE(OpenOrDie()->Publish("yard", MakeMapData()).ok());
  fs::create_directory(root_ / "imports/.tmp-abc123");
  std::ofstream(root_ / "imports/.tmp-abc123/map.glmap.tmp-x") << "half";
  std::ofstream(root_ / "maps/yard.2.glmap") << "renamed, not committed";
  std::ofstream(root_ / "maps/notes.txt") << "the user's own";
  const auto store = OpenOrDie();
  EXPECT_EQ(NumEntries(root_ / "imports"), 0U);
  EXPECT_FALSE(fs::exists(root_ / "maps/yard.2.glmap"));
  EXPECT_TRUE(fs::exists(root_ / "maps/notes.txt"));
  EXPECT_TRUE(store->Open("yard").ok());
  EXPECT_EQ(store->Publish("yard", MakeMapData())->version, 2U);
}

TEST_F(StoreTest, NamesAForeignNewerOrDamagedCatalogue) {
  OpenOrDie();
  Execute("PRAGMA user_version = 99");
  EXPECT_EQ(OpenStore(root_.string()).status().code(),
            absl::StatusCode::kUnimplemented);
  EXPECT_THAT(std::string(OpenStore(root_.string()).status().message()),
              HasSubstr("99"));
  Execute("PRAGMA application_id = 1");
  EXPECT_EQ(OpenStore(root_.string()).status().code(),
            absl::StatusCode::kFailedPrecondition);
  std::ofstream(root_ / "catalogue.sqlite", std::ios::trunc)
      << std::string(5000, 'x');
  EXPECT_EQ(OpenStore(root_.string()).status().code(),
            absl::StatusCode::kDataLoss);
}

TEST_F(StoreTest, LeavesForeignFoldersAlone) {
  fs::create_directories(root_ / "maps");
  std::ofstream(root_ / "maps/old.glmap") << "precious";
  EXPECT_EQ(OpenStore(root_.string()).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_TRUE(fs::exists(root_ / "maps/old.glmap"));
  const fs::path file = directory_->path() / "file";
  std::ofstream(file) << "x";
  EXPECT_FALSE(OpenStore(file.string()).ok());
  EXPECT_FALSE(OpenStore("").ok());
  EXPECT_EQ(OpenStore("postgresql://host/db").status().code(),
            absl::StatusCode::kUnimplemented);
}

TEST_F(StoreTest, DamagedOrExchangedMapFilesAreNamed) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("a", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("b", MakeMapData({.seed = 2})).ok());
  ASSERT_TRUE(store->Publish("c", MakeMapData()).ok());
  fs::copy_file(root_ / "maps/a.1.glmap",
                root_ / "maps/b.1.glmap",
                fs::copy_options::overwrite_existing);
  EXPECT_EQ(store->Open("b").status().code(), absl::StatusCode::kDataLoss);
  fs::resize_file(root_ / "maps/a.1.glmap", 5000);
  EXPECT_EQ(store->Open("a").status().code(), absl::StatusCode::kDataLoss);
  fs::remove(root_ / "maps/c.1.glmap");
  EXPECT_EQ(store->Open("c").status().code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(store->List()->size(), 3U);  // the others can still be seen
}

TEST_F(StoreTest, ThreadsAndStoresPublishAtOnce) {
  constexpr int kThreads = 4;
  constexpr int kMaps = 5;
  const auto shared = OpenOrDie();
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      // Half of them through a store of their own, as another process has it.
      std::unique_ptr<Store> own;
      if (t % 2 == 1) own = OpenOrDie();
      Store& store = own != nullptr ? *own : *shared;
      for (int i = 0; i < kMaps; ++i) {
        const auto published = store.Publish(
            "yard", MakeMapData({.num_ground = 40, .num_wall = 10}));
        EXPECT_TRUE(published.ok()) << published.status();
        EXPECT_TRUE(store.Open("yard").ok());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(shared->Get("yard")->version, std::uint64_t{kThreads * kMaps});
  EXPECT_EQ(NumEntries(root_ / "maps"), std::size_t{kThreads * kMaps});
  EXPECT_EQ(NumEntries(root_ / "imports"), 0U);
}

// A process that publishes without end is killed at arbitrary moments while
// others open the store: what the catalogue lists is always whole.
TEST_F(StoreTest, KilledAtAnyMomentLeavesAConsistentStore) {
  OpenOrDie();
  std::uint64_t last_version = 0;
  for (int round = 0; round < 8; ++round) {
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      const auto store = OpenStore(root_.string());
      if (!store.ok()) _exit(1);
      const map::MapData data = MakeMapData({.num_ground = 60, .num_wall = 0});
      for (;;) {
        if (!(*store)->Publish("yard", data).ok()) _exit(1);
      }
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(37 + 29 * round));
    kill(child, SIGKILL);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status)) << "publishing failed";

    const auto store = OpenOrDie();
    ASSERT_NE(store, nullptr);
    EXPECT_EQ(NumEntries(root_ / "imports"), 0U);
    const auto newest = store->Get("yard");
    if (!newest.ok()) {
      EXPECT_EQ(NumEntries(root_ / "maps"), 0U);
      continue;
    }
    EXPECT_GE(newest->version, last_version);
    last_version = newest->version;
    EXPECT_EQ(NumEntries(root_ / "maps"), last_version);
    for (std::uint64_t v = 1; v <= last_version; ++v) {
      const auto map = store->Open("yard", v);
      ASSERT_TRUE(map.ok()) << map.status();
      EXPECT_TRUE((*map)->Verify().ok()) << (*map)->Verify();
    }
  }
  EXPECT_GT(last_version, 0U) << "no child got as far as publishing";
}

// An import in progress in another process is not swept away.
TEST_F(StoreTest, OpeningSparesImportsInProgress) {
  const auto store = OpenOrDie();
  std::atomic<bool> done = false;
  std::thread opener([&] {
    while (!done) OpenOrDie();
  });
  for (int i = 0; i < 10; ++i) {
    const auto published = store->Publish("yard", MakeMapData());
    EXPECT_TRUE(published.ok()) << published.status();
  }
  done = true;
  opener.join();
}

}  // namespace
}  // namespace groundlock::storage
