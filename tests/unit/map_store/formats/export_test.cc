// SPDX-License-Identifier: Apache-2.0
// Export, import again, compare; and that an export is whole or absent.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>

#include "map_store/formats/formats.h"
#include "map_store/formats/internal/descriptors.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

void ExpectSameStructure(const map::MapData& a, const map::MapData& b) {
  ASSERT_EQ(a.views.size(), b.views.size());
  ASSERT_EQ(a.landmarks.size(), b.landmarks.size());
  for (std::size_t i = 0; i < a.views.size(); ++i) {
    EXPECT_EQ(a.views[i].name, b.views[i].name);
    EXPECT_EQ(a.views[i].landmarks, b.views[i].landmarks);
    EXPECT_EQ(a.views[i].descriptors.size(), b.views[i].descriptors.size());
  }
  for (std::size_t i = 0; i < a.landmarks.size(); ++i) {
    EXPECT_EQ(a.landmarks[i].rgb, b.landmarks[i].rgb);
  }
}

// Doubles are written in full; the quaternion is normalised again on import.
constexpr double kExact = 1e-12;

class ColmapRoundTrip : public ::testing::TestWithParam<ExportFormat> {};

TEST_P(ColmapRoundTrip, GivesTheSameNumbers) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const fs::path path = directory.path() / "model";
  const map::MapData a = SyntheticMap(AllCameraModels());
  ASSERT_TRUE(Export(a, GetParam(), path).ok());
  std::vector<std::string> warnings;
  const auto b = Import(path, {}, &warnings);
  ASSERT_TRUE(b.ok()) << b.status();
  EXPECT_TRUE(warnings.empty()) << warnings[0];
  ExpectSameStructure(a, *b);
  EXPECT_EQ(a.cameras, b->cameras);
  for (std::size_t i = 0; i < a.views.size(); ++i) {
    const map::MapViewData& va = a.views[i];
    const map::MapViewData& vb = b->views[i];
    EXPECT_EQ(va.camera, vb.camera);
    EXPECT_EQ(va.keypoints_px, vb.keypoints_px);
    EXPECT_EQ(va.descriptors, vb.descriptors);
    EXPECT_LT((va.camera_from_world.rotation.coeffs() -
               vb.camera_from_world.rotation.coeffs())
                  .norm(),
              kExact);
    EXPECT_EQ(va.camera_from_world.translation,
              vb.camera_from_world.translation);
  }
  for (std::size_t i = 0; i < a.landmarks.size(); ++i) {
    EXPECT_EQ(a.landmarks[i].p_world, b->landmarks[i].p_world);
    EXPECT_EQ(a.landmarks[i].error_px, b->landmarks[i].error_px);
  }
}

INSTANTIATE_TEST_SUITE_P(BinaryAndText,
                         ColmapRoundTrip,
                         ::testing::Values(ExportFormat::kColmapBinary,
                                           ExportFormat::kColmapText));

std::vector<geometry::CameraModel> NvmCameras() {
  using geometry::CameraModelId;
  // NVM holds a focal length and one coefficient; the second camera's principal
  // point is off the centre.
  return {MakeCamera(CameraModelId::kSimpleRadial, {500, 320, 240, -0.05}),
          MakeCamera(CameraModelId::kSimpleRadial, {520, 322.5, 241, 0.04}),
          MakeCamera(CameraModelId::kSimplePinhole, {510, 320, 240})};
}

TEST(NvmRoundTrip, KeepsGeometryAndPixels) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const map::MapData a = SyntheticMap(NvmCameras());
  std::vector<std::string> warnings;
  ASSERT_TRUE(
      Export(a, ExportFormat::kNvm, directory.path() / "map.nvm", &warnings)
          .ok());
  const auto b = Import(directory.path(), {}, &warnings);
  ASSERT_TRUE(b.ok()) << b.status();
  ExpectSameStructure(a, *b);
  for (std::size_t i = 0; i < a.views.size(); ++i) {
    const map::MapViewData& va = a.views[i];
    const map::MapViewData& vb = b->views[i];
    EXPECT_LT((va.camera_from_world.Inverse().translation -
               vb.camera_from_world.Inverse().translation)
                  .norm(),
              1e-9);
    for (std::size_t j = 0; j < va.keypoints_px.size(); ++j) {
      // Two roundings to float at 640 px: 2 * 3e-5.
      EXPECT_LT((va.keypoints_px[j] - vb.keypoints_px[j]).norm(), 1e-4);
    }
  }
  // The points were projected exactly; what is left is what two fits of one
  // coefficient in the other direction cost inside the image.
  EXPECT_LT(map::ComputeReprojection(*b).mean_error_px, 0.05);
  EXPECT_EQ(map::ComputeReprojection(*b).num_behind_camera, 0U);
}

TEST(NvmRoundTrip, KeepsDescriptorsUpToRounding) {
  // SIFT (8 bits) -> RootSIFT -> SIFT. A root r = 512 sqrt(s / sum) is off by
  // 0.5, hence s = r^2 sum / 512^2 by s / r: with sum around 4,600 that is 1.4
  // for the largest s, 110; then twice half a unit for rounding.
  std::mt19937_64 generator(3);
  std::geometric_distribution<int> bin(0.03);
  for (int trial = 0; trial < 100; ++trial) {
    // As extractors do (Lowe 2004, section 6.1): unit length, clamped at 0.2,
    // unit length again; so no value comes near 255.
    Eigen::VectorXd raw(128);
    for (double& v : raw) v = bin(generator);
    raw = raw.normalized().cwiseMin(0.2).normalized();
    std::array<std::uint8_t, 128> sift{};
    for (std::size_t i = 0; i < 128; ++i) {
      sift[i] = static_cast<std::uint8_t>(
          std::round(512.0 * raw[static_cast<Eigen::Index>(i)]));
    }
    const map::Descriptor root = internal::RootSiftFromSift(sift);
    double squared = 0.0;
    for (const std::uint8_t v : root) squared += static_cast<double>(v) * v;
    // Square roots of an L1-normalised vector have unit L2 norm, times 512.
    EXPECT_NEAR(std::sqrt(squared), 512.0, 3.0);
    const map::Descriptor back = internal::SiftFromRootSift(root);
    for (std::size_t i = 0; i < 128; ++i) EXPECT_NEAR(back[i], sift[i], 3);
  }
}

TEST(Descriptors, ZeroStaysZero) {
  const map::Descriptor zero{};
  EXPECT_EQ(internal::RootSiftFromSift(zero), zero);
  EXPECT_EQ(internal::SiftFromRootSift(zero), zero);
}

TEST(Export, PlyHoldsEveryLandmark) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const fs::path path = directory.path() / "map.ply";
  const map::MapData data = SyntheticMap(NvmCameras());
  ASSERT_TRUE(Export(data, ExportFormat::kPly, path).ok());
  const auto bytes = base::ReadFile(path, 1 << 20);
  ASSERT_TRUE(bytes.ok());
  EXPECT_THAT(*bytes, HasSubstr("element vertex 60\n"));
  const std::string end = "end_header\n";
  const std::size_t begin = bytes->find(end) + end.size();
  ASSERT_EQ(bytes->size() - begin, data.landmarks.size() * 27);
  double x = 0.0;
  std::memcpy(&x, bytes->data() + begin + 27, sizeof(x));
  EXPECT_EQ(x, data.landmarks[1].p_world.x());
  EXPECT_EQ(static_cast<std::uint8_t>((*bytes)[begin + 27 + 24]),
            data.landmarks[1].rgb[0]);
}

TEST(Export, RefusesToOverwrite) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const map::MapData data = SyntheticMap(NvmCameras());
  const fs::path path = directory.path() / "there";
  std::ofstream(path) << "precious";
  for (const ExportFormat format : {ExportFormat::kColmapBinary,
                                    ExportFormat::kColmapText,
                                    ExportFormat::kNvm,
                                    ExportFormat::kPly}) {
    EXPECT_TRUE(absl::IsAlreadyExists(Export(data, format, path)));
  }
  EXPECT_EQ(*base::ReadFile(path, 100), "precious");
}

TEST(Export, NvmRefusesToOverwriteASiftFileAndLeavesNothing) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const map::MapData data = SyntheticMap(NvmCameras());
  std::ofstream(directory.path() / "view 1.sift") << "precious";
  const absl::Status status =
      Export(data, ExportFormat::kNvm, directory.path() / "map.nvm");
  EXPECT_TRUE(absl::IsAlreadyExists(status)) << status;
  std::size_t count = 0;
  for (const auto& entry : fs::directory_iterator(directory.path())) {
    (void)entry;
    ++count;
  }
  EXPECT_EQ(count, 1U);
}

TEST(Export, NvmKeepsHostileNamesBesideTheFile) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  map::MapData data = SyntheticMap(NvmCameras());
  data.views[0].name = "../../escape.jpg";
  data.views[1].name = "#comment.jpg";
  fs::create_directory(directory.path() / "a");
  const fs::path path = directory.path() / "a" / "map.nvm";
  ASSERT_TRUE(Export(data, ExportFormat::kNvm, path).ok());
  EXPECT_TRUE(fs::exists(directory.path() / "a" / ".._.._escape.sift"));
  const auto back = Import(path, {}, nullptr);
  ASSERT_TRUE(back.ok()) << back.status();
  EXPECT_EQ(NumObservations(*back), NumObservations(data));
  EXPECT_TRUE(back->has_descriptors());
}

TEST(Export, NvmRefusesACameraItCannotExpress) {
  const base::TemporaryDirectory directory = MakeTestDirectory();
  const map::MapData data = SyntheticMap(
      {MakeCamera(geometry::CameraModelId::kPinhole, {500, 700, 320, 240})});
  const absl::Status status =
      Export(data, ExportFormat::kNvm, directory.path() / "map.nvm");
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()), HasSubstr("camera 0"));
  EXPECT_TRUE(fs::is_empty(directory.path()));
}

TEST(Export, FailsWhereItCannotWriteAndLeavesNothing) {
  const map::MapData data = SyntheticMap(NvmCameras());
  EXPECT_FALSE(
      Export(data, ExportFormat::kColmapBinary, "/nonexistent/model").ok());
  EXPECT_FALSE(Export(data, ExportFormat::kPly, "/nonexistent/m.ply").ok());
}

TEST(Names, AreKnownOrListed) {
  EXPECT_EQ(*FormatFromName("nvm"), Format::kNvm);
  EXPECT_EQ(FormatName(Format::kColmap), "colmap");
  EXPECT_EQ(*ExportFormatFromName("colmap-text"), ExportFormat::kColmapText);
  EXPECT_THAT(std::string(FormatFromName("obj").status().message()),
              HasSubstr("auto, colmap, nvm"));
  EXPECT_THAT(std::string(ExportFormatFromName("obj").status().message()),
              HasSubstr("colmap, colmap-text, nvm, ply"));
}

}  // namespace
}  // namespace groundlock::formats
