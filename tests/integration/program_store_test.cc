// SPDX-License-Identifier: Apache-2.0
// The program on a store in PostgreSQL, alone and beside another server.
#include <gmock/gmock.h>

#include <chrono>
#include <filesystem>

#include "map_store/storage/internal/postgres_connection.h"
#include "map_store/storage/store.h"
#include "tests/integration/program.h"
#include "tests/support/postgres_server.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr const char* kListening = "listening on 127\\.0\\.0\\.1:";

class ProgramOnPostgres : public testing::Test {
 protected:
  void SetUp() override {
    const auto server = PostgresServer::Shared();
    if (absl::IsNotFound(server.status())) {
      GTEST_SKIP() << server.status().message();
    }
    ASSERT_TRUE(server.ok()) << server.status();
    const auto url = (*server)->MakeDatabase();
    ASSERT_TRUE(url.ok()) << url.status();
    url_ = *url;
    auto directory =
        base::TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(directory.ok()) << directory.status();
    directory_.emplace(*std::move(directory));
    storage::CacheOptions cache;
    cache.directory = directory_->path() / "cache";
    auto store = storage::OpenStore(url_, cache);
    ASSERT_TRUE(store.ok()) << store.status();
    store_ = *std::move(store);
  }
  std::vector<std::string> Arguments() const {
    return {"--listen",
            "127.0.0.1:0",
            "--store",
            url_,
            "--map-cache",
            "@TMP@/cache"};
  }

  std::string url_;
  std::optional<base::TemporaryDirectory> directory_;
  std::unique_ptr<storage::Store> store_;  // as another server has it
};

std::unique_ptr<sdk::Client> ClientOf(const Program& program) {
  const int port = program.PortAfter(kListening);
  EXPECT_GT(port, 0) << program.Log();
  auto client = ConnectTo("127.0.0.1:" + std::to_string(port));
  EXPECT_TRUE(client.ok()) << client.status();
  return client.ok() ? *std::move(client) : nullptr;
}

TEST_F(ProgramOnPostgres, TwoServersServeOneStore) {
  ASSERT_TRUE(store_->Publish("yard", map::testing_map::MakeMapData()).ok());
  const Program first(Arguments());
  const Program second(Arguments());
  const auto a = ClientOf(first);
  const auto b = ClientOf(second);
  ASSERT_TRUE(a != nullptr && b != nullptr);
  EXPECT_EQ(a->GetMap("yard")->version, 1U);
  EXPECT_TRUE(b->GetPointCloud("yard").ok());  // by way of its cache
  EXPECT_TRUE(fs::exists(second.directory() / "cache/scratch"));
  ASSERT_TRUE(a->DeleteMap("yard").ok());
  EXPECT_EQ(b->GetMap("yard").status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(first.Log(), HasSubstr("store: PostgreSQL database 'store"));
}

TEST_F(ProgramOnPostgres, KeepsTheNewestVersions) {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    ASSERT_TRUE(
        store_->Publish("yard", map::testing_map::MakeMapData({.seed = seed}))
            .ok());
  }
  std::vector<std::string> arguments = Arguments();
  arguments.insert(arguments.end(), {"--keep-versions", "2"});
  const Program program(arguments);
  const auto client = ClientOf(program);
  ASSERT_NE(client, nullptr);
  EXPECT_TRUE(Eventually([&] {
    return absl::IsNotFound(client->GetMap("yard", 1).status());
  })) << program.Log();
  EXPECT_TRUE(client->GetMap("yard", 2).ok());
}

TEST_F(ProgramOnPostgres, ChecksAStoreWithoutServing) {
  ASSERT_TRUE(store_->Publish("yard", map::testing_map::MakeMapData()).ok());
  ASSERT_TRUE(store_->Publish("yard", map::testing_map::MakeMapData()).ok());
  std::vector<std::string> arguments = Arguments();
  arguments.emplace_back("--check-store");
  Program whole(arguments);
  EXPECT_EQ(whole.Wait(), 0);
  EXPECT_THAT(whole.Log(), HasSubstr("2 map versions, all whole"));
  const auto connection = storage::internal::PostgresConnection::Connect(url_);
  ASSERT_TRUE(connection.ok()) << connection.status();
  ASSERT_TRUE((*connection)
                  ->Execute("UPDATE groundlock.chunks SET bytes = set_byte("
                            "bytes, 12345, get_byte(bytes, 12345) # 1) WHERE "
                            "map_id = (SELECT max(id) FROM groundlock.maps)")
                  .ok());
  Program damaged(arguments);
  EXPECT_EQ(damaged.Wait(), 1);
  EXPECT_THAT(damaged.Log(),
              AllOf(HasSubstr("map yard version 1: whole"),
                    HasSubstr("map yard version 2: DATA_LOSS"),
                    HasSubstr("1 of 2 map versions are damaged")));
}

TEST(Program, SaysThatTheDatabaseIsNotThere) {
  Program program({"--listen",
                   "127.0.0.1:0",
                   "--store",
                   "postgresql://someone:s3cret@127.0.0.1:1/yards",
                   "--map-cache",
                   "@TMP@/cache"});
  EXPECT_EQ(program.Wait(), 1);
  EXPECT_THAT(program.Log(),
              AllOf(HasSubstr("cannot connect to PostgreSQL database 'yards' "
                              "on 127.0.0.1:1 as 'someone'"),
                    HasSubstr("is PostgreSQL running there"),
                    Not(HasSubstr("s3cret"))));
}

}  // namespace
}  // namespace groundlock::test
