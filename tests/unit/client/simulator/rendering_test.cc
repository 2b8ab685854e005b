// SPDX-License-Identifier: Apache-2.0
// The truth against the pixels.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <vector>

#include "client/simulator/internal/light.h"
#include "client/simulator/internal/renderer.h"
#include "client/simulator/internal/sensor.h"
#include "client/simulator/internal/truth.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3d;
using Eigen::Vector3f;

// x right, y down, z forward along world +y, 1.5 m above the ground.
geometry::Rigid3 Camera(double x, double y) {
  Eigen::Matrix3d R;
  R << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  return {Eigen::Quaterniond(R), {x, y, 1.5}};
}

geometry::Rigid3 Car(double x, double y, double heading_rad) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(heading_rad, Vector3d::UnitZ())),
          {x, y, 0.0}};
}

// An upright rectangle that faces -y.
void AddScreen(SceneModel& scene,
               const Vector3f& top_left,
               float width,
               float height,
               const cv::Scalar& color) {
  const Vector3f right(width, 0, 0);
  const Vector3f down(0, 0, -height);
  Surface surface;
  surface.albedo = cv::Mat(16, 16, CV_8UC3, color);
  surface.texels_per_m = 16.0F / width;
  surface.light_grid = {2, 2};
  surface.at = [=](float u, float v) {
    return SurfacePoint{top_left + u * right + v * down, -Vector3f::UnitY()};
  };
  const int index = static_cast<int>(scene.surfaces.size());
  scene.surfaces.push_back(surface);
  scene.quads.push_back(
      {{top_left, top_left + right, top_left + right + down, top_left + down},
       Vector2f(0, 0),
       Vector2f(1, 0),
       Vector2f(0, 1),
       -Vector3f::UnitY(),
       index});
}

std::unique_ptr<Renderer> MakeRenderer(SceneModel scene) {
  scene.to_sun = Vector3f(-0.4F, -0.6F, 0.69F).normalized();
  auto renderer =
      Renderer::Create(std::move(scene), Lens::ForSize(640, 360), 1, 2);
  EXPECT_TRUE(renderer.ok()) << renderer.status();
  return *std::move(renderer);
}

TEST(Lens, AgreesWithTheCameraModelOfTheMapStore) {
  const Lens lens = Lens::ForSize(1'280, 720);
  const auto camera = geometry::CameraModelFromJson(lens.ToJson());
  ASSERT_TRUE(camera.ok()) << camera.status();
  for (const Vector3d& p : {Vector3d(0, 0, 1),
                            Vector3d(0.6, -0.3, 1),
                            Vector3d(-2, 1, 3),
                            Vector3d(5, 2.5, 8)}) {
    const auto ours = lens.Project(p);
    const auto theirs = camera->ImageFromCamera(p);
    ASSERT_TRUE(ours && theirs);
    EXPECT_LT((*ours - *theirs).norm(), 1e-9);
    const Eigen::Vector2d back = lens.Undistort(ours->x(), ours->y());
    EXPECT_LT((back - p.hnormalized()).norm(), 1e-12);
  }
  EXPECT_FALSE(lens.Project({0, 0, -1}));
  EXPECT_FALSE(lens.Project({9, 0, 1}));  // beyond the monotone radius
}

// A bright marker in a corner, where the lens bends most, lies where Project
// says: its centroid to a twentieth of a pixel (16 samples per pixel).
TEST(Renderer, ShowsAMarkerWhereTheLensPutsIt) {
  SceneModel scene;
  AddScreen(scene, {-30, 20.0F, 30}, 60, 60, cv::Scalar::all(10));
  AddScreen(scene, {2.4F, 6.0F, 3.1F}, 0.2F, 0.2F, cv::Scalar::all(250));
  const auto renderer = MakeRenderer(std::move(scene));
  const geometry::Rigid3 camera = Camera(0.1, -0.3);
  const std::vector<Moment> moments(16, Moment{camera, std::nullopt});
  const cv::Mat image = renderer->Render(moments);
  const double background = image.at<cv::Vec3f>(300, 60)[1];
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double weight = 0.0;
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const double w = image.at<cv::Vec3f>(y, x)[1] - background;
      if (w < 5.0) continue;
      sum += w * Eigen::Vector2d(x + 0.5, y + 0.5);
      weight += w;
    }
  }
  ASSERT_GT(weight, 0.0);
  const auto expected =
      renderer->lens().Project(camera.Inverse() * Vector3d(2.5, 6.0, 3.0));
  ASSERT_TRUE(expected);
  EXPECT_GT(expected->x(), 500.0);
  EXPECT_LT((sum / weight - *expected).norm(), 0.05);
}

TEST(Truth, AnotherCarHidesWhatIsBehindIt) {
  SceneModel scene;
  AddScreen(scene, {-30, 20.0F, 30}, 60, 60, cv::Scalar::all(90));
  const auto renderer = MakeRenderer(std::move(scene));
  const CarSamples samples(renderer->car(), 1);
  const auto shown = [&](const Moment& moment) {
    cv::Mat share;
    renderer->Render(std::vector<Moment>(4, moment), &share);
    return cv::sum(share)[0];
  };
  const Moment alone{Camera(0, -4), Car(0.6, 3.0, 0.0)};
  Moment beside = alone;
  beside.world_from_other_cars = {Car(-1.5, 2.4, 0.0)};
  Moment before = alone;
  before.world_from_other_cars = {Car(0.45, 2.2, 0.0)};
  Moment behind = alone;
  behind.world_from_other_cars = {Car(0.7, 3.8, 0.0)};
  EXPECT_DOUBLE_EQ(samples.Measure(*renderer, beside).visible_fraction, 1.0);
  EXPECT_DOUBLE_EQ(samples.Measure(*renderer, behind).visible_fraction, 1.0);
  const double hidden =
      1.0 - samples.Measure(*renderer, before).visible_fraction;
  EXPECT_GT(hidden, 0.2);
  EXPECT_LT(hidden, 0.9);
  // What one hides of the other is missing from the pixels of both.
  EXPECT_GT(shown(beside), 1.9 * shown(alone));
  const Moment other{before.world_from_camera, before.world_from_other_cars[0]};
  EXPECT_LT(shown(before), shown(alone) + shown(other) - 0.2 * shown(alone));
  EXPECT_GT(shown(before), shown(other));
}

TEST(Truth, SeveralCarsHideWhatEachOfThemDoes) {
  SceneModel scene;
  AddScreen(scene, {-30, 20.0F, 30}, 60, 60, cv::Scalar::all(90));
  const auto renderer = MakeRenderer(std::move(scene));
  const CarSamples samples(renderer->car(), 1);
  const auto hidden_by = [&](const std::vector<geometry::Rigid3>& others) {
    const Moment moment{Camera(0, -4), Car(0.6, 3.0, 0.0), others};
    return 1.0 - samples.Measure(*renderer, moment).visible_fraction;
  };
  // Side by side, one before each end of the car.
  const geometry::Rigid3 left = Car(0.05, 2.2, 0.0);
  const geometry::Rigid3 right = Car(1.05, 2.2, 0.0);
  EXPECT_GT(hidden_by({left}), 0.05);
  EXPECT_GT(hidden_by({right}), 0.05);
  EXPECT_NEAR(
      hidden_by({left, right}), hidden_by({left}) + hidden_by({right}), 1e-9);
}

TEST(Truth, TargetBoxesHoldTheCarsPixels) {
  SceneModel scene;
  AddScreen(scene, {-30, 20.0F, 30}, 60, 60, cv::Scalar::all(90));
  const auto renderer = MakeRenderer(std::move(scene));
  const CarSamples samples(renderer->car(), 1);
  for (const double heading_rad : {0.0, 0.7, 2.4}) {
    const Moment moment{Camera(0, -4), Car(0.6, 2.0, heading_rad)};
    cv::Mat share;
    renderer->Render(std::vector<Moment>(8, moment), &share);
    std::vector<cv::Point> pixels;
    cv::findNonZero(share > 0.2F, pixels);
    const cv::Rect shown = cv::boundingRect(pixels);
    const TargetTruth truth = samples.Measure(*renderer, moment);
    ASSERT_TRUE(truth.box && truth.seen_box);
    EXPECT_DOUBLE_EQ(truth.visible_fraction, 1.0);
    EXPECT_DOUBLE_EQ(truth.inframe_fraction, 1.0);
    // The cuboid encloses the car; the samples leave out up to 2 px.
    EXPECT_GE(shown.x, truth.box->x() - 1.0);
    EXPECT_GE(shown.y, truth.box->y() - 1.0);
    EXPECT_LE(shown.br().x, truth.box->max_px.x() + 1.0);
    EXPECT_LE(shown.br().y, truth.box->max_px.y() + 1.0);
    EXPECT_NEAR(shown.x, truth.seen_box->x(), 2.5);
    EXPECT_NEAR(shown.y, truth.seen_box->y(), 2.5);
    EXPECT_NEAR(shown.br().x, truth.seen_box->max_px.x(), 2.5);
    EXPECT_NEAR(shown.br().y, truth.seen_box->max_px.y(), 2.5);
  }
}

TEST(Truth, VisibilityCountsWhatHidesAndWhatIsOutside) {
  SceneModel scene;
  // Hides everything at x > 0 beyond it, seen from x = 0.
  AddScreen(scene, {0, 1.0F, 3}, 4, 3, cv::Scalar::all(90));
  const auto renderer = MakeRenderer(std::move(scene));
  const CarSamples samples(renderer->car(), 1);
  const auto measure = [&](double x, double y) {
    return samples.Measure(*renderer, {Camera(0, -4), Car(x, y, 0.0)});
  };
  EXPECT_DOUBLE_EQ(measure(-1, 3).visible_fraction, 1.0);
  EXPECT_DOUBLE_EQ(measure(1, 3).visible_fraction, 0.0);
  EXPECT_FALSE(measure(1, 3).in_view());
  EXPECT_FALSE(measure(1, 3).seen_box.has_value());
  EXPECT_TRUE(measure(1, 3).box.has_value());  // amodal
  // Half of a symmetric car; its samples are 1,800 random ones: 5 sigma = 0.06
  // and more for the perspective.
  EXPECT_NEAR(measure(0, 3).visible_fraction, 0.5, 0.1);
  // In front of the screen: nothing hides it, but the image ends.
  EXPECT_DOUBLE_EQ(measure(-2.4, 0).visible_fraction, 1.0);
  const TargetTruth edge = measure(-2.35, 0);
  EXPECT_GT(edge.inframe_fraction, 0.05);
  EXPECT_LT(edge.inframe_fraction, 0.95);
  EXPECT_DOUBLE_EQ(edge.seen_fraction, edge.inframe_fraction);
  EXPECT_GE(edge.seen_box->x(), 0.0);
  // Behind the camera.
  const TargetTruth behind = measure(0, -8);
  EXPECT_FALSE(behind.box.has_value());
  EXPECT_DOUBLE_EQ(behind.inframe_fraction, 0.0);
}

TEST(Sensor, NoiseHasTheStatedVariance) {
  const Sensor sensor({400, 400}, 3, 2);
  const cv::Mat grey(400, 400, CV_32FC3, cv::Scalar::all(120));
  const cv::Mat image = sensor.Expose(grey, 0, 0.0);
  // Around the middle, where the vignette is flat to 0.1 %.
  cv::Scalar mean;
  cv::Scalar deviation;
  cv::meanStdDev(image(cv::Rect(180, 180, 40, 40)), mean, deviation);
  const double expected = 0.9 + 0.018 * 120 + 1.0 / 12;  // and rounding
  for (int c = 0; c < 3; ++c) {
    // 1,600 values: the variance is good to 3.5 % (1 sigma).
    EXPECT_NEAR(deviation[c] * deviation[c], expected, 0.15 * expected);
    EXPECT_NEAR(mean[c], 120.0, 0.3);
  }
  EXPECT_EQ(cv::norm(image, sensor.Expose(grey, 0, 0.0), cv::NORM_INF), 0.0);
  EXPECT_GT(cv::norm(image, sensor.Expose(grey, 1, 0.0), cv::NORM_INF), 0.0);
  cv::Scalar corner = cv::mean(image(cv::Rect(0, 0, 20, 20)));
  EXPECT_NEAR(corner[0], 120.0 * 0.91, 1.0);  // 10 % at the very corner
}

}  // namespace
}  // namespace groundlock::simulator
