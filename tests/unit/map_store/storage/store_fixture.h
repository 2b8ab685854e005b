// SPDX-License-Identifier: Apache-2.0
// An empty store of each kind, for tests that both must pass.
#ifndef GROUNDLOCK_TESTS_UNIT_MAP_STORE_STORAGE_STORE_FIXTURE_H_
#define GROUNDLOCK_TESTS_UNIT_MAP_STORE_STORAGE_STORE_FIXTURE_H_

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "map_store/base/file.h"
#include "map_store/storage/store.h"
#include "tests/support/postgres_server.h"

namespace groundlock::storage {

class StoreFixture : public testing::Test {
 protected:
  void MakeDirectory() {
    auto made = base::TemporaryDirectory::Create(
        std::filesystem::temp_directory_path());
    ASSERT_TRUE(made.ok()) << made.status();
    directory_.emplace(*std::move(made));
    location_ = (directory_->path() / "store").string();
  }
  // Skips the test where there is no PostgreSQL.
  void MakeDatabase() {
    const auto server = test::PostgresServer::Shared();
    if (absl::IsNotFound(server.status())) {
      GTEST_SKIP() << server.status().message();
    }
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *server;
    const auto url = server_->MakeDatabase();
    ASSERT_TRUE(url.ok()) << url.status();
    location_ = *url;
  }

  // What another server on the same store has; one on another machine has a
  // cache of its own.
  std::unique_ptr<Store> OpenOrDie(int machine = 0) const {
    auto store = OpenStore(location_, Cache(machine));
    EXPECT_TRUE(store.ok()) << store.status();
    return store.ok() ? *std::move(store) : nullptr;
  }
  CacheOptions Cache(int machine = 0) const {
    CacheOptions cache;
    cache.directory = directory_->path() / ("cache" + std::to_string(machine));
    return cache;
  }
  static std::size_t NumEntries(const std::filesystem::path& folder) {
    return static_cast<std::size_t>(
        std::distance(std::filesystem::directory_iterator(folder),
                      std::filesystem::directory_iterator()));
  }

  std::optional<base::TemporaryDirectory> directory_;
  std::string location_;
  test::PostgresServer* server_ = nullptr;
};

enum class Backend { kDirectory, kPostgres };

class StoreTest : public StoreFixture,
                  public testing::WithParamInterface<Backend> {
 protected:
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(MakeDirectory());
    if (GetParam() == Backend::kPostgres) MakeDatabase();
  }
  // Folder of maps that are being written.
  std::filesystem::path Staging() const {
    return GetParam() == Backend::kDirectory
               ? directory_->path() / "store/imports"
               : Cache().directory / "staging";
  }
};

}  // namespace groundlock::storage

#endif  // GROUNDLOCK_TESTS_UNIT_MAP_STORE_STORAGE_STORE_FIXTURE_H_
