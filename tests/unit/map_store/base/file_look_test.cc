// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/file_look.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "map_store/base/file.h"

namespace groundlock::base {
namespace {

namespace fs = std::filesystem;

class FileLookTest : public ::testing::Test {
 protected:
  void Write(const std::string& text) { std::ofstream(file_) << text; }

  TemporaryDirectory directory_ =
      *TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path file_ = directory_.path() / "file";
};

TEST_F(FileLookTest, IsTheSameAsLongAsTheFileIs) {
  EXPECT_EQ(LookOf(file_), "");
  Write("one");
  EXPECT_NE(LookOf(file_), "");
  EXPECT_EQ(LookOf(file_), LookOf(file_));
}

TEST_F(FileLookTest, ChangesWithTheContentWhateverTheClockSays) {
  Write("one");
  const auto written = fs::last_write_time(file_);
  const std::string look = LookOf(file_);
  Write("two");
  fs::last_write_time(file_, written);
  EXPECT_NE(LookOf(file_), look);
}

TEST_F(FileLookTest, ChangesWithThePermissions) {
  Write("one");
  fs::permissions(file_, fs::perms::owner_read | fs::perms::others_read);
  const std::string look = LookOf(file_);
  fs::permissions(file_, fs::perms::owner_read);
  EXPECT_NE(LookOf(file_), look);
}

TEST_F(FileLookTest, OthersMayNotReadASecret) {
  EXPECT_FALSE(CheckPrivate(file_).ok());
  Write("secret");
  fs::permissions(file_, fs::perms::owner_read | fs::perms::others_read);
  EXPECT_FALSE(CheckPrivate(file_).ok());
  fs::permissions(file_, fs::perms::owner_read);
  EXPECT_TRUE(CheckPrivate(file_).ok());
}

}  // namespace
}  // namespace groundlock::base
