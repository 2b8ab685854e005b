// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/camera_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <random>

namespace groundlock::geometry {
namespace {

using testing::HasSubstr;

CameraModel Make(CameraModelId id, std::vector<double> params) {
  auto camera = CameraModel::Create(id, 1280, 720, params);
  EXPECT_TRUE(camera.ok()) << camera.status();
  return camera.ok() ? *camera : CameraModel();
}

struct Case {
  const char* name;
  CameraModelId id;
  std::vector<double> params;
};

// Real calibrations' sizes of distortion, both signs, all models.
std::vector<Case> Cases() {
  return {
      {"SimplePinhole", CameraModelId::kSimplePinhole, {1050, 640, 360}},
      {"Pinhole", CameraModelId::kPinhole, {1050, 1040, 630, 365}},
      {"Lot", CameraModelId::kSimpleRadial, {1050, 640, 360, -0.045}},
      {"Barrel", CameraModelId::kSimpleRadial, {700, 640, 360, -0.2}},
      {"Pincushion", CameraModelId::kSimpleRadial, {700, 640, 360, 0.3}},
      {"Radial", CameraModelId::kRadial, {800, 650, 350, -0.28, 0.09}},
      {"RadialFolding", CameraModelId::kRadial, {900, 640, 360, 0.1, -0.15}},
      {"OpenCv",
       CameraModelId::kOpenCv,
       {900, 910, 640, 360, -0.25, 0.08, 0.002, -0.003}},
      {"Fisheye",
       CameraModelId::kOpenCvFisheye,
       {400, 402, 640, 360, -0.03, 0.01, -0.005, 0.001}},
      {"FisheyeFolding",
       CameraModelId::kOpenCvFisheye,
       {500, 500, 640, 360, -0.2, -0.05, 0.0, 0.0}},
  };
}

class CameraModelTest : public testing::TestWithParam<Case> {
 protected:
  CameraModel camera_ = Make(GetParam().id, GetParam().params);
};

// Corners, borders and a grid: every pixel that a ray maps to comes back to
// 1e-9 px; the ray agrees to the 1e-9 that the header promises.
TEST_P(CameraModelTest, PixelRayPixelIsTheIdentity) {
  int defined = 0;
  for (double y = 0.0; y <= 720.0; y += 40.0) {
    for (double x = 0.0; x <= 1280.0; x += 40.0) {
      const Eigen::Vector2d pixel(x, y);
      const auto normalized = camera_.NormalizedFromImage(pixel);
      if (!normalized.has_value()) continue;
      ++defined;
      const auto back = camera_.ImageFromCamera(normalized->homogeneous());
      ASSERT_TRUE(back.has_value()) << pixel.transpose();
      EXPECT_LT((*back - pixel).norm(), 1e-9) << pixel.transpose();
    }
  }
  EXPECT_GT(defined, 19 * 33 / 3);  // the folding lenses leave corners out
}

TEST_P(CameraModelTest, PointPixelPointIsTheIdentity) {
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  int defined = 0;
  for (int i = 0; i < 1000; ++i) {
    const Eigen::Vector2d x{0.7 * uniform(generator), 0.4 * uniform(generator)};
    const auto pixel = camera_.ImageFromCamera(3.0 * x.homogeneous());
    if (!pixel.has_value()) continue;
    ++defined;
    const auto back = camera_.NormalizedFromImage(*pixel);
    ASSERT_TRUE(back.has_value()) << x.transpose();
    EXPECT_LT((*back - x).norm(), 1e-9) << x.transpose();
  }
  EXPECT_GT(defined, 800);
}

// Central differences with h = 1e-6: truncation ~h^2 f''' (1e-9 px), rounding
// ~1e-16 * 1e3 px / h = 1e-7 px; scaled by the size of the entries.
TEST_P(CameraModelTest, JacobianIsTheDerivative) {
  std::mt19937_64 generator(2);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int i = 0; i < 200; ++i) {
    // The first ones next to the axis, where the fisheye uses its series.
    const double reach = i < 50 ? 2e-3 : 0.5;
    const double z = 2.0 + uniform(generator);
    const Eigen::Vector3d p{
        reach * uniform(generator) * z, reach * uniform(generator) * z, z};
    Eigen::Matrix<double, 2, 3> jacobian;
    const auto pixel = camera_.ImageFromCamera(p, &jacobian);
    if (!pixel.has_value()) continue;
    for (int axis = 0; axis < 3; ++axis) {
      constexpr double kStep = 1e-6;
      const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
      const auto plus = camera_.ImageFromCamera(p + step);
      const auto minus = camera_.ImageFromCamera(p - step);
      if (!plus.has_value() || !minus.has_value()) continue;
      const Eigen::Vector2d numeric = (*plus - *minus) / (2.0 * kStep);
      EXPECT_LT((numeric - jacobian.col(axis)).norm(), 1e-5)
          << p.transpose() << " axis " << axis;
    }
  }
}

TEST_P(CameraModelTest, NeverFoldsAPointBackIntoTheImage) {
  // Along every direction the pixel moves outwards until there is none.
  for (int direction = 0; direction < 16; ++direction) {
    const double angle = direction * 0.3926990816987241;
    const Eigen::Vector2d unit(std::cos(angle), std::sin(angle));
    double last = -1.0;
    bool ended = false;
    for (double r = 0.01; r < 40.0; r *= 1.02) {
      const auto pixel =
          camera_.ImageFromCamera((r * unit).eval().homogeneous());
      if (!pixel.has_value()) {
        ended = true;
        continue;
      }
      EXPECT_FALSE(ended) << "defined again at " << r;
      const double distance = (*pixel - camera_.principal_point_px()).norm();
      EXPECT_GT(distance, last) << "r " << r;
      last = distance;
    }
  }
}

TEST_P(CameraModelTest, JsonRoundTrip) {
  const auto read = CameraModelFromJson(CameraModelToJson(camera_));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(*read, camera_);
}

TEST_P(CameraModelTest, NothingBehindTheCameraOrNotFinite) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(camera_.ImageFromCamera({0.1, 0.1, -1.0}).has_value());
  EXPECT_FALSE(camera_.ImageFromCamera({0.1, 0.1, 0.0}).has_value());
  EXPECT_FALSE(camera_.ImageFromCamera({nan, 0.1, 1.0}).has_value());
  EXPECT_FALSE(camera_.ImageFromCamera({0.1, 0.1, nan}).has_value());
  EXPECT_FALSE(camera_.NormalizedFromImage({nan, 1.0}).has_value());
  EXPECT_FALSE(camera_.RayFromImage({1.0, HUGE_VAL}).has_value());
}

TEST_P(CameraModelTest, RescaledSeesTheSameRays) {
  const CameraModel half = camera_.Rescaled(640, 360);
  const Eigen::Vector3d p(0.2, -0.1, 1.0);
  EXPECT_LT(
      (2.0 * *half.ImageFromCamera(p) - *camera_.ImageFromCamera(p)).norm(),
      1e-9);
}

INSTANTIATE_TEST_SUITE_P(Models,
                         CameraModelTest,
                         testing::ValuesIn(Cases()),
                         [](const auto& test) { return test.param.name; });

TEST(CameraModelLimitTest, SimpleRadialEndsWhereItsDerivativeVanishes) {
  // 1 + 3 k r^2 = 0 at r = 1 for k = -1/3.
  const CameraModel camera =
      Make(CameraModelId::kSimpleRadial, {500, 640, 360, -1.0 / 3.0});
  EXPECT_TRUE(camera.ImageFromCamera({0.999999, 0.0, 1.0}).has_value());
  EXPECT_FALSE(camera.ImageFromCamera({1.000001, 0.0, 1.0}).has_value());
  // No point maps beyond (1 + k) f = 333.3 px from the centre.
  EXPECT_TRUE(camera.NormalizedFromImage({640 + 333.3, 360}).has_value());
  EXPECT_FALSE(camera.NormalizedFromImage({640 + 333.4, 360}).has_value());
}

TEST(CameraModelLimitTest, ASecondCoefficientCanLiftTheLimit) {
  // 1 - 0.6 u + 0.45 u^2 has no root: monotone everywhere.
  const CameraModel camera =
      Make(CameraModelId::kRadial, {500, 640, 360, -0.2, 0.09});
  EXPECT_TRUE(camera.ImageFromCamera({10.0, 0.0, 1.0}).has_value());
}

TEST(CameraModelLimitTest, KnownValues) {
  // x_d = (1 - 0.045 * 0.25) * 0.5; pixel = 1050 x_d + 640.
  const CameraModel lot =
      Make(CameraModelId::kSimpleRadial, {1050, 640, 360, -0.045});
  EXPECT_NEAR(lot.ImageFromCamera({1.0, 0.0, 2.0})->x(), 1159.09375, 1e-9);
  // Equidistant: theta = atan(1) = pi / 4 for all k = 0.
  const CameraModel fisheye =
      Make(CameraModelId::kOpenCvFisheye, {400, 400, 640, 360, 0, 0, 0, 0});
  EXPECT_NEAR(fisheye.ImageFromCamera({2.0, 0.0, 2.0})->x(),
              640 + 400 * 0.7853981633974483,
              1e-9);
}

TEST(CameraModelCreateTest, NamesTheFieldAtFault) {
  const std::vector<double> good = {1050, 640, 360, -0.045};
  const auto create = [](int width, int height, std::vector<double> params) {
    return std::string(
        CameraModel::Create(CameraModelId::kSimpleRadial, width, height, params)
            .status()
            .message());
  };
  EXPECT_EQ(create(1280, 720, good), "");
  EXPECT_THAT(create(0, 720, good), HasSubstr("width"));
  EXPECT_THAT(create(1280, 65536, good), HasSubstr("height"));
  EXPECT_THAT(create(1280, 720, {1050, 640, 360}), HasSubstr("params"));
  EXPECT_THAT(create(1280, 720, {0, 640, 360, 0}), HasSubstr("(f)"));
  EXPECT_THAT(create(1280, 720, {1050, NAN, 360, 0}), HasSubstr("(cx)"));
  EXPECT_THAT(create(1280, 720, {1050, 640, 360, HUGE_VAL}), HasSubstr("(k)"));
}

TEST(CameraModelJsonTest, NamesTheFieldAtFault) {
  const auto message = [](const char* json) {
    return std::string(CameraModelFromJson(json).status().message());
  };
  EXPECT_EQ(message(R"({"width":1280,"height":720,"model":"SIMPLE_RADIAL",)"
                    R"("params":[1050,640,360,-0.045]})"),
            "");
  EXPECT_THAT(message(""), HasSubstr("not valid JSON"));
  EXPECT_THAT(message("[1]"), HasSubstr("object"));
  EXPECT_THAT(message(R"({"height":720})"), HasSubstr("'width' is missing"));
  EXPECT_THAT(message(R"({"width":1e3})"), HasSubstr("'width'"));
  EXPECT_THAT(message(R"({"width":18446744073709551615})"),
              HasSubstr("'width'"));
  EXPECT_THAT(message(R"({"width":1280,"height":720,"model":7})"),
              HasSubstr("'model'"));
  EXPECT_THAT(message(R"({"width":1280,"height":720,"model":"FOV"})"),
              HasSubstr("SIMPLE_PINHOLE"));
  EXPECT_THAT(message(R"({"width":1280,"height":720,"model":"PINHOLE",)"
                      R"("params":[1,"a"]})"),
              HasSubstr("'params'"));
  EXPECT_THAT(message(R"({"width":1280,"height":720,"model":"PINHOLE",)"
                      R"("params":[1000,1000,640]})"),
              HasSubstr("'params'"));
  EXPECT_THAT(message(std::string(100'000, '[').c_str()),
              HasSubstr("too many"));
}

}  // namespace
}  // namespace groundlock::geometry
