// SPDX-License-Identifier: Apache-2.0
// What makes a build resumable: its log, and programs that can be ended.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <fstream>

#include "map_store/base/file.h"
#include "map_store/build/internal/image_features.h"
#include "map_store/build/internal/stage_log.h"
#include "map_store/cage/child_process.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class Stages : public ::testing::Test {
 protected:
  fs::path folder() const { return directory_.path(); }

 private:
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
};

TEST_F(Stages, WhatWasFinishedIsRemembered) {
  {
    auto log = StageLog::Open(folder() / "work");
    ASSERT_TRUE(log.ok()) << log.status();
    EXPECT_FALSE(log->IsDone("features", "key"));
    ASSERT_TRUE(log->Begin("features").ok());
    ASSERT_TRUE(log->Finish("features", "key").ok());
    ASSERT_TRUE(log->Begin("matching").ok());  // and interrupted
  }
  auto log = StageLog::Open(folder() / "work");
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_TRUE(log->IsDone("features", "key"));
  EXPECT_FALSE(log->IsDone("features", "other options"));
  EXPECT_FALSE(log->IsDone("matching", "key"));
  ASSERT_TRUE(log->Begin("features").ok());
  EXPECT_FALSE(log->IsDone("features", "key"));
}

TEST_F(Stages, OneBuildPerFolderAndDamageCountsAsNothing) {
  std::ofstream(folder() / "stages.json") << "{\"features\": 3, broken";
  auto log = StageLog::Open(folder());
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_FALSE(log->IsDone("features", "3"));
  EXPECT_EQ(StageLog::Open(folder()).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST_F(Stages, HashesTellContentsAndNamesApart) {
  using Parts = std::vector<std::string>;
  EXPECT_EQ(HashOf(Parts{"ab", "c"}), HashOf(Parts{"ab", "c"}));
  EXPECT_NE(HashOf(Parts{"ab", "c"}), HashOf(Parts{"a", "bc"}));
  std::ofstream(folder() / "a") << "content";
  std::ofstream(folder() / "b") << "content";
  const std::vector<fs::path> a = {folder() / "a"};
  const std::vector<fs::path> b = {folder() / "b"};
  EXPECT_NE(*HashOfFiles(a), *HashOfFiles(b));
  const std::string before = *HashOfFiles(a);
  std::ofstream(folder() / "a") << "Content";
  EXPECT_NE(*HashOfFiles(a), before);
  EXPECT_EQ(
      HashOfFiles(std::vector<fs::path>{folder() / "none"}).status().code(),
      absl::StatusCode::kNotFound);
}

TEST_F(Stages, AChildsLinesAreReadAndLogged) {
  std::vector<std::string> lines;
  const absl::Status status = cage::RunChildProcess(
      {.arguments = {"printf", "one\\ntwo words\\nthree"},
       .log = folder() / "log",
       .niceness = 0,
       .memory_bytes = 0,
       .on_line = [&](std::string_view line) { lines.emplace_back(line); },
       .is_cancelled = nullptr});
  EXPECT_TRUE(status.ok()) << status;
  EXPECT_THAT(lines, ElementsAre("one", "two words", "three"));
  EXPECT_EQ(*base::ReadFile(folder() / "log", 100), "one\ntwo words\nthree");
}

TEST_F(Stages, AChildsFailureQuotesItAndMissingOnesAreNamed) {
  const auto run = [&](std::vector<std::string> arguments) {
    return cage::RunChildProcess({.arguments = std::move(arguments),
                                  .log = folder() / "log",
                                  .niceness = 0,
                                  .memory_bytes = 0,
                                  .on_line = nullptr,
                                  .is_cancelled = nullptr});
  };
  const absl::Status failed = run({"sh", "-c", "echo no such luck; exit 3"});
  EXPECT_EQ(failed.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(failed.message()), HasSubstr("exit status 3"));
  EXPECT_THAT(std::string(failed.message()), HasSubstr("no such luck"));
  const absl::Status missing = run({"/no/such/program"});
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(missing.message()), HasSubstr("/no/such/program"));
}

TEST_F(Stages, ACancelledChildIsEndedWithWhatItStarted) {
  // The grandchild would write the file if it lived on.
  const fs::path file = folder() / "late";
  bool started = false;
  const absl::Status status = cage::RunChildProcess(
      {.arguments = {"sh",
                     "-c",
                     "echo started; (sleep 30; touch " + file.string() +
                         ") & sleep 60"},
       .log = folder() / "log",
       .niceness = 0,
       .memory_bytes = 0,
       .on_line = [&](std::string_view) { started = true; },
       .is_cancelled = [&] { return started; }});
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
  // The pipe has closed: nobody of the group holds it any more.
  EXPECT_FALSE(fs::exists(file));
}

TEST(ForEachInParallel, ReportsTheFirstErrorAndCancels) {
  // So many that the thread that fails is heard before the other is done.
  constexpr std::size_t kMany = 1'000'000'000;
  std::atomic<std::size_t> runs{0};
  const absl::Status failed = ForEachInParallel(
      kMany,
      2,
      [&](std::size_t i) {
        ++runs;
        return i == 5 ? absl::InternalError("five") : absl::OkStatus();
      },
      nullptr);
  EXPECT_EQ(failed.message(), "five");
  EXPECT_LT(runs.load(), kMany);
  EXPECT_TRUE(ForEachInParallel(
                  0, 2, [](std::size_t) { return absl::OkStatus(); }, nullptr)
                  .ok());
  const absl::Status cancelled = ForEachInParallel(
      kMany,
      2,
      [](std::size_t) { return absl::OkStatus(); },
      [](std::size_t) { return false; });
  EXPECT_EQ(cancelled.code(), absl::StatusCode::kCancelled);
}

}  // namespace
}  // namespace groundlock::build::internal
