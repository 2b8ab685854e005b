// SPDX-License-Identifier: Apache-2.0
#include "map_store/storage/internal/map_cache.h"

#include <gmock/gmock.h>

#include <atomic>
#include <fstream>
#include <thread>

#include "map_store/base/file.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::storage::internal {
namespace {

namespace fs = std::filesystem;

class MapCacheTest : public testing::Test {
 protected:
  void SetUp() override {
    auto made = base::TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(made.ok()) << made.status();
    directory_.emplace(*std::move(made));
    options_.directory = directory_->path() / "cache";
    for (std::uint64_t i = 0; i < 4; ++i) {
      const fs::path file = Source(i);
      ASSERT_TRUE(map::WriteMapFile(
                      map::testing_map::MakeMapData({.seed = i + 1}), file)
                      .ok());
      infos_.push_back((*map::Map::Open(file))->info());
    }
  }
  fs::path Source(std::size_t i) const {
    return directory_->path() / ("source" + std::to_string(i));
  }
  MapCache::Fetch From(std::size_t i) {
    return [this, i](const fs::path& file) {
      ++num_fetched_;
      fs::copy_file(Source(i), file);
      return absl::OkStatus();
    };
  }
  std::unique_ptr<MapCache> OpenOrDie() const {
    auto cache = MapCache::Open(options_);
    EXPECT_TRUE(cache.ok()) << cache.status();
    return *std::move(cache);
  }
  bool IsCached(std::size_t i) const {
    return fs::exists(options_.directory / "maps" /
                      (infos_[i].content_hash + ".glmap"));
  }

  std::optional<base::TemporaryDirectory> directory_;
  CacheOptions options_;
  std::vector<map::MapInfo> infos_;
  std::atomic<int> num_fetched_ = 0;
};

TEST_F(MapCacheTest, FetchesOnceAmongThreadsAndProcesses) {
  // Locks of two caches on a folder exclude each other as those of two
  // processes do.
  const auto a = OpenOrDie();
  const auto b = OpenOrDie();
  std::vector<std::thread> threads;
  for (int t = 0; t < 6; ++t) {
    threads.emplace_back([&, t] {
      const auto map = (t % 2 == 0 ? *a : *b).Get(infos_[0], From(0));
      EXPECT_TRUE(map.ok()) << map.status();
      EXPECT_TRUE((*map)->Verify().ok());
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(num_fetched_, 1);
  StoreStats here;
  StoreStats there;
  a->FillStats(here);
  b->FillStats(there);
  EXPECT_EQ(here.cache_misses + there.cache_misses, 1U);
  EXPECT_EQ(here.cache_hits + there.cache_hits, 5U);
  EXPECT_TRUE(OpenOrDie()->Get(infos_[0], From(0)).ok());
  EXPECT_EQ(num_fetched_, 1);
}

TEST_F(MapCacheTest, TheLeastRecentlyUsedGoesUnlessItIsOpen) {
  options_.max_bytes = 2 * infos_[0].file_bytes + infos_[0].file_bytes / 2;
  const auto cache = OpenOrDie();
  ASSERT_TRUE(cache->Get(infos_[0], From(0)).ok());
  auto open = cache->Get(infos_[1], From(1));
  ASSERT_TRUE(open.ok());
  // Times of files may be coarse: set apart what was used when.
  const auto now = fs::file_time_type::clock::now();
  const auto path = [this](std::size_t i) {
    return options_.directory / "maps" / (infos_[i].content_hash + ".glmap");
  };
  fs::last_write_time(path(0), now - std::chrono::hours(1));
  fs::last_write_time(path(1), now - std::chrono::hours(2));
  ASSERT_TRUE(cache->Get(infos_[2], From(2)).ok());
  EXPECT_FALSE(IsCached(0));  // used after 1, but 1 is open
  EXPECT_TRUE(IsCached(1));
  EXPECT_TRUE(IsCached(2));
  EXPECT_TRUE((*open)->Verify().ok());
  open = absl::UnknownError("let go");
  fs::last_write_time(path(2), now - std::chrono::hours(1));
  ASSERT_TRUE(cache->Get(infos_[1], From(1)).ok());  // used again
  EXPECT_EQ(num_fetched_, 3);
  ASSERT_TRUE(cache->Get(infos_[3], From(3)).ok());
  EXPECT_TRUE(IsCached(1));
  EXPECT_FALSE(IsCached(2));
  EXPECT_TRUE(IsCached(3));
  StoreStats stats;
  cache->FillStats(stats);
  EXPECT_EQ(stats.cache_removals, 2U);
  EXPECT_EQ(stats.cache_bytes, infos_[1].file_bytes + infos_[3].file_bytes);
}

TEST_F(MapCacheTest, ASmallerCacheShrinksWhenItIsOpened) {
  {
    const auto cache = OpenOrDie();
    for (std::size_t i = 0; i < 4; ++i) {
      ASSERT_TRUE(cache->Get(infos_[i], From(i)).ok());
    }
  }
  std::ofstream(options_.directory / "maps/notes.txt") << "the user's own";
  options_.max_bytes = 0;
  OpenOrDie();
  for (std::size_t i = 0; i < 4; ++i) EXPECT_FALSE(IsCached(i));
  EXPECT_TRUE(fs::exists(options_.directory / "maps/notes.txt"));
}

TEST_F(MapCacheTest, WhatIsNotAsExpectedDoesNotStay) {
  const auto cache = OpenOrDie();
  const auto wrong = cache->Get(infos_[0], From(1));
  EXPECT_EQ(wrong.status().code(), absl::StatusCode::kDataLoss);
  const auto broken =
      cache->Get(infos_[0], [](const fs::path& file) -> absl::Status {
        std::ofstream(file) << "half";
        return absl::UnavailableError("broken off");
      });
  EXPECT_EQ(broken.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_FALSE(IsCached(0));
  EXPECT_FALSE(IsCached(1));
  EXPECT_TRUE(fs::is_empty(options_.directory / "staging"));
  EXPECT_TRUE(cache->Get(infos_[0], From(0)).ok());
}

TEST_F(MapCacheTest, AHashIsNoPath) {
  const auto cache = OpenOrDie();
  for (const char* hash : {"", "../../../../etc/passwd", "0123"}) {
    map::MapInfo info = infos_[0];
    info.content_hash = hash;
    EXPECT_EQ(cache->Get(info, From(0)).status().code(),
              absl::StatusCode::kDataLoss);
    EXPECT_EQ(cache->Check(info, From(0)).code(), absl::StatusCode::kDataLoss);
  }
  EXPECT_EQ(num_fetched_, 0);
}

}  // namespace
}  // namespace groundlock::storage::internal
