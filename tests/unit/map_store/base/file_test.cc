// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/file.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <thread>

#include "map_store/base/mix_seed.h"

namespace groundlock::base {
namespace {

namespace fs = std::filesystem;

class FileTest : public testing::Test {
 protected:
  void SetUp() override {
    auto made = TemporaryDirectory::Create(fs::temp_directory_path());
    ASSERT_TRUE(made.ok()) << made.status();
    directory_.emplace(*std::move(made));
  }
  fs::path Path(const char* name) const { return directory_->path() / name; }
  std::size_t NumFiles() const {
    return static_cast<std::size_t>(std::distance(
        fs::directory_iterator(directory_->path()), fs::directory_iterator()));
  }
  std::optional<TemporaryDirectory> directory_;
};

TEST_F(FileTest, WritesAndReadsBack) {
  const std::string content("a\0b\r\n", 5);
  ASSERT_TRUE(WriteFileAtomically(Path("f"), content).ok());
  const auto read = ReadFile(Path("f"), 5);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(*read, content);
}

TEST_F(FileTest, RefusesMoreThanTheLimit) {
  ASSERT_TRUE(WriteFileAtomically(Path("f"), "123456").ok());
  EXPECT_EQ(ReadFile(Path("f"), 5).status().code(),
            absl::StatusCode::kResourceExhausted);
}

TEST_F(FileTest, NamesWhatIsMissingOrNoFile) {
  EXPECT_EQ(ReadFile(Path("none"), 5).status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(ReadFile(directory_->path(), 5).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST_F(FileTest, AtomicFileAppearsOnCommitOnly) {
  {
    auto file = AtomicFile::Create(Path("f"));
    ASSERT_TRUE(file.ok()) << file.status();
    ASSERT_TRUE(file->Write("....tail").ok());
    ASSERT_TRUE(file->WriteAt(0, "head").ok());
    EXPECT_FALSE(fs::exists(Path("f")));
    ASSERT_TRUE(file->Commit().ok());
  }
  EXPECT_EQ(*ReadFile(Path("f"), 100), "headtail");
  EXPECT_EQ(NumFiles(), 1U);
}

TEST_F(FileTest, AbandonedAtomicFileLeavesTheOldContent) {
  ASSERT_TRUE(WriteFileAtomically(Path("f"), "old").ok());
  {
    auto file = AtomicFile::Create(Path("f"));
    ASSERT_TRUE(file.ok()) << file.status();
    ASSERT_TRUE(file->Write("new").ok());
    AtomicFile moved = *std::move(file);
  }
  EXPECT_EQ(*ReadFile(Path("f"), 100), "old");
  EXPECT_EQ(NumFiles(), 1U);
}

TEST_F(FileTest, ThePortFileHoldsOneLine) {
  ASSERT_TRUE(WritePortFile(Path("port"), 50551).ok());
  EXPECT_EQ(*ReadFile(Path("port"), 100), "50551\n");
  EXPECT_EQ(NumFiles(), 1U);
}

// Clients hand the server a folder of their own for it, and remove that as soon
// as they have read the port. Plain system calls are fast enough to get between
// any two of the writer's.
TEST_F(FileTest, WhoHasReadThePortFileMayRemoveItsFolder) {
  for (int i = 0; i < 200; ++i) {
    auto folder = TemporaryDirectory::Create(directory_->path());
    ASSERT_TRUE(folder.ok()) << folder.status();
    const fs::path port_file = folder->path() / "port";
    std::jthread reader([&](const std::stop_token& stop) {
      while (unlink(port_file.c_str()) != 0 && !stop.stop_requested()) {
      }
      rmdir(folder->path().c_str());
    });
    const absl::Status written = WritePortFile(port_file, 50551);
    ASSERT_TRUE(written.ok()) << written << " in round " << i;
    reader.join();
    ASSERT_FALSE(fs::exists(folder->path()));
  }
}

TEST_F(FileTest, TemporaryDirectoryGoesUnlessReleased) {
  fs::path gone;
  fs::path kept;
  {
    auto a = TemporaryDirectory::Create(directory_->path());
    auto b = TemporaryDirectory::Create(directory_->path());
    ASSERT_TRUE(a.ok() && b.ok());
    gone = a->path();
    std::ofstream(gone / "content") << "x";
    kept = b->Release();
  }
  EXPECT_FALSE(fs::exists(gone));
  EXPECT_TRUE(fs::exists(kept));
}

TEST(MixSeedTest, NeighboursDiffer) {
  EXPECT_NE(MixSeed(1, 2), MixSeed(2, 1));
  EXPECT_NE(MixSeed(0, 0), MixSeed(0, 1));
  EXPECT_EQ(MixSeed(7, 9), MixSeed(7, 9));
}

}  // namespace
}  // namespace groundlock::base
