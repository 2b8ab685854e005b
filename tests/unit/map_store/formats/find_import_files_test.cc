// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "map_store/formats/formats.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class FindImportFilesTest : public ::testing::Test {
 protected:
  void Touch(const fs::path& path, std::size_t size = 1) {
    fs::create_directories((root() / path).parent_path());
    std::ofstream(root() / path) << std::string(size, 'x');
  }
  void TouchModel(const std::string& folder,
                  const std::string& extension = ".bin",
                  std::size_t images_size = 1) {
    Touch(folder + "/cameras" + extension);
    Touch(folder + "/images" + extension, images_size);
    Touch(folder + "/points3D" + extension);
  }
  static std::vector<std::string> Remotes(const ImportFiles& files) {
    std::vector<std::string> remotes;
    for (const ImportFile& file : files.files) {
      EXPECT_TRUE(fs::is_regular_file(file.path)) << file.path;
      remotes.push_back(file.remote);
    }
    return remotes;
  }
  fs::path root() const { return fs::canonical(directory_.path()); }
  base::TemporaryDirectory directory_ = MakeTestDirectory();
};

TEST_F(FindImportFilesTest, FindsTheModelAndItsDatabaseAbove) {
  TouchModel("map/sparse/0");
  TouchModel("map/sparse/0", ".txt");
  Touch("map/database.db");
  for (const char* path : {"map", "map/", "map/sparse", "map/sparse/0"}) {
    const auto files = FindImportFiles(root() / path, {});
    ASSERT_TRUE(files.ok()) << path << ": " << files.status();
    EXPECT_EQ(files->format, Format::kColmap);
    EXPECT_EQ(files->files[0].path, root() / "map/sparse/0/cameras.bin");
    EXPECT_EQ(files->model, ".");
    EXPECT_EQ(files->database, "database.db");
    EXPECT_THAT(
        Remotes(*files),
        ElementsAre(
            "cameras.bin", "images.bin", "points3D.bin", "database.db"));
  }
}

TEST_F(FindImportFilesTest, TakesTextIfThereIsNoBinary) {
  TouchModel("m", ".txt");
  const auto files = FindImportFiles(root() / "m", {});
  ASSERT_TRUE(files.ok()) << files.status();
  EXPECT_EQ(files->model, ".");
  EXPECT_EQ(files->database, "");
  EXPECT_THAT(Remotes(*files),
              ElementsAre("cameras.txt", "images.txt", "points3D.txt"));
}

TEST_F(FindImportFilesTest, TakesTheLargestSubModelAndImportSaysSo) {
  TouchModel("m/sparse/0", ".bin", 10);
  TouchModel("m/sparse/1", ".bin", 1'000);
  TouchModel("m/sparse/10", ".bin", 100);
  const auto files = FindImportFiles(root() / "m", {});
  ASSERT_TRUE(files.ok());
  EXPECT_EQ(files->files[1].path, root() / "m/sparse/1/images.bin");
  std::vector<std::string> warnings;
  EXPECT_FALSE(Import(root() / "m", {}, &warnings).ok());
  EXPECT_THAT(warnings, Contains(HasSubstr("3 models; took the largest, 1")));
}

TEST_F(FindImportFilesTest, TakesADatabaseFromElsewhere) {
  TouchModel("a/model");
  Touch("b/features.db");
  ImportOptions options;
  options.database = root() / "b/features.db";
  const auto files = FindImportFiles(root() / "a/model", options);
  ASSERT_TRUE(files.ok());
  EXPECT_EQ(files->model, ".");
  EXPECT_EQ(files->database, "database.db");
  EXPECT_EQ(files->files[3].path, root() / "b/features.db");
  options.database = root() / "b/missing.db";
  EXPECT_TRUE(
      absl::IsNotFound(FindImportFiles(root() / "a/model", options).status()));
}

TEST_F(FindImportFilesTest, FindsSiftFilesOfAnNvm) {
  fs::create_directories(root() / "images");
  ASSERT_TRUE(
      Export(SyntheticMap({MakeCamera(geometry::CameraModelId::kSimplePinhole,
                                      {500, 320, 240})}),
             ExportFormat::kNvm,
             root() / "images/m.nvm")
          .ok());
  auto files = FindImportFiles(root() / "images", {});
  ASSERT_TRUE(files.ok()) << files.status();
  EXPECT_EQ(files->format, Format::kNvm);
  EXPECT_EQ(files->model, "m.nvm");
  EXPECT_THAT(Remotes(*files), ElementsAre("m.nvm", "images/view 0.sift"));
  // Now the .nvm somewhere else than the images.
  fs::create_directories(root() / "nvm");
  fs::rename(root() / "images/m.nvm", root() / "nvm/m.nvm");
  ImportOptions options;
  options.images = root() / "images";
  files = FindImportFiles(root() / "nvm/m.nvm", options);
  ASSERT_TRUE(files.ok()) << files.status();
  EXPECT_THAT(Remotes(*files), ElementsAre("m.nvm", "images/view 0.sift"));
  EXPECT_EQ(files->images, "images");
}

TEST_F(FindImportFilesTest, SaysWhatIsMissing) {
  EXPECT_TRUE(absl::IsNotFound(FindImportFiles(root() / "no", {}).status()));
  const absl::Status empty = FindImportFiles(root(), {}).status();
  EXPECT_TRUE(absl::IsNotFound(empty));
  EXPECT_THAT(std::string(empty.message()), HasSubstr("no COLMAP model here"));
  Touch("x.obj");
  EXPECT_EQ(FindImportFiles(root() / "x.obj", {}).status().code(),
            absl::StatusCode::kInvalidArgument);
  Touch("a.nvm");
  Touch("b.nvm");
  EXPECT_THAT(std::string(FindImportFiles(root(), {}).status().message()),
              HasSubstr("holds 2 .nvm files"));
}

}  // namespace
}  // namespace groundlock::formats
