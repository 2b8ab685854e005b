// SPDX-License-Identifier: Apache-2.0
// What a store in PostgreSQL has that others have not: a connection that
// breaks, a local cache, and a database that others administer.
#include <gmock/gmock.h>

#include <atomic>
#include <fstream>
#include <random>
#include <thread>

#include "map_store/storage/internal/postgres_address.h"
#include "map_store/storage/internal/postgres_connection.h"
#include "map_store/storage/store.h"
#include "tests/unit/map_store/map/synthetic_map.h"
#include "tests/unit/map_store/storage/store_fixture.h"

namespace groundlock::storage {
namespace {

namespace fs = std::filesystem;
using internal::PostgresConnection;
using map::testing_map::MakeMapData;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

std::string Message(const absl::Status& status) {
  return std::string(status.message());
}

class PostgresStoreTest : public StoreFixture {
 protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(MakeDirectory());
    MakeDatabase();
  }
  void Execute(const std::string& sql) const {
    const auto connection = PostgresConnection::Connect(location_);
    ASSERT_TRUE(connection.ok()) << connection.status();
    const absl::Status status = (*connection)->Execute(sql.c_str());
    EXPECT_TRUE(status.ok()) << status;
  }
  std::int64_t Number(const char* sql) const {
    const auto connection = PostgresConnection::Connect(location_);
    EXPECT_TRUE(connection.ok()) << connection.status();
    const auto result = (*connection)->Run({"number", sql});
    EXPECT_TRUE(result.ok()) << result.status();
    return result.ok() ? *result->Integer(0, 0) : -1;
  }
  fs::path Cached(const map::MapInfo& info, int machine = 0) const {
    return Cache(machine).directory / "maps" / (info.content_hash + ".glmap");
  }
  // The same database, asked for otherwise.
  std::string With(const std::string& from, const std::string& to) const {
    std::string url = location_;
    const std::size_t at = url.find(from);
    EXPECT_NE(at, std::string::npos);
    return url.replace(at, from.size(), to);
  }
};

TEST_F(PostgresStoreTest, GoesOnAfterTheDatabaseRestarted) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("yard", MakeMapData({.seed = 2})).ok());
  const auto held = store->Open("yard", 1);
  ASSERT_TRUE(held.ok());
  ASSERT_TRUE(server_->Stop().ok());
  EXPECT_TRUE((*held)->Verify().ok());
  ASSERT_TRUE(server_->StartAgain().ok());
  EXPECT_EQ(store->List()->size(), 1U);
  EXPECT_TRUE(store->Publish("yard", MakeMapData({.seed = 3})).ok());
  // What it had open, it still has, and others are told so again.
  ASSERT_TRUE(store->CollectGarbage(0).ok());
  const auto report = OpenOrDie(1)->CollectGarbage(1);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->num_in_use, 1U);
  EXPECT_EQ(report->num_removed, 1U);
}

// All connections break once during each import, at any moment, also between a
// COMMIT and its answer: every map is there once.
TEST_F(PostgresStoreTest, BrokenConnectionsLoseAndDoubleNothing) {
  constexpr std::uint64_t kMaps = 15;
  const auto store = OpenOrDie();
  std::atomic<std::uint64_t> begun = 0;
  std::thread breaker([&] {
    const auto connection = PostgresConnection::Connect(location_);
    ASSERT_TRUE(connection.ok()) << connection.status();
    std::mt19937_64 random(5);
    for (std::uint64_t i = 1; i <= kMaps; ++i) {
      while (begun < i) std::this_thread::yield();
      std::this_thread::sleep_for(std::chrono::milliseconds(random() % 40));
      EXPECT_TRUE((*connection)
                      ->Execute("SELECT pg_terminate_backend(pid) FROM "
                                "pg_stat_activity WHERE datname = "
                                "current_database() AND pid <> "
                                "pg_backend_pid()")
                      .ok());
    }
  });
  for (std::uint64_t i = 1; i <= kMaps; ++i) {
    begun = i;
    const auto map = store->Publish("yard", MakeMapData({.seed = i}));
    EXPECT_TRUE(map.ok()) << map.status();
  }
  breaker.join();
  const auto versions = store->ListVersions("yard");
  ASSERT_TRUE(versions.ok()) << versions.status();
  EXPECT_EQ(versions->size(), kMaps);
}

TEST_F(PostgresStoreTest, ADeletedMapLeavesNoContent) {
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  EXPECT_GT(Number("SELECT count(*) FROM groundlock.chunks"), 0);
  ASSERT_TRUE(store->Delete("yard").ok());
  EXPECT_EQ(Number("SELECT count(*) FROM groundlock.chunks"), 0);
}

TEST_F(PostgresStoreTest, ContentOfSeveralChunksComesBack) {
  const auto store = OpenOrDie();
  const auto map =
      store->Publish("yard", MakeMapData({.num_ground = 6'000, .num_wall = 0}));
  ASSERT_TRUE(map.ok()) << map.status();
  ASSERT_GT(map->info.file_bytes, std::uint64_t{2} << 20);
  EXPECT_TRUE(OpenOrDie(1)->Open("yard").ok());
  EXPECT_TRUE(store->Check("yard").ok());
}

TEST_F(PostgresStoreTest, DamageInTheDatabaseIsFoundWhereItIsFetched) {
  const auto store = OpenOrDie(0);
  ASSERT_TRUE(store->Publish("yard", MakeMapData()).ok());
  ASSERT_TRUE(store->Publish("alley", MakeMapData({.seed = 2})).ok());
  Execute(
      "UPDATE groundlock.chunks SET bytes = set_byte(bytes, 12345, "
      "get_byte(bytes, 12345) # 1) WHERE map_id = (SELECT id FROM "
      "groundlock.maps WHERE name = 'yard')");
  Execute(
      "DELETE FROM groundlock.chunks WHERE map_id = (SELECT id FROM "
      "groundlock.maps WHERE name = 'alley')");
  EXPECT_TRUE(store->Open("yard").ok());  // its own copy is whole
  const auto other = OpenOrDie(1);
  for (const std::string name : {"yard", "alley"}) {
    const absl::Status opened = other->Open(name).status();
    EXPECT_EQ(opened.code(), absl::StatusCode::kDataLoss) << opened;
    EXPECT_THAT(Message(opened), HasSubstr("map '" + name + "' version 1"));
    EXPECT_EQ(store->Check(name).code(), absl::StatusCode::kDataLoss);
  }
  EXPECT_EQ(NumEntries(Cache(1).directory / "maps"), 0U);
}

TEST_F(PostgresStoreTest, ADamagedCopyIsFetchedAgain) {
  const auto info = OpenOrDie()->Publish("yard", MakeMapData())->info;
  const fs::path copy = Cached(info);
  fs::resize_file(copy, 5'000);
  const auto store = OpenOrDie();
  ASSERT_TRUE(store->Open("yard").ok());
  EXPECT_EQ(fs::file_size(copy), info.file_bytes);
  const StoreStats stats = store->Stats();
  EXPECT_EQ(stats.cache_misses, 1U);
  EXPECT_EQ(stats.cache_hits, 0U);
  EXPECT_GE(stats.connections_made, 1U);
  EXPECT_EQ(stats.connections_in_use, 0U);
  EXPECT_EQ(stats.connections_failed + stats.database_away, 0U);
  // Where opening does not look, a check does.
  {
    std::fstream file(copy, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(12'345);
    file.put(static_cast<char>(file.peek() ^ 1));
  }
  EXPECT_TRUE(store->Check("yard").ok());
  const auto map = store->Open("yard");
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->Verify().ok());
}

TEST_F(PostgresStoreTest, NamesANewerSchemaAndLeavesItAlone) {
  ASSERT_TRUE(OpenOrDie()->Publish("yard", MakeMapData()).ok());
  Execute("UPDATE groundlock.schema SET version = 99");
  const absl::Status newer = OpenStore(location_, Cache()).status();
  EXPECT_EQ(newer.code(), absl::StatusCode::kUnimplemented);
  EXPECT_THAT(Message(newer), HasSubstr("schema version 99"));
  EXPECT_EQ(Number("SELECT version FROM groundlock.schema"), 99);
  EXPECT_EQ(Number("SELECT count(*) FROM groundlock.maps"), 1);
}

TEST_F(PostgresStoreTest, ServersThatStartAtOnceMakeOneSchema) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([this, t] {
      EXPECT_TRUE(OpenOrDie(t)->Publish("yard", MakeMapData()).ok());
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(OpenOrDie()->Get("yard")->version, 4U);
}

TEST_F(PostgresStoreTest, SaysWhatIsMissingToOpen) {
  const absl::Status no_database =
      OpenStore(With("/store", "/no_such_"), Cache()).status();
  EXPECT_EQ(no_database.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(Message(no_database),
              AllOf(HasSubstr("no_such_"), HasSubstr("createdb")));
  Execute("DROP ROLE IF EXISTS plain");
  Execute("CREATE ROLE plain LOGIN");
  const absl::Status no_right =
      OpenStore(With("groundlock@", "plain@"), Cache()).status();
  EXPECT_EQ(no_right.code(), absl::StatusCode::kPermissionDenied);
  EXPECT_THAT(Message(no_right), HasSubstr("CREATE on the database"));
  // An ordinary user who owns the database needs no more.
  Execute("GRANT CREATE ON DATABASE " +
          location_.substr(location_.find("store"),
                           location_.find('?') - location_.find("store")) +
          " TO plain");
  const auto store = OpenStore(With("groundlock@", "plain@"), Cache());
  ASSERT_TRUE(store.ok()) << store.status();
  EXPECT_TRUE((*store)->Publish("yard", MakeMapData()).ok());
  EXPECT_TRUE((*store)->CollectGarbage(1).ok());
}

TEST(PostgresAddressTest, AnUnreachableDatabaseIsNamedWithoutPassword) {
  const auto directory =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  CacheOptions cache;
  cache.directory = directory.path() / "cache";
  const absl::Status status =
      OpenStore("postgresql://someone:s3cret@127.0.0.1:1/yards", cache)
          .status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(Message(status),
              AllOf(HasSubstr("'yards' on 127.0.0.1:1 as 'someone'"),
                    HasSubstr("is PostgreSQL running there"),
                    Not(HasSubstr("s3cret"))));
}

TEST(PostgresAddressTest, PasswordsAreNeverShown) {
  const std::string malformed[] = {

      "postgresql://u:s3cret@[::1/d",
      "postgresql://u:%zzs3cret@h/d",
      "postgresql://h/d?nonsense=1&password=s3cret",
      "postgresql://u:s3c/r?s3cret@h:x/d"};
  const auto directory =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  CacheOptions cache;
  cache.directory = directory.path() / "cache";
  for (const std::string& url : malformed) {
    const absl::Status status = OpenStore(url, cache).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << url;
    EXPECT_THAT(Message(status), Not(HasSubstr("s3c")));
  }
  EXPECT_EQ(WithoutPassword("postgresql://u:s3cret@h:5/d?sslmode=require"),
            "postgresql://u:***@h:5/d?sslmode=require");
  EXPECT_EQ(WithoutPassword("postgres://h/d?user=u&password=s3cret&port=5"),
            "postgres://h/d?user=u&password=***&port=5");
  EXPECT_EQ(WithoutPassword("postgresql://h/d?pass%77ord=s3cret"),
            "postgresql://h/d?pass%77ord=***");
  EXPECT_EQ(WithoutPassword("postgresql://u@h/d"), "postgresql://u@h/d");
  EXPECT_EQ(WithoutPassword("postgresql:///d?host=/run/x"),
            "postgresql:///d?host=/run/x");
  EXPECT_EQ(WithoutPassword("/var/lib/groundlock"), "/var/lib/groundlock");
  EXPECT_FALSE(fs::exists(cache.directory));
}

}  // namespace
}  // namespace groundlock::storage
