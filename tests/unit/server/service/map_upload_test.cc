// SPDX-License-Identifier: Apache-2.0
#include "server/service/map_upload.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

namespace groundlock::service {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class MapUploadTest : public ::testing::Test {
 protected:
  MapUploadTest()
      : directory_(
            *base::TemporaryDirectory::Create(fs::temp_directory_path())),
        scratch_(*ScratchSpace::Open(directory_.path() / "scratch")) {}

  base::TemporaryDirectory directory_;
  std::unique_ptr<ScratchSpace> scratch_;
  MapLimits limits_;
};

TEST_F(MapUploadTest, WritesFilesAndRemovesThem) {
  auto upload = MapUpload::Create(*scratch_, limits_);
  ASSERT_TRUE(upload.ok()) << upload.status();
  ASSERT_TRUE((*upload)->StartFile("sparse/0/cameras.bin", 6).ok());
  ASSERT_TRUE((*upload)->AddChunk("abc").ok());
  ASSERT_TRUE((*upload)->AddChunk("def").ok());
  ASSERT_TRUE((*upload)->StartFile("empty", 0).ok());
  ASSERT_TRUE((*upload)->Finish(2).ok());
  const auto path = (*upload)->Resolve("sparse/0/cameras.bin", "model_path");
  ASSERT_TRUE(path.ok());
  std::string content;
  std::ifstream(*path) >> content;
  EXPECT_EQ(content, "abcdef");
  EXPECT_TRUE((*upload)->Resolve(".", "model_path").ok());
  EXPECT_FALSE((*upload)->Resolve("sparse/1", "model_path").ok());
  EXPECT_FALSE((*upload)->Resolve("../..", "model_path").ok());
  EXPECT_EQ((*upload)->Anonymized("bad " + path->string() + ": no"),
            "bad sparse/0/cameras.bin: no");
  *upload = nullptr;
  EXPECT_TRUE(fs::is_empty(directory_.path() / "scratch"));
}

TEST_F(MapUploadTest, LimitsHold) {
  limits_.max_files = 2;
  limits_.max_file_bytes = 10;
  limits_.max_total_bytes = 15;
  auto upload = *MapUpload::Create(*scratch_, limits_);
  EXPECT_EQ(upload->StartFile("a", 11).code(),
            absl::StatusCode::kResourceExhausted);
  ASSERT_TRUE(upload->StartFile("a", 10).ok());
  ASSERT_TRUE(upload->AddChunk("0123456789").ok());
  EXPECT_EQ(upload->StartFile("b", 6).code(),
            absl::StatusCode::kResourceExhausted);
  ASSERT_TRUE(upload->StartFile("b", 0).ok());
  EXPECT_EQ(upload->StartFile("c", 0).code(),
            absl::StatusCode::kResourceExhausted);
}

TEST_F(MapUploadTest, FoldersAreBoundedLikeFiles) {
  limits_.max_files = 3;
  auto upload = *MapUpload::Create(*scratch_, limits_);
  ASSERT_TRUE(upload->StartFile("a/b/1", 0).ok());
  ASSERT_TRUE(upload->StartFile("a/b/2", 0).ok()) << "they are there";
  EXPECT_EQ(upload->StartFile("a/c/d/e/f/3", 0).code(),
            absl::StatusCode::kResourceExhausted);
}

TEST_F(MapUploadTest, TheDiskIsNotFilled) {
  limits_.min_free_bytes = fs::space(directory_.path()).available / 2;
  auto upload = *MapUpload::Create(*scratch_, limits_);
  ASSERT_TRUE(upload->StartFile("a", 1).ok());
  ASSERT_TRUE(upload->AddChunk("a").ok());
  limits_.min_free_bytes = std::uint64_t{1} << 60;
  upload = *MapUpload::Create(*scratch_, limits_);
  EXPECT_THAT(upload->StartFile("a", 1).ToString(), HasSubstr("disk is full"));
}

TEST_F(MapUploadTest, AFileCannotBeAFolderToo) {
  auto upload = *MapUpload::Create(*scratch_, limits_);
  ASSERT_TRUE(upload->StartFile("a", 0).ok());
  EXPECT_THAT(upload->StartFile("a/b", 0).ToString(), HasSubstr("collides"));
}

TEST_F(MapUploadTest, DirectoriesInUseSurviveAnotherServersStart) {
  auto upload = *MapUpload::Create(*scratch_, limits_);
  ASSERT_TRUE(upload->StartFile("a", 0).ok());
  fs::create_directory(directory_.path() / "scratch" / ".tmp-left");
  ASSERT_TRUE(ScratchSpace::Open(directory_.path() / "scratch").ok());
  EXPECT_TRUE(upload->Resolve("a", "").ok());
  EXPECT_FALSE(fs::exists(directory_.path() / "scratch" / ".tmp-left"));
}

TEST(ValidateRelativePath, Cases) {
  for (const char* good : {"a", "a/b.bin", ".hidden", "a b/c", "..a/b.."}) {
    EXPECT_TRUE(ValidateRelativePath(good, "f").ok()) << good;
  }
  for (const std::string bad : {"",
                                "/",
                                "/a",
                                "a/",
                                "a//b",
                                ".",
                                "..",
                                "a/..",
                                "../a",
                                "a/./b",
                                "a\\b",
                                "a\nb"}) {
    EXPECT_FALSE(ValidateRelativePath(bad, "f").ok()) << bad;
  }
  EXPECT_FALSE(ValidateRelativePath(std::string("a\0b", 3), "f").ok());
  EXPECT_FALSE(ValidateRelativePath(std::string(256, 'a'), "f").ok());
  EXPECT_FALSE(ValidateRelativePath(std::string(2'000, 'a'), "f").ok());
}

}  // namespace
}  // namespace groundlock::service
