// SPDX-License-Identifier: Apache-2.0
// What every store does, whatever keeps the maps.
#include "map_store/storage/store.h"

#include <gmock/gmock.h>

#include <atomic>
#include <fstream>
#include <thread>

#include "tests/unit/map_store/map/synthetic_map.h"
#include "tests/unit/map_store/storage/store_fixture.h"

namespace groundlock::storage {
namespace {

using map::testing_map::MakeMapData;
using testing::HasSubstr;

INSTANTIATE_TEST_SUITE_P(Stores,
                         StoreTest,
                         testing::Values(Backend::kDirectory,
                                         Backend::kPostgres),
                         [](const auto& backend) {
                           return backend.param == Backend::kDirectory
                                      ? "Directory"
                                      : "Postgres";
                         });

TEST_P(StoreTest, PublishesVersionsAndListsTheNewest) {
  const auto store = OpenOrDie();
  EXPECT_TRUE(store->List()->empty());
  const auto first = store->Publish("yard", MakeMapData());
  ASSERT_TRUE(first.ok()) << first.status();
  EXPECT_EQ(first->version, 1U);
  const auto second = store->Publish("yard", MakeMapData({.seed = 2}));
  ASSERT_TRUE(second.ok()) << second.status();
  EXPECT_EQ(second->version, 2U);
  ASSERT_TRUE(store->Publish("alley", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("Zoo", MakeMapData()).ok());

  // By the bytes of the names, as the API's pages need it.
  const auto list = store->List();
  ASSERT_TRUE(list.ok()) << list.status();
  ASSERT_EQ(list->size(), 3U);
  EXPECT_EQ((*list)[0].name, "Zoo");
  EXPECT_EQ((*list)[1].name, "alley");
  EXPECT_EQ((*list)[2].name, "yard");
  EXPECT_EQ((*list)[2].version, 2U);

  EXPECT_EQ(store->Get("yard")->info.content_hash, second->info.content_hash);
  EXPECT_EQ(store->Get("yard", 1)->info.content_hash, first->info.content_hash);
  EXPECT_EQ(store->Get("yard", 3).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store->Get("none").status().code(), absl::StatusCode::kNotFound);
  const auto versions = store->ListVersions("yard");
  ASSERT_TRUE(versions.ok()) << versions.status();
  ASSERT_EQ(versions->size(), 2U);
  EXPECT_EQ((*versions)[0].version, 2U);
  EXPECT_EQ((*versions)[1].info.content_hash, first->info.content_hash);
  EXPECT_EQ(store->ListVersions("none").status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(NumEntries(Staging()), 0U);
}

TEST_P(StoreTest, CatalogueGivesTheInfoOfTheFile) {
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

TEST_P(StoreTest, OpensOnceAndSharesAcrossHolders) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  const auto a = store->Open("yard");
  const auto b = store->Open("yard", 1);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(a->get(), b->get());
}

TEST_P(StoreTest, DeletedMapsLiveOnWithTheirHolders) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  const auto map = store->Open("yard", 1);
  ASSERT_TRUE(map.ok());
  ASSERT_TRUE(store->Delete("yard").ok());
  EXPECT_TRUE((*map)->Verify().ok());
  EXPECT_EQ(store->Open("yard").status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(store->Delete("yard").code(), absl::StatusCode::kNotFound);
  // A version number never means two different maps.
  EXPECT_EQ(store->Publish("yard", MakeMapData())->version, 3U);
  EXPECT_EQ(store->Open("yard", 1).status().code(),
            absl::StatusCode::kNotFound);
}

TEST_P(StoreTest, SurvivesReopening) {
  ASSERT_TRUE(OpenOrDie()->Publish("yard", MakeMapData()).ok());
  const auto store = OpenOrDie();
  const auto map = store->Open("yard");
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok());
  EXPECT_TRUE(store->Check("yard").ok()) << store->Check("yard");
  EXPECT_EQ(store->Check("yard", 2).code(), absl::StatusCode::kNotFound);
}

TEST_P(StoreTest, RefusesBadNamesAndBadMaps) {
  const auto store = OpenOrDie();
  for (const char* name :
       {"", ".", "..", ".a", "-a", "a/b", "a b", "ä", "a\n", "a'b"}) {
    EXPECT_EQ(store->Publish(name, MakeMapData()).status().code(),
              absl::StatusCode::kInvalidArgument)
        << name;
    EXPECT_EQ(store->Get(name).status().code(),
              absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(store->Delete(name).code(), absl::StatusCode::kInvalidArgument);
  }
  EXPECT_TRUE(ValidateMapName(std::string(64, 'a')).ok());
  EXPECT_FALSE(ValidateMapName(std::string(65, 'a')).ok());
  map::MapData bad = MakeMapData();
  bad.views[0].camera = 5;
  EXPECT_EQ(store->Publish("yard", bad).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_TRUE(store->List()->empty());
  EXPECT_EQ(NumEntries(Staging()), 0U);
}

TEST_P(StoreTest, TwoServersSeeEachOthersMaps) {
  const auto a = OpenOrDie(0);
  const auto b = OpenOrDie(1);
  ASSERT_TRUE(a->Publish("yard", MakeMapData()).ok());
  const auto at_b = b->Open("yard");
  ASSERT_TRUE(at_b.ok()) << at_b.status();
  EXPECT_TRUE((*at_b)->Verify().ok());
  EXPECT_EQ(b->Publish("yard", MakeMapData({.seed = 2}))->version, 2U);
  EXPECT_EQ(a->Get("yard")->version, 2U);
  EXPECT_EQ((*a->Open("yard"))->info().content_hash,
            b->Get("yard")->info.content_hash);
  ASSERT_TRUE(a->Delete("yard").ok());
  EXPECT_EQ(b->Get("yard").status().code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE((*at_b)->Verify().ok());  // whoever had it has it still
}

TEST_P(StoreTest, GarbageIsWhatIsOldAndUnused) {
  const auto store = OpenOrDie();
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    ASSERT_TRUE(store->Publish("yard", MakeMapData({.seed = seed})).ok());
  }
  ASSERT_TRUE(store->Publish("alley", MakeMapData()).ok());
  const auto all = store->CollectGarbage(0);
  ASSERT_TRUE(all.ok()) << all.status();
  EXPECT_EQ(all->num_removed, 0U);
  EXPECT_EQ(all->num_maps, 2U);
  EXPECT_EQ(all->num_versions, 6U);

  // One is open here, another at another server.
  const auto other = OpenOrDie(1);
  auto here = store->Open("yard", 2);
  auto there = other->Open("yard", 3);
  ASSERT_TRUE(here.ok() && there.ok()) << here.status() << there.status();
  auto report = store->CollectGarbage(2);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->num_removed, 1U);
  EXPECT_EQ(report->num_in_use, 2U);
  EXPECT_EQ(report->num_versions, 5U);
  EXPECT_EQ(store->Stats().maps_open, 1U);
  EXPECT_EQ(store->Get("yard", 1).status().code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(store->Open("yard", 2).ok());
  EXPECT_TRUE(other->Open("yard", 2).ok());  // by its number, as long as it is

  here = absl::UnknownError("let go");
  there = absl::UnknownError("let go");
  // Whoever had them open tells so when it looks after the store itself.
  ASSERT_TRUE(other->CollectGarbage(0).ok());
  report = store->CollectGarbage(2);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->num_removed, 2U);
  EXPECT_EQ(report->num_in_use, 0U);
  EXPECT_EQ(store->ListVersions("yard")->size(), 2U);
  EXPECT_TRUE(store->Check("yard", 4).ok());
  EXPECT_TRUE(store->Check("yard", 5).ok());
  EXPECT_TRUE(store->Check("alley").ok());
  EXPECT_EQ(store->Publish("yard", MakeMapData())->version, 6U);
}

TEST_P(StoreTest, AMapThatIsNoLongerWantedIsNotPublished) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  const auto unwanted = store->Publish("yard", MakeMapData({.seed = 2}), [] {
    return absl::CancelledError("gone");
  });
  EXPECT_EQ(unwanted.status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(store->Get("yard")->version, 1U);
  EXPECT_EQ(store->ListVersions("yard")->size(), 1U);
}

TEST_P(StoreTest, ThreadsAndStoresPublishAtOnce) {
  constexpr int kThreads = 4;
  constexpr int kMaps = 5;
  const auto shared = OpenOrDie();
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      // Half of them through a store of their own, as another process has it.
      std::unique_ptr<Store> own;
      if (t % 2 == 1) own = OpenOrDie(t);
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
  EXPECT_EQ(shared->ListVersions("yard")->size(),
            std::size_t{kThreads * kMaps});
  EXPECT_EQ(NumEntries(Staging()), 0U);
}

// Sessions start all the time while versions land and old ones go.
TEST_P(StoreTest, ReadersGoOnWhileVersionsLand) {
  const auto writer = OpenOrDie(0);
  const auto reader = OpenOrDie(1);
  ASSERT_TRUE(writer->Publish("yard", MakeMapData()).ok());
  std::atomic<bool> done = false;
  std::atomic<int> num_opened = 0;
  std::vector<std::thread> readers;
  for (int t = 0; t < 3; ++t) {
    readers.emplace_back([&, t] {
      Store& store = t == 0 ? *writer : *reader;
      std::uint64_t last = 0;
      while (!done) {
        const auto map = store.Open("yard");
        ASSERT_TRUE(map.ok()) << map.status();
        EXPECT_TRUE((*map)->Verify().ok());
        const auto newest = store.Get("yard");
        ASSERT_TRUE(newest.ok()) << newest.status();
        EXPECT_GE(newest->version, last);  // never back in time
        last = newest->version;
        ++num_opened;
      }
    });
  }
  for (std::uint64_t seed = 2; seed <= 12; ++seed) {
    EXPECT_TRUE(
        writer->Publish("yard", MakeMapData({.num_ground = 60, .seed = seed}))
            .ok());
    const auto report = writer->CollectGarbage(1);
    EXPECT_TRUE(report.ok()) << report.status();
  }
  while (num_opened < 3) std::this_thread::yield();
  done = true;
  for (std::thread& thread : readers) thread.join();
  EXPECT_EQ(writer->Get("yard")->version, 12U);
}

TEST_P(StoreTest, SweepsWhatDeadImportsLeaveAndNothingElse) {
  ASSERT_TRUE(OpenOrDie()->Publish("yard", MakeMapData()).ok());
  std::filesystem::create_directory(Staging() / ".tmp-abc123");
  std::ofstream(Staging() / ".tmp-abc123/map.glmap.tmp-x") << "half";
  std::ofstream(Staging() / "notes.txt") << "the user's own";
  const auto store = OpenOrDie();
  EXPECT_FALSE(std::filesystem::exists(Staging() / ".tmp-abc123"));
  EXPECT_TRUE(std::filesystem::exists(Staging() / "notes.txt"));
  EXPECT_TRUE(store->Check("yard").ok());
}

// An import in progress in another process is not swept away.
TEST_P(StoreTest, OpeningSparesImportsInProgress) {
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

TEST_P(StoreTest, SaysWhereItIs) {
  EXPECT_THAT(OpenOrDie()->Description(),
              HasSubstr(GetParam() == Backend::kDirectory
                            ? directory_->path().string()
                            : "PostgreSQL database 'store"));
}

}  // namespace
}  // namespace groundlock::storage
