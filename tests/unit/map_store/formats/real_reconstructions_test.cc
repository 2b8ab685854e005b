// SPDX-License-Identifier: Apache-2.0
// Reconstructions that VisualSFM and COLMAP wrote: counts as their authors
// state them, and reprojection errors as the tools do.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "map_store/formats/formats.h"
#include "map_store/formats/internal/nvm_model.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;

struct Expected {
  std::string folder;
  std::size_t cameras;
  std::size_t views;
  std::size_t landmarks;
  std::size_t observations;
  bool descriptors;
};

#define SKIP_WITHOUT(path)                                       \
  if (!fs::exists(path)) {                                       \
    GTEST_SKIP() << (path)                                       \
                 << " is not there: set GROUNDLOCK_DATA to the " \
                    "folder with the test data";                 \
  }

void ExpectCounts(const Expected& expected, const map::MapData& data) {
  EXPECT_EQ(data.cameras.size(), expected.cameras);
  EXPECT_EQ(data.views.size(), expected.views);
  EXPECT_EQ(data.landmarks.size(), expected.landmarks);
  EXPECT_EQ(NumObservations(data), expected.observations);
  EXPECT_EQ(data.has_descriptors(), expected.descriptors);
}

// Mean over landmarks of the mean error of each one's observations, as COLMAP
// stores it.
double MeanPointErrorPx(const map::MapData& data) {
  std::vector<double> sum(data.landmarks.size(), 0.0);
  std::vector<int> count(data.landmarks.size(), 0);
  for (const map::MapViewData& view : data.views) {
    for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
      const std::uint32_t landmark = view.landmarks[i];
      const auto pixel = data.cameras[view.camera].ImageFromCamera(
          view.camera_from_world * data.landmarks[landmark].p_world);
      if (!pixel) continue;
      sum[landmark] += (*pixel - view.keypoints_px[i].cast<double>()).norm();
      ++count[landmark];
    }
  }
  double total = 0.0;
  for (std::size_t i = 0; i < sum.size(); ++i) {
    if (count[i] > 0) total += sum[i] / count[i];
  }
  return total / static_cast<double>(sum.size());
}

class ColmapModels : public ::testing::TestWithParam<Expected> {};

TEST_P(ColmapModels, CountsAndErrorsAreTheToolsOwn) {
  const fs::path path = DataFolder() / GetParam().folder;
  SKIP_WITHOUT(path);
  std::vector<std::string> warnings;
  const auto data = Import(path, {}, &warnings);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_TRUE(warnings.empty()) << warnings[0];
  ExpectCounts(GetParam(), *data);
  double stored_px = 0.0;
  for (const map::MapLandmarkData& landmark : data->landmarks) {
    stored_px += landmark.error_px;
  }
  stored_px /= static_cast<double>(data->landmarks.size());
  // Our keypoints are floats and COLMAP's camera the same formulas: a fraction
  // of a per cent is the few points it did not update after the last bundle
  // adjustment.
  EXPECT_NEAR(MeanPointErrorPx(*data) / stored_px, 1.0, 0.01);
  EXPECT_EQ(map::ComputeReprojection(*data).num_behind_camera, 0U);
}

INSTANTIATE_TEST_SUITE_P(
    All,
    ColmapModels,
    ::testing::Values(
        Expected{"importers/colmap_bin_bartoszek", 23, 23, 1443, 5931, true},
        Expected{"plaza/map", 1, 68, 16929, 70421, true},
        Expected{"sim/lot/map", 1, 72, 12875, 94200, true}),
    [](const auto& param_info) {
      std::string name = param_info.param.folder;
      for (char& c : name) {
        if (c == '/') c = '_';
      }
      return name;
    });

TEST(ColmapUndistorted, PinholeModelFitsBetterThanAPixel) {
  const fs::path path = DataFolder() / "importers/colmap_bin_bartoszek/dense/0";
  SKIP_WITHOUT(path);
  std::vector<std::string> warnings;
  const auto data = Import(path, {}, &warnings);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_THAT(warnings, Contains(HasSubstr("no descriptors")));
  ExpectCounts({"", 23, 23, 1443, 5931, false}, *data);
  EXPECT_EQ(data->cameras[0].id(), geometry::CameraModelId::kPinhole);
  EXPECT_EQ(data->cameras[0].width_px(), 1000);
  // 0.85 px in images three times as wide (the errors in the file are those).
  EXPECT_LT(map::ComputeReprojection(*data).mean_error_px, 0.35);
}

TEST(VisualSfm, ReadNvmHasItsCountsAndFits) {
  const fs::path path = DataFolder() / "importers/visualsfm_readnvm/model.nvm";
  SKIP_WITHOUT(path);
  std::vector<std::string> warnings;
  const auto data = Import(path, {}, &warnings);
  ASSERT_TRUE(data.ok()) << data.status();
  ExpectCounts({"", 28, 28, 4383, 11781, false}, *data);
  const auto reprojection = map::ComputeReprojection(*data);
  EXPECT_EQ(reprojection.num_behind_camera, 0U);
  EXPECT_LT(reprojection.mean_error_px, 1.0);
  // One image's .sift file gives the size of them all; the other files lack.
  EXPECT_EQ(data->cameras[5].width_px(), 1800);
  EXPECT_EQ(data->cameras[5].height_px(), 1200);
  EXPECT_THAT(warnings, Contains(HasSubstr("27 of 28 images")));
}

TEST(VisualSfm, SiftFileBelongsToItsImage) {
  const fs::path folder = DataFolder() / "importers/visualsfm_readnvm";
  SKIP_WITHOUT(folder);
  const auto bytes = base::ReadFile(folder / "00000019.sift", 1 << 24);
  ASSERT_TRUE(bytes.ok());
  const auto sift = internal::SiftFile::Parse(*bytes, "00000019.sift");
  ASSERT_TRUE(sift.ok()) << sift.status();
  EXPECT_EQ(sift->size(), 3931U);
  const auto text = base::ReadFile(folder / "model.nvm", 1 << 24);
  ASSERT_TRUE(text.ok());
  const auto nvm = internal::ParseNvm(*text, "model.nvm");
  ASSERT_TRUE(nvm.ok()) << nvm.status();
  std::size_t count = 0;
  for (const internal::NvmMeasurement& m : nvm->model.measurements) {
    if (m.camera != 0) continue;
    ++count;
    ASSERT_LT(m.feature, sift->size());
    // Floats at 1800 px are 1e-4 apart.
    EXPECT_LT(
        (sift->KeypointPx(m.feature) - m.xy_px - Eigen::Vector2f(900, 600))
            .norm(),
        5e-4);
  }
  EXPECT_EQ(count, 429U);
}

// This one's distortion is strong (r up to 0.9): it tells the direction.
TEST(VisualSfm, NvmconvFitsOnlyWithTheRightDistortion) {
  const fs::path path = DataFolder() / "importers/visualsfm_nvmconv/model.nvm";
  SKIP_WITHOUT(path);
  auto data = Import(path, {}, nullptr);
  ASSERT_TRUE(data.ok()) << data.status();
  ExpectCounts({"", 22, 22, 853, 3219, false}, *data);
  const auto reprojection = map::ComputeReprojection(*data);
  EXPECT_EQ(reprojection.num_behind_camera, 0U);
  EXPECT_LT(reprojection.mean_error_px, 1.1);

  const auto text = base::ReadFile(path, 1 << 24);
  const auto nvm = internal::ParseNvm(*text, "model.nvm");
  ASSERT_TRUE(nvm.ok());
  // NVM's r taken for SIMPLE_RADIAL's k, and the first-order inverse -r.
  for (const double sign : {1.0, -1.0}) {
    map::MapData naive = *data;
    naive.cameras.clear();
    for (std::size_t i = 0; i < naive.views.size(); ++i) {
      const geometry::CameraModel& right = data->cameras[data->views[i].camera];
      const Eigen::Vector2d center_px = right.principal_point_px();
      const auto wrong = geometry::CameraModel::Create(
          geometry::CameraModelId::kSimpleRadial,
          right.width_px(),
          right.height_px(),
          std::vector<double>{nvm->model.cameras[i].focal_px,
                              center_px.x(),
                              center_px.y(),
                              sign * nvm->model.cameras[i].r});
      ASSERT_TRUE(wrong.ok());
      naive.cameras.push_back(*wrong);
      naive.views[i].camera = static_cast<std::uint32_t>(i);
    }
    EXPECT_GT(map::ComputeReprojection(naive).mean_error_px,
              reprojection.mean_error_px)
        << sign;
  }
}

// The whole way over foreign formats and back, on real input.
TEST(RealRoundTrip, PlazaThroughNvmKeepsItsGeometry) {
  const fs::path path = DataFolder() / "plaza/map";
  SKIP_WITHOUT(path);
  const auto a = Import(path, {}, nullptr);
  ASSERT_TRUE(a.ok()) << a.status();
  const base::TemporaryDirectory directory = MakeTestDirectory();
  ASSERT_TRUE(Export(*a, ExportFormat::kNvm, directory.path() / "m.nvm").ok());
  const auto b = Import(directory.path() / "m.nvm", {}, nullptr);
  ASSERT_TRUE(b.ok()) << b.status();
  ExpectCounts({"", 1, 68, 16929, 70421, true}, *b);
  EXPECT_EQ(b->cameras[0].width_px(), 1280);
  EXPECT_NEAR(map::ComputeReprojection(*b).mean_error_px,
              map::ComputeReprojection(*a).mean_error_px,
              0.02);
}

}  // namespace
}  // namespace groundlock::formats
