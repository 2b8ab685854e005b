// SPDX-License-Identifier: Apache-2.0
// NVM's own conventions: camera centre, distortion direction, names, several
// models; .sift files; image sizes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>

#include "map_store/formats/formats.h"
#include "map_store/formats/internal/image_size.h"
#include "map_store/formats/internal/nvm_model.h"
#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;
using internal::CameraFromNvm;
using internal::NvmFromCamera;
using internal::ParseNvm;
using internal::SiftFile;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;

std::string Message(const absl::Status& status) {
  return std::string(status.message());
}

// The file's own formula: where a measurement points, on z = 1.
Eigen::Vector2d UndistortedByNvm(const Eigen::Vector2d& m_px,
                                 double f_px,
                                 double r) {
  return (1.0 + r * m_px.squaredNorm() / (f_px * f_px)) * m_px / f_px;
}

struct DistortionCase {
  double f_px;
  double r;
};

class NvmDistortion : public ::testing::TestWithParam<DistortionCase> {};

// Points up to the very corner: mixing up the direction, or negating r, is
// wrong by pixels there and by nothing in the middle.
TEST_P(NvmDistortion, AgreesWithTheFileUpToTheCorner) {
  const auto [f_px, r] = GetParam();
  const Eigen::Vector2d center_px(900, 600);
  const auto fitted =
      CameraFromNvm(f_px, r, 1800, 1200, center_px, center_px.norm());
  ASSERT_TRUE(fitted.ok()) << fitted.status();
  EXPECT_LT(fitted->max_residual_px, 0.05);
  EXPECT_DOUBLE_EQ(fitted->radius_px, center_px.norm());
  double naive_px = 0.0;
  for (int i = 0; i <= 100; ++i) {
    const Eigen::Vector2d m_px = center_px * (i / 100.0);
    const Eigen::Vector2d x = UndistortedByNvm(m_px, f_px, r);
    const auto pixel = fitted->camera.ImageFromCamera(x.homogeneous());
    ASSERT_TRUE(pixel);
    // The fit promises 0.05 px between its samples, too.
    EXPECT_LT((*pixel - center_px - m_px).norm(), 0.06) << i;
    naive_px = std::max(naive_px,
                        (f_px * (1.0 + r * x.squaredNorm()) * x - m_px).norm());
  }
  // The test can tell: taking r for k is off by more than a pixel.
  EXPECT_GT(naive_px, 1.0);
}

INSTANTIATE_TEST_SUITE_P(All,
                         NvmDistortion,
                         ::testing::Values(DistortionCase{1500, 0.01},
                                           DistortionCase{1500, -0.01},
                                           DistortionCase{1500, 0.1},
                                           DistortionCase{1500, -0.1},
                                           DistortionCase{2400, 0.9},
                                           DistortionCase{1000, 0.2}));

TEST(NvmDistortionDirection, BarrelDistortionHasPositiveR) {
  // r > 0 moves measured points outwards to undistort them, so ours is k < 0.
  const auto fitted = CameraFromNvm(1500, 0.05, 1800, 1200, {900, 600}, 1081);
  ASSERT_TRUE(fitted.ok());
  EXPECT_LT(fitted->camera.params()[3], 0.0);
}

TEST(NvmDistortionDirection, AFoldInsideTheImageIsReported) {
  // The map folds back at f / sqrt(-3 r) = 577 px.
  const auto fitted = CameraFromNvm(1000, -1.0, 1800, 1200, {900, 600}, 1081);
  ASSERT_TRUE(fitted.ok()) << fitted.status();
  EXPECT_LT(fitted->radius_px, 577.4);
}

TEST(NvmDistortionDirection, ExportIsTheInverseOfImport) {
  for (const double r : {-0.05, -0.004, 0.0, 0.02, 0.1}) {
    const auto fitted = CameraFromNvm(1500, r, 1800, 1200, {900, 600}, 1082);
    ASSERT_TRUE(fitted.ok());
    const auto back = NvmFromCamera(fitted->camera);
    ASSERT_TRUE(back.ok()) << back.status();
    // Both fits are good to 0.05 px in 1000: relative 5e-5, of f and of r's
    // effect at the border (r * 0.52 there).
    EXPECT_NEAR(back->focal_px, 1500, 0.15);
    EXPECT_NEAR(back->r, r, 3e-4);
    EXPECT_LT(back->max_residual_px, 0.1);
  }
}

TEST(NvmDistortionDirection, RefusesNonsense) {
  EXPECT_FALSE(CameraFromNvm(0, 0, 10, 10, {5, 5}, 7).ok());
  EXPECT_FALSE(CameraFromNvm(10, NAN, 10, 10, {5, 5}, 7).ok());
  EXPECT_FALSE(CameraFromNvm(10, 1e300, 10, 10, {5, 5}, 7).ok());
  EXPECT_FALSE(CameraFromNvm(10, 0, 0, 10, {5, 5}, 7).ok());
}

constexpr char kNvm[] =
    "NVM_V3 FixedK 500 320 500 240\n"
    "\n"
    "2\n"
    "my\"photo.jpg\t500 1 0 0 0 1 2 3 0 0\n"
    "C:\\dir\\other one.jpg 500 0.70710678 0 0.70710678 0 0 0 0 0.01 0\n"
    "\n"
    "2\n"
    "1 2 8 10 20 30 2 0 0 0 0 1 4 -10.5 20\n"
    "2 2 8 10 20 30 1 0 3 100 0\n"
    "\n"
    "1\n"
    "small.jpg 500 1 0 0 0 0 0 0 0 0\n"
    "1\n"
    "1 2 8 10 20 30 1 0 0 0 0\n"
    "0\n"
    "# comment\n"
    "1 0\n";

TEST(NvmText, ReadsNamesCentresAndTheLargestModel) {
  const auto file = ParseNvm(kNvm, "f.nvm");
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->num_models, 2);
  ASSERT_EQ(file->model.cameras.size(), 2U);
  EXPECT_EQ(file->model.cameras[0].name, "my photo.jpg");
  EXPECT_EQ(file->model.cameras[1].name, "C:\\dir\\other one.jpg");
  ASSERT_TRUE(file->calibration);
  EXPECT_DOUBLE_EQ(file->calibration->cx_px, 320);
  // The file gives the centre: t = -R c.
  EXPECT_EQ(file->model.cameras[0].camera_from_world.translation,
            Eigen::Vector3d(-1, -2, -3));
  EXPECT_NEAR(
      file->model.cameras[1].camera_from_world.rotation.norm(), 1, 1e-15);
  ASSERT_EQ(file->model.measurements.size(), 3U);
  EXPECT_EQ(file->model.measurements[1].feature, 4U);
}

TEST(NvmText, QuotedNamesLoseTheirQuotes) {
  const auto file = ParseNvm(
      "NVM_V3\n1\n\"a b.jpg\" 500 1 0 0 0 1 2 3 0 0\n1\n1 2 8 1 2 3 0\n0\n",
      "f");
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->model.cameras[0].name, "a b.jpg");
}

TEST(NvmText, ErrorsGiveTheLine) {
  struct Case {
    const char* text;
    const char* message;
  };
  const Case cases[] = {
      {"", "f:0: the file is empty"},
      {"ply\n", "not VisualSFM's NVM"},
      {"NVM_V2\n", "only NVM_V3"},
      {"NVM_V3 FixedK 1 2\n", "FixedK"},
      {"NVM_V3\n0\n", "no model with points"},
      {"NVM_V3\n4000000000\n", "f:2: 4000000000 cameras announced"},
      {"NVM_V3\n-1\n", "number of cameras"},
      {"NVM_V3\n1\na 500 1 0 0 0 1 2 3 0\n\n\n", "f:3"},
      {"NVM_V3\n1\na 500 0 0 0 0 1 2 3 0 0\n", "no quaternion"},
      {"NVM_V3\n1\na 500 1 0 0 nan 1 2 3 0 0\n", "camera a: a number"},
      {"NVM_V3\n1\na -5 1 0 0 0 1 2 3 0 0\n", "focal length"},
      {"NVM_V3\n1\na 500 1 0 0 0 1 2 3 0 0\n9\n", "9 points announced"},
      {"NVM_V3\n1\na 500 1 0 0 0 1 2 3 0 0\n1\n1 2 3 4 5 6 1 1 0 1 1\n",
       "f:5: point: image 1 of 1"},
      {"NVM_V3\n1\na 500 1 0 0 0 1 2 3 0 0\n1\n1 2 3 4 5 6 4000000 0 0 1 1\n",
       "the line is too short"},
      {"NVM_V3\n1\na 500 1 0 0 0 1 2 3 0 0\n1\n1 2 3 4 5 666 0          \n",
       "bad colour"},
  };
  for (const Case& c : cases) {
    const auto file = ParseNvm(c.text, "f");
    EXPECT_EQ(file.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(Message(file.status()), HasSubstr(c.message)) << c.text;
  }
}

std::string SiftBytes(std::int32_t count, std::int32_t floats = 5) {
  std::string bytes = "SIFTV4.0";
  for (const std::int32_t value : {count, floats, 128}) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
  }
  for (int i = 0; i < count && i < 100; ++i) {
    const float location[5] = {320.0F + static_cast<float>(i), 240, 0, 1, 0};
    bytes.append(reinterpret_cast<const char*>(location), sizeof(location));
  }
  bytes.append(static_cast<std::size_t>(std::clamp(count, 0, 100)) * 128, '\7');
  return bytes +
         "\xFF"
         "EOF";
}

TEST(SiftFile, ChecksItsHeaderAndSize) {
  const std::string good = SiftBytes(3);
  const auto sift = SiftFile::Parse(good, "a.sift");
  ASSERT_TRUE(sift.ok()) << sift.status();
  EXPECT_EQ(sift->size(), 3U);
  EXPECT_EQ(sift->KeypointPx(2), Eigen::Vector2f(322, 240));
  EXPECT_EQ(sift->Descriptor(2)[127], 7);
  EXPECT_THAT(Message(SiftFile::Parse(SiftBytes(1'000'000), "a").status()),
              HasSubstr("1000000 features announced"));
  EXPECT_FALSE(SiftFile::Parse(SiftBytes(-1), "a").ok());
  EXPECT_THAT(Message(SiftFile::Parse(SiftBytes(1, 4), "a").status()),
              HasSubstr("expected 5 and 128"));
  EXPECT_THAT(Message(SiftFile::Parse("3931 128\n1 2 3", "a").status()),
              HasSubstr("Lowe's text format"));
  for (std::size_t size = 0; size < good.size() - 4; ++size) {
    EXPECT_FALSE(SiftFile::Parse(good.substr(0, size), "a").ok());
  }
}

class NvmFolder : public ::testing::Test {
 protected:
  void Write(const std::string& name, const std::string& content) {
    std::ofstream(directory_.path() / name, std::ios::binary) << content;
  }
  absl::StatusOr<map::MapData> ImportFolder() {
    warnings_.clear();
    return Import(directory_.path() / "m.nvm", {}, &warnings_);
  }
  base::TemporaryDirectory directory_ = MakeTestDirectory();
  std::vector<std::string> warnings_;
};

// One camera; measurements are the .sift file's locations minus (320, 240).
constexpr char kOneCamera[] =
    "NVM_V3\n1\n../up/a.jpg 500 1 0 0 0 0 0 0 0 0\n2\n"
    "0 0 8 1 2 3 1 0 0 0 0\n.1 0 8 1 2 3 1 0 2 2 0\n0\n";

TEST_F(NvmFolder, FindsThePrincipalPointInTheSiftFile) {
  Write("m.nvm", kOneCamera);
  Write("a.sift", SiftBytes(3));
  const auto data = ImportFolder();
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_TRUE(warnings_.empty()) << warnings_[0];
  EXPECT_EQ(data->views[0].name, "a.jpg");
  EXPECT_EQ(data->cameras[0].width_px(), 640);
  EXPECT_EQ(data->cameras[0].height_px(), 480);
  EXPECT_EQ(data->views[0].keypoints_px[1], Eigen::Vector2f(322, 240));
  // 128 equal values: each L1 share is 1/128, its root 0.0884, times 512 = 45.
  EXPECT_EQ(data->views[0].descriptors[0][0], 45);
}

TEST_F(NvmFolder, OfAnotherReconstructionASiftFileIsNotTaken) {
  std::string text = kOneCamera;
  text.replace(text.find(" 2 2 0\n"), 7, " 2 9 0\n");
  Write("m.nvm", text);
  Write("a.sift", SiftBytes(3));
  const auto data = ImportFolder();
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_FALSE(data->has_descriptors());
  EXPECT_THAT(warnings_, Contains(HasSubstr("no descriptors")));
}

TEST_F(NvmFolder, TakesTheSizeFromTheImageElseFromTheExtent) {
  Write("m.nvm", kOneCamera);
  auto data = ImportFolder();
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_THAT(warnings_, Contains(HasSubstr("no image sizes")));
  EXPECT_EQ(data->cameras[0].width_px(), 4);
  // A 100-megapixel claim is only a claim: nothing is allocated for it.
  Write("a.jpg",
        std::string("\xFF\xD8\xFF\xE0\x00\x04\x00\x00"
                    "\xFF\xC0\x00\x11\x08\x01\xE0\x02\x80\x03",
                    18));
  data = ImportFolder();
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_EQ(data->cameras[0].width_px(), 640);
  EXPECT_EQ(data->cameras[0].height_px(), 480);
  EXPECT_EQ(data->views[0].keypoints_px[0], Eigen::Vector2f(320, 240));
}

TEST_F(NvmFolder, NeverLooksOutsideOfItself) {
  fs::create_directory(directory_.path() / "inside");
  Write("inside/m.nvm", kOneCamera);
  fs::create_directory(directory_.path() / "up");
  Write("up/a.sift", SiftBytes(3));
  const auto data = Import(directory_.path() / "inside/m.nvm", {}, nullptr);
  ASSERT_TRUE(data.ok());
  EXPECT_FALSE(data->has_descriptors());
}

TEST(ImageSize, ReadsPngAndRefusesDamage) {
  std::string png(
      "\x89PNG\r\n\x1A\n\x00\x00\x00\rIHDR\x00\x00\x05\x00\x00\x00"
      "\x02\xD0",
      24);
  const auto size = internal::ImageSizeFromHeader(png);
  ASSERT_TRUE(size);
  EXPECT_EQ(*size, (internal::ImageSize{1280, 720}));
  png[16] = '\x7F';  // wider than any camera of ours may be
  EXPECT_FALSE(internal::ImageSizeFromHeader(png));
  EXPECT_FALSE(internal::ImageSizeFromHeader(png.substr(0, 20)));
  EXPECT_FALSE(internal::ImageSizeFromHeader("\xFF\xD8"));
  EXPECT_FALSE(internal::ImageSizeFromHeader(
      std::string("\xFF\xD8\xFF\xE0\x00\x00\xFF\xC0", 8)));
  EXPECT_FALSE(internal::ImageSizeFromHeader(""));
}

}  // namespace
}  // namespace groundlock::formats
