// SPDX-License-Identifier: Apache-2.0
// A textured ground, a wall that stands on it and a slab that drives over it,
// drawn exactly for a camera that flies by.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "server/ground/ground_surface.h"
#include "server/image/luma_pyramid.h"
#include "server/movers/movers.h"
#include "tests/support/drawn_scene.h"

namespace groundlock::movers {
namespace {

using Eigen::Vector3d;
using geometry::Box2;

constexpr double kFramesPerSecond = 24.0;

// A textured rectangle in the world.
struct Panel {
  Vector3d corner_world;
  Vector3d u_world, v_world;  // unit, along the texture's rows and columns
  double pixels_per_m = 20.0;
  cv::Mat texture;
};

class Scene {
 public:
  explicit Scene(double slab_speed_m_s) : slab_speed_m_s_(slab_speed_m_s) {
    const auto gray = [](int width, int height, std::uint64_t seed) {
      cv::Mat image;
      cv::cvtColor(test_support::Texture(width, height, seed, 2.0),
                   image,
                   cv::COLOR_BGR2GRAY);
      return image;
    };
    const std::vector<double> params = {520.0, 320.0, 180.0};
    camera_ = *geometry::CameraModel::Create(
        geometry::CameraModelId::kSimplePinhole, 640, 360, params);
    ground_ = {{-40, -20, 0}, {1, 0, 0}, {0, 1, 0}, 20.0, gray(1600, 1600, 1)};
    wall_ = {{2, 14, 4}, {1, 0, 0}, {0, 0, -1}, 40.0, gray(160, 160, 2)};
    slab_ = {{0, 0, 0.1}, {1, 0, 0}, {0, 1, 0}, 40.0, gray(80, 60, 3)};
  }

  const geometry::CameraModel& camera() const { return camera_; }
  Vector3d SlabCenter(double t_s) const {
    return {-5.0 + slab_speed_m_s_ * t_s + 1.0, 11.0 + 0.75, 0.1};
  }
  // Flies to the right at 2 m/s, 6 m up, and looks ahead and down.
  static geometry::Rigid3 Pose(double t_s) {
    return {
        Eigen::Quaterniond(
            Eigen::AngleAxisd(0.03 * std::sin(2.0 * t_s), Vector3d::UnitZ()) *
            Eigen::AngleAxisd(-118.0 * M_PI / 180.0, Vector3d::UnitX())),
        {-2.0 + 2.0 * t_s, 0.5 * t_s, 6.0}};
  }

  cv::Mat Draw(double t_s) const {
    cv::Mat image(360, 640, CV_8UC1, cv::Scalar(120));
    Panel slab = slab_;
    slab.corner_world += SlabCenter(t_s) - Vector3d(1.0, 0.75, 0.1);
    const geometry::Rigid3 pose = Pose(t_s);
    DrawPanel(ground_, pose, image);
    DrawPanel(wall_, pose, image);
    DrawPanel(slab, pose, image);
    return image;
  }

 private:
  void DrawPanel(const Panel& panel,
                 const geometry::Rigid3& world_from_camera,
                 cv::Mat& image) const {
    const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
    const Eigen::Matrix3d R = camera_from_world.rotation.matrix();
    Eigen::Matrix3d H;
    H << R * panel.u_world / panel.pixels_per_m,
        R * panel.v_world / panel.pixels_per_m,
        camera_from_world * panel.corner_world;
    Eigen::Matrix3d half = Eigen::Matrix3d::Identity();
    half(0, 2) = half(1, 2) = 0.5;  // OpenCV's first pixel is at (0, 0)
    H = half.inverse() * camera_.CalibrationMatrix() * H * half;
    cv::Mat warp(3, 3, CV_64F);
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) warp.at<double>(r, c) = H(r, c);
    }
    cv::Mat drawn, mask;
    cv::warpPerspective(panel.texture, drawn, warp, image.size());
    cv::warpPerspective(cv::Mat(panel.texture.size(), CV_8UC1, cv::Scalar(255)),
                        mask,
                        warp,
                        image.size());
    drawn.copyTo(image, mask > 250);
  }

  double slab_speed_m_s_;
  geometry::CameraModel camera_;
  Panel ground_, wall_, slab_;
};

struct RunOptions {
  int frames = 48;
  std::vector<Box2> targets_px;
  double turn_noise_rad = 0.0;  // of the poses, unsaid
};

std::vector<MoversReport> Watch(const Scene& scene, const RunOptions& options) {
  MoverFinder finder;
  const auto ground = ground::MakePlaneSurface({}, {.height_sigma_m = 0.02});
  std::mt19937_64 random(11);
  std::normal_distribution<double> noise(0.0, 1.0);
  std::vector<MoversReport> reports;
  for (int i = 0; i < options.frames; ++i) {
    const double t_s = i / kFramesPerSecond;
    MoversFrame frame;
    frame.pyramid = image::BuildPyramid(scene.Draw(t_s));
    frame.time = std::chrono::nanoseconds(std::llround(1e9 * t_s));
    frame.camera = &scene.camera();
    frame.world_from_camera = Scene::Pose(t_s);
    frame.world_from_camera.rotation =
        geometry::QuaternionFromRotationVector(
            options.turn_noise_rad *
            Vector3d{noise(random), noise(random), noise(random)}) *
        frame.world_from_camera.rotation;
    frame.pose_covariance.diagonal() << Vector3d::Constant(1e-6),
        Vector3d::Constant(1e-8);
    frame.ground = ground.get();
    frame.targets_px = options.targets_px;
    reports.push_back(finder.Process(frame));
  }
  return reports;
}

TEST(MoverFinder, FindsWhatDrivesWhereItIsAndAsFastAsItGoes) {
  const Scene scene(2.5);
  const auto reports = Watch(scene, {});
  EXPECT_EQ(reports.front().state, MoversState::kStarting);
  ASSERT_EQ(reports.back().state, MoversState::kWatching);
  // Within a second, and from then on the one thing under one id.
  for (std::size_t i = 24; i < reports.size(); ++i) {
    ASSERT_EQ(reports[i].movers.size(), 1U) << i;
    const Mover& mover = reports[i].movers[0];
    EXPECT_EQ(mover.id, 1U);
    EXPECT_GT(mover.confidence, 0.4);
    const Vector3d truth = scene.SlabCenter(i / kFramesPerSecond);
    // It is 2 m long, and its outline is as wide as the points on it.
    EXPECT_LT((mover.ground_world - truth).norm(), 0.6) << i;
    EXPECT_NEAR(mover.velocity_world_m_s.x(), 2.5, 0.25) << i;
    EXPECT_NEAR(mover.velocity_world_m_s.y(), 0.0, 0.25) << i;
    EXPECT_TRUE(mover.box_px.Contains(*scene.camera().ImageFromCamera(
        Scene::Pose(i / kFramesPerSecond).Inverse() * truth)))
        << i;
  }
}

TEST(MoverFinder, ReportsNothingWhereAllRests) {
  const Scene scene(0.0);
  for (const MoversReport& report : Watch(scene, {})) {
    EXPECT_TRUE(report.movers.empty());
  }
}

TEST(MoverFinder, SuggestsNoTargets) {
  const Scene scene(2.5);
  // Where the slab goes in two seconds.
  RunOptions options;
  options.targets_px = {Box2::FromXywh(0, 120, 640, 110)};
  for (const MoversReport& report : Watch(scene, options)) {
    EXPECT_TRUE(report.movers.empty());
  }
}

TEST(MoverFinder, APoseThatIsWorseThanSaidFloodsNothing) {
  const Scene scene(2.5);
  RunOptions options;
  options.turn_noise_rad = 0.01;  // five pixels, said to be a twentieth
  for (const MoversReport& report : Watch(scene, options)) {
    EXPECT_LE(report.movers.size(), 1U);
  }
}

TEST(MoverFinder, SaysWhyItDoesNotLook) {
  MoverFinder finder;
  EXPECT_EQ(finder.Skip(MoversState::kNoMap).state, MoversState::kNoMap);
  EXPECT_TRUE(finder.Skip(MoversState::kNoPose).movers.empty());
}

TEST(MoverFinder, AFrameOfAnotherSizeAJumpOrAPauseStartsAnew) {
  const Scene scene(2.5);
  MoverFinder finder;
  const auto ground = ground::MakePlaneSurface({});
  MoversFrame frame;
  frame.camera = &scene.camera();
  frame.ground = ground.get();
  const auto process = [&](int i) {
    frame.pyramid = image::BuildPyramid(scene.Draw(i / kFramesPerSecond));
    frame.time =
        std::chrono::nanoseconds(std::llround(1e9 * i / kFramesPerSecond));
    frame.world_from_camera = Scene::Pose(i / kFramesPerSecond);
    return finder.Process(frame).state;
  };
  MoversState state = MoversState::kNotAsked;
  for (int i = 0; i < 14; ++i) state = process(i);
  ASSERT_EQ(state, MoversState::kWatching);
  frame.pose_epoch = 1;
  EXPECT_EQ(process(14), MoversState::kStarting);
  for (int i = 15; i < 28; ++i) state = process(i);
  ASSERT_EQ(state, MoversState::kWatching);
  EXPECT_EQ(process(60), MoversState::kStarting);
  for (int i = 61; i < 74; ++i) state = process(i);
  ASSERT_EQ(state, MoversState::kWatching);
  const geometry::CameraModel half = scene.camera().Rescaled(320, 180);
  cv::Mat small;
  cv::resize(scene.Draw(3.0), small, {320, 180}, 0, 0, cv::INTER_AREA);
  frame.camera = &half;
  frame.pyramid = image::BuildPyramid(small);
  frame.time = std::chrono::milliseconds(3'100);
  EXPECT_EQ(finder.Process(frame).state, MoversState::kStarting);
}

TEST(MoverFinder, TinyAndFeaturelessFramesAreNoTrouble) {
  const auto ground = ground::MakePlaneSurface({});
  for (const cv::Size size :
       {cv::Size(1, 1), cv::Size(7, 3), cv::Size(64, 48)}) {
    const std::vector<double> params = {1.0 * std::max(size.width, size.height),
                                        0.5 * size.width,
                                        0.5 * size.height};
    const auto camera =
        geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                      size.width,
                                      size.height,
                                      params);
    ASSERT_TRUE(camera.ok());
    MoverFinder finder;
    for (int i = 0; i < 10; ++i) {
      MoversFrame frame;
      frame.pyramid =
          image::BuildPyramid(cv::Mat(size, CV_8UC1, cv::Scalar(20 * i)));
      frame.time = std::chrono::milliseconds(50 * i);
      frame.camera = &*camera;
      frame.world_from_camera = Scene::Pose(0.05 * i);
      frame.ground = ground.get();
      EXPECT_TRUE(finder.Process(frame).movers.empty());
    }
  }
}

}  // namespace
}  // namespace groundlock::movers
