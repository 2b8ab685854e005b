// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/photo_readings.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/formats/formats.h"
#include "tests/support/photo_xmp.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

TEST(PhotoReadings, ComeBackFromTheirFile) {
  const std::vector<map::PhotoReading> readings = {
      {"a.jpg", Eigen::Vector3d(0.0, -0.6, -0.8), std::nullopt},
      {"b \"1\".jpg", std::nullopt, Eigen::Vector3d(10.5, -3.0, 120.0)},
      {"c.jpg", Eigen::Vector3d(1.0, 0.0, 0.0), Eigen::Vector3d::Zero()}};
  const map::UprightEdges edges{Eigen::Vector3d(0.6, 0.0, 0.8), 321};
  const auto parsed = ParseUpReadings(UpReadingsToJson({readings, edges}), "f");
  ASSERT_TRUE(parsed.ok()) << parsed.status();
  ASSERT_TRUE(parsed->edges.has_value());
  EXPECT_LT((parsed->edges->up_world - edges.up_world).norm(), 1e-12);
  EXPECT_EQ(parsed->edges->count, 321);
  const std::vector<map::PhotoReading>* again = &parsed->photos;
  ASSERT_EQ(again->size(), readings.size());
  for (std::size_t i = 0; i < readings.size(); ++i) {
    EXPECT_EQ((*again)[i].image, readings[i].image);
    ASSERT_EQ((*again)[i].up_camera.has_value(),
              readings[i].up_camera.has_value());
    ASSERT_EQ((*again)[i].p_local_m.has_value(),
              readings[i].p_local_m.has_value());
    if (readings[i].up_camera) {
      EXPECT_LT((*(*again)[i].up_camera - *readings[i].up_camera).norm(),
                1e-12);
    }
    if (readings[i].p_local_m) {
      EXPECT_EQ(*(*again)[i].p_local_m, *readings[i].p_local_m);
    }
  }
}

TEST(PhotoReadings, SayWhatIsWrong) {
  const auto error = [](const std::string& text) {
    return std::string(ParseUpReadings(text, "f").status().message());
  };
  EXPECT_THAT(error("{"), HasSubstr("f"));
  EXPECT_THAT(error("{}"), HasSubstr("photos"));
  EXPECT_THAT(error(R"({"photos":3})"), HasSubstr("photos"));
  EXPECT_THAT(error(R"({"photos":[{"up_camera":[0,0,1]}]})"),
              HasSubstr("photos[0]"));
  EXPECT_THAT(error(R"({"photos":[{"image":"a","up_camera":[0,0,2]}]})"),
              HasSubstr("photos[0]: up_camera: not of length 1"));
  EXPECT_THAT(error(R"({"photos":[{"image":"a","up_camera":[0,1]}]})"),
              HasSubstr("up_camera"));
  EXPECT_THAT(error(R"({"photos":[{"image":"a","p_local_m":[0,0,1e9]}]})"),
              HasSubstr("p_local_m"));
  EXPECT_THAT(error(R"({"photos":[],"upright_edges":{"up_model":[1,1,0]}})"),
              HasSubstr("upright_edges: up_model: not of length 1"));
  EXPECT_THAT(error(R"({"photos":[],)"
                    R"("upright_edges":{"up_model":[1,0,0],"count":-1}})"),
              HasSubstr("count"));
}

// The drone of this flight wrote where it was, and nothing of how it was held.
TEST(PhotoReadings, OfADroneFlight) {
  const auto folder = DataFolder() / "caliterra/images";
  if (!fs::exists(folder)) GTEST_SKIP() << folder;
  const auto readings = ReadPhotoReadings(folder);
  ASSERT_TRUE(readings.ok()) << readings.status();
  ASSERT_EQ(readings->size(), 40U);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const map::PhotoReading& reading : *readings) {
    EXPECT_FALSE(reading.up_camera.has_value());
    ASSERT_TRUE(reading.p_local_m.has_value());
    sum += *reading.p_local_m;
  }
  // Counted from their middle.
  EXPECT_LT(sum.norm() / 40.0, 1.0);
}

TEST(PhotoReadings, LieBesideAModelAndTellItsUp) {
  const auto folder =
      base::TemporaryDirectory::Create(fs::temp_directory_path());
  ASSERT_TRUE(folder.ok()) << folder.status();
  const fs::path model = folder->path() / "model";
  const map::MapData data = SyntheticMap(AllCameraModels());
  ASSERT_TRUE(Export(data, ExportFormat::kColmapBinary, model).ok());
  std::vector<std::string> warnings;
  const auto without = Import(model, {}, &warnings);
  ASSERT_TRUE(without.ok()) << without.status();
  EXPECT_FALSE(without->measured_up.has_value());

  // Whatever the cameras do, their photos agree on one up.
  const Eigen::Vector3d up = Eigen::Vector3d(0.3, -0.5, 0.8).normalized();
  fs::create_directories(folder->path() / "photos");
  for (const map::MapViewData& view : data.views) {
    std::ofstream(folder->path() / "photos" / view.name, std::ios::binary)
        << test_support::WithSegment(
               test_support::EmptyJpeg(),
               test_support::XmpSegment(test_support::DjiPacket(
                   view.camera_from_world.rotation * up)));
  }
  const auto readings = ReadPhotoReadings(folder->path() / "photos");
  ASSERT_TRUE(readings.ok()) << readings.status();
  ASSERT_EQ(readings->size(), data.views.size());
  ASSERT_TRUE(base::WriteFileAtomically(model / kPhotoReadingsFile,
                                        UpReadingsToJson({*readings, {}}))
                  .ok());
  const auto with = Import(model, {}, &warnings);
  ASSERT_TRUE(with.ok()) << with.status();
  ASSERT_TRUE(with->measured_up.has_value());
  EXPECT_LT((with->measured_up->up_world - up).norm(), 1e-3);
  const auto files = FindImportFiles(model, {});
  ASSERT_TRUE(files.ok()) << files.status();
  EXPECT_TRUE(std::any_of(
      files->files.begin(), files->files.end(), [](const ImportFile& file) {
        return file.remote == kPhotoReadingsFile;
      }));
  // A damaged file is no reason to guess.
  std::ofstream(model / kPhotoReadingsFile) << "{\"photos\":[{}]}";
  EXPECT_EQ(Import(model, {}, &warnings).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace groundlock::formats
