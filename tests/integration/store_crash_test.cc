// SPDX-License-Identifier: Apache-2.0
// A process that publishes, deletes and collects garbage without end is killed
// (SIGKILL) at random moments. What it was told was done is there, what was
// under way is there whole or not at all, and what it left is gone once the
// store is opened again.
//   GROUNDLOCK_STORE_KILLS=200 test_integration_store_crash
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <map>
#include <random>
#include <thread>

#include "map_store/base/file.h"
#include "map_store/storage/internal/postgres_connection.h"
#include "map_store/storage/store.h"
#include "tests/support/postgres_server.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::storage {
namespace {

namespace fs = std::filesystem;

constexpr int kDefaultKills = 20;
constexpr std::uint64_t kKeepNewest = 3;
constexpr int kNumContents = 4;
constexpr const char* kNames[] = {"yard", "alley"};

int NumKills() {
  const char* text = std::getenv("GROUNDLOCK_STORE_KILLS");
  return text != nullptr ? std::atoi(text) : kDefaultKills;
}

// Of different sizes, so that a kill meets all stages.
map::MapData Content(int i) {
  return map::testing_map::MakeMapData(
      {.num_ground = 50 + 700 * i,
       .num_wall = 10,
       .seed = static_cast<std::uint64_t>(i + 1)});
}

enum class Operation : std::int32_t { kPublish, kDelete, kCollect };

// What the child tells, before and after each operation.
struct Report {
  Operation operation = Operation::kPublish;
  std::int32_t name = 0;
  std::int32_t content = 0;
  bool done = false;
  bool found = false;         // of a delete: there was something
  std::uint64_t version = 0;  // of a publish
};

[[noreturn]] void WorkUntilKilled(const std::string& location,
                                  const CacheOptions& cache,
                                  std::uint64_t seed,
                                  int pipe) {
  const auto store = OpenStore(location, cache);
  if (!store.ok()) _exit(1);
  std::mt19937_64 random(seed);
  std::vector<map::MapData> contents;
  for (int i = 0; i < kNumContents; ++i) contents.push_back(Content(i));
  const auto tell = [pipe](const Report& report) {
    if (write(pipe, &report, sizeof(report)) != sizeof(report)) _exit(2);
  };
  for (;;) {
    Report report;
    const std::uint64_t dice = random() % 10;
    report.operation = dice < 6   ? Operation::kPublish
                       : dice < 8 ? Operation::kDelete
                                  : Operation::kCollect;
    report.name = static_cast<std::int32_t>(random() % std::size(kNames));
    report.content = static_cast<std::int32_t>(random() % kNumContents);
    tell(report);
    const char* const name = kNames[report.name];
    absl::Status status;
    switch (report.operation) {
      case Operation::kPublish: {
        const auto map = (*store)->Publish(
            name, contents[static_cast<std::size_t>(report.content)]);
        status = map.status();
        if (map.ok()) report.version = map->version;
        break;
      }
      case Operation::kDelete:
        status = (*store)->Delete(name);
        report.found = !absl::IsNotFound(status);
        if (!report.found) status = absl::OkStatus();
        break;
      case Operation::kCollect:
        status = (*store)->CollectGarbage(kKeepNewest).status();
        break;
    }
    if (!status.ok()) _exit(3);
    report.done = true;
    tell(report);
  }
}

// Of each name, what is there: content by version; and the last version given.
struct Name {
  std::map<std::uint64_t, int> versions;
  std::uint64_t last = 0;
};

class StoreCrashTest : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    auto made = base::TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(made.ok()) << made.status();
    directory_.emplace(*std::move(made));
    cache_.directory = directory_->path() / "cache";
    if (OnPostgres()) {
      const auto server = test::PostgresServer::Shared();
      if (absl::IsNotFound(server.status())) {
        GTEST_SKIP() << server.status().message();
      }
      ASSERT_TRUE(server.ok()) << server.status();
      location_ = (*server)->MakeDatabase().value();
    } else {
      location_ = (directory_->path() / "store").string();
    }
    for (int i = 0; i < kNumContents; ++i) {
      const fs::path file = directory_->path() / "content";
      ASSERT_TRUE(map::WriteMapFile(Content(i), file).ok());
      hashes_.push_back((*map::Map::Open(file))->info().content_hash);
    }
  }
  bool OnPostgres() const { return std::string(GetParam()) == "Postgres"; }

  // Runs a child and kills it some time after it has begun an operation of
  // this kind, or after it was done; what it told before it died.
  std::vector<Report> RunAndKill(Operation during, std::mt19937_64& random);
  // What the database still does for a process that is dead, it does now.
  void AwaitEndOfDeadConnections() const;
  void Apply(const std::vector<Report>& reports);
  void CheckStore();
  void CheckName(Store& store, const char* text, Name& name, bool in_doubt);
  void CheckLeftovers() const;
  std::int64_t Number(const char* sql) const;

  std::optional<base::TemporaryDirectory> directory_;
  std::string location_;
  CacheOptions cache_;
  std::vector<std::string> hashes_;
  Name names_[std::size(kNames)];
  std::optional<Report> in_doubt_;
  int num_in_doubt_[3] = {};
};

std::vector<Report> StoreCrashTest::RunAndKill(Operation during,
                                               std::mt19937_64& random) {
  std::vector<Report> reports;
  int fds[2];
  if (pipe(fds) != 0) {
    ADD_FAILURE() << "pipe";
    return reports;
  }
  const std::uint64_t seed = random();
  const pid_t child = fork();
  if (child == 0) {
    close(fds[0]);
    WorkUntilKilled(location_, cache_, seed, fds[1]);
  }
  close(fds[1]);
  // About as long as such an operation takes.
  const std::uint64_t longest_us =
      during == Operation::kPublish ? 40'000 : 8'000;
  std::uint64_t num_spared = random() % 3;
  bool killed = false;
  Report report;
  while (read(fds[0], &report, sizeof(report)) == sizeof(report)) {
    reports.push_back(report);
    if (killed || report.done || report.operation != during) continue;
    if (num_spared-- > 0) continue;
    std::this_thread::sleep_for(
        std::chrono::microseconds(random() % longest_us));
    kill(child, SIGKILL);
    killed = true;
  }
  close(fds[0]);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFSIGNALED(status)) << "exit " << WEXITSTATUS(status);
  return reports;
}

std::int64_t StoreCrashTest::Number(const char* sql) const {
  const auto connection = internal::PostgresConnection::Connect(location_);
  EXPECT_TRUE(connection.ok()) << connection.status();
  const auto result = (*connection)->Run({"number", sql});
  EXPECT_TRUE(result.ok()) << result.status();
  return result.ok() ? *result->Integer(0, 0) : -1;
}

void StoreCrashTest::AwaitEndOfDeadConnections() const {
  if (!OnPostgres()) return;
  while (Number("SELECT count(*) FROM pg_stat_activity WHERE datname = "
                "current_database() AND backend_type = 'client backend' AND "
                "pid <> pg_backend_pid()") > 0) {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

void Collect(Name& name) {
  while (name.versions.size() > kKeepNewest) {
    name.versions.erase(name.versions.begin());
  }
}

void StoreCrashTest::Apply(const std::vector<Report>& reports) {
  in_doubt_.reset();
  for (const Report& report : reports) {
    Name& name = names_[report.name];
    if (!report.done) {
      in_doubt_ = report;
      continue;
    }
    in_doubt_.reset();
    switch (report.operation) {
      case Operation::kPublish:
        EXPECT_GT(report.version, name.last) << "a version was used twice";
        name.last = report.version;
        name.versions[report.version] = report.content;
        break;
      case Operation::kDelete:
        EXPECT_EQ(report.found, !name.versions.empty());
        name.versions.clear();
        break;
      case Operation::kCollect:
        for (Name& each : names_) Collect(each);
        break;
    }
  }
}

void StoreCrashTest::CheckName(Store& store,
                               const char* text,
                               Name& name,
                               bool in_doubt) {
  auto listed = store.ListVersions(text);
  if (absl::IsNotFound(listed.status())) listed.emplace();
  ASSERT_TRUE(listed.ok()) << listed.status();
  std::map<std::uint64_t, std::string> found;
  for (const MapVersion& map : *listed) {
    found[map.version] = map.info.content_hash;
    const auto opened = store.Open(text, map.version);
    ASSERT_TRUE(opened.ok()) << opened.status();
    EXPECT_EQ((*opened)->info().content_hash, map.info.content_hash);
    EXPECT_TRUE((*opened)->Verify().ok()) << (*opened)->Verify();
  }
  const auto expected = [this](const Name& of) {
    std::map<std::uint64_t, std::string> hashes;
    for (const auto& [version, content] : of.versions) {
      hashes[version] = hashes_[static_cast<std::size_t>(content)];
    }
    return hashes;
  };
  if (found == expected(name)) return;
  // Then all of what was under way has happened.
  ASSERT_TRUE(in_doubt) << text << ": lost or appeared";
  Name after = name;
  switch (in_doubt_->operation) {
    case Operation::kPublish:
      ASSERT_FALSE(found.empty());
      EXPECT_GT(found.rbegin()->first, name.last);
      after.last = found.rbegin()->first;
      after.versions[after.last] = in_doubt_->content;
      break;
    case Operation::kDelete:
      after.versions.clear();
      break;
    case Operation::kCollect:
      Collect(after);
      break;
  }
  EXPECT_EQ(found, expected(after)) << text << ": half-visible";
  name = after;
}

void StoreCrashTest::CheckLeftovers() const {
  if (OnPostgres()) {
    EXPECT_EQ(Number("SELECT count(*) FROM groundlock.chunks WHERE map_id NOT "
                     "IN (SELECT id FROM groundlock.maps)"),
              0);
    EXPECT_TRUE(fs::is_empty(cache_.directory / "staging"));
    return;
  }
  const fs::path root(location_);
  EXPECT_TRUE(fs::is_empty(root / "imports"));
  std::size_t num_files = 0;
  for (const Name& name : names_) num_files += name.versions.size();
  const auto files = static_cast<std::size_t>(std::distance(
      fs::directory_iterator(root / "maps"), fs::directory_iterator()));
  EXPECT_EQ(files, num_files);
}

void StoreCrashTest::CheckStore() {
  const auto store = OpenStore(location_, cache_);
  ASSERT_TRUE(store.ok()) << store.status();
  for (std::size_t i = 0; i < std::size(kNames); ++i) {
    const bool touched = in_doubt_.has_value() &&
                         (in_doubt_->operation == Operation::kCollect ||
                          in_doubt_->name == static_cast<std::int32_t>(i));
    CheckName(**store, kNames[i], names_[i], touched);
  }
  CheckLeftovers();
  // Nothing of the dead holds anything up.
  const auto report = (*store)->CollectGarbage(kKeepNewest);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->num_in_use, 0U);
  for (Name& name : names_) Collect(name);
}

TEST_P(StoreCrashTest, NothingLostNothingHalfVisible) {
  const int num_kills = NumKills();
  std::mt19937_64 random(20);
  constexpr Operation kOperations[] = {
      Operation::kPublish, Operation::kDelete, Operation::kCollect};
  std::size_t num_done = 0;
  for (int i = 0; i < num_kills; ++i) {
    const auto reports =
        RunAndKill(kOperations[i % std::size(kOperations)], random);
    AwaitEndOfDeadConnections();
    Apply(reports);
    if (in_doubt_.has_value()) {
      ++num_in_doubt_[static_cast<int>(in_doubt_->operation)];
    }
    for (const Report& report : reports) num_done += report.done ? 1 : 0;
    CheckStore();
    ASSERT_FALSE(HasFailure()) << "kill " << i + 1;
  }
  std::printf(
      "%d kills: %zu operations were done; under way were %d imports, %d "
      "deletes, %d collections\n",
      num_kills,
      num_done,
      num_in_doubt_[0],
      num_in_doubt_[1],
      num_in_doubt_[2]);
  EXPECT_GT(num_done, 0U) << "no child got as far as publishing";
}

INSTANTIATE_TEST_SUITE_P(Stores,
                         StoreCrashTest,
                         testing::Values("Directory", "Postgres"),
                         [](const auto& backend) { return backend.param; });

}  // namespace
}  // namespace groundlock::storage
