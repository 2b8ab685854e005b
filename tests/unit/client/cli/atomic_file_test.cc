// SPDX-License-Identifier: Apache-2.0
#include "client/cli/atomic_file.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "map_store/base/file.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;

TEST(AtomicFile, AppearsWholeOrNotAtAll) {
  auto directory = base::TemporaryDirectory::Create(fs::temp_directory_path());
  ASSERT_TRUE(directory.ok()) << directory.status();
  const fs::path path = directory->path() / "out.csv";
  ASSERT_TRUE(base::WriteFileAtomically(path, "old").ok());
  {
    auto file = AtomicFile::Create(path);
    ASSERT_TRUE(file.ok()) << file.status();
    ASSERT_TRUE((*file)->Append("new").ok());
    EXPECT_EQ(*base::ReadFile(path, 100), "old");
  }
  EXPECT_EQ(*base::ReadFile(path, 100), "old");
  EXPECT_FALSE(fs::exists(PartialPath(path)));
  {
    auto file = AtomicFile::Create(path);
    ASSERT_TRUE(file.ok()) << file.status();
    ASSERT_TRUE((*file)->Append("new,").ok());
    ASSERT_TRUE((*file)->Append("line\n").ok());
    ASSERT_TRUE((*file)->Finish().ok());
  }
  EXPECT_EQ(*base::ReadFile(path, 100), "new,line\n");
  EXPECT_FALSE(fs::exists(PartialPath(path)));
}

TEST(AtomicFile, NamesThePathThatCannotBeWritten) {
  const auto file = AtomicFile::Create("/nonexistent-folder/out.csv");
  ASSERT_FALSE(file.ok());
  EXPECT_NE(file.status().message().find("/nonexistent-folder/out.csv"),
            absl::string_view::npos);
  EXPECT_FALSE(AtomicFile::Create(fs::temp_directory_path()).ok());
}

}  // namespace
}  // namespace groundlock::cli
