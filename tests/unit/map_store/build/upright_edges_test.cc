// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/upright_edges.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "map_store/geometry/rigid3.h"

namespace groundlock::build::internal {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

double Apart_rad(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

geometry::CameraModel Camera() {
  const std::vector<double> params = {1'000.0, 640.0, 360.0, -0.05};
  return *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimpleRadial, 1'280, 720, params);
}

// A camera 6 m up that flies along x and looks along y, 25 degrees down.
geometry::Rigid3 CameraFromWorld(double x_m) {
  constexpr double kDown_rad = 25.0 * kDegree;
  Eigen::Matrix3d world_from_camera;
  world_from_camera << 1.0, 0.0, 0.0,                  //
      0.0, -std::sin(kDown_rad), std::cos(kDown_rad),  //
      0.0, -std::cos(kDown_rad), -std::sin(kDown_rad);
  return geometry::Rigid3{Eigen::Quaterniond(world_from_camera),
                          Eigen::Vector3d(x_m, 0.0, 6.0)}
      .Inverse();
}

// Planes through camera places along x that hold edges from `from` along
// `direction`, each off by half a degree.
class Edges {
 public:
  void Add(int count, const Eigen::Vector3d& direction, double scatter_rad) {
    for (int i = 0; i < count; ++i) {
      const Eigen::Vector3d from{
          15.0 * uniform_(generator_), 20.0 + 10.0 * uniform_(generator_), 0.0};
      const Eigen::Vector3d along = Turned(direction, scatter_rad);
      for (int view = 0; view < 10; ++view) {
        const Eigen::Vector3d camera(1.0 * view, 0.0, 6.0);
        normals_.push_back(
            Turned((from - camera).cross(along).normalized(), 0.5 * kDegree));
      }
    }
  }
  const std::vector<Eigen::Vector3d>& normals() const { return normals_; }

 private:
  Eigen::Vector3d Turned(const Eigen::Vector3d& vector, double sigma_rad) {
    return (vector + sigma_rad * Eigen::Vector3d{normal_(generator_),
                                                 normal_(generator_),
                                                 normal_(generator_)})
        .normalized();
  }

  std::mt19937_64 generator_{5};
  std::uniform_real_distribution<double> uniform_{-1.0, 1.0};
  std::normal_distribution<double> normal_{0.0, 1.0};
  std::vector<Eigen::Vector3d> normals_;
};

const Eigen::Vector3d kUp = Eigen::Vector3d::UnitZ();
const Eigen::Vector3d kGuess =
    Eigen::Vector3d(0.2, 0.2, 0.9).normalized();  // 17 degrees off

TEST(UprightEdges, AreFoundAmongOthers) {
  Edges edges;
  edges.Add(30, kUp, 1.0 * kDegree);
  edges.Add(60, Eigen::Vector3d::UnitX(), 2.0 * kDegree);
  edges.Add(60, Eigen::Vector3d::UnitY(), 2.0 * kDegree);
  edges.Add(100, Eigen::Vector3d(0.5, 0.5, 0.7).normalized(), 1.0);
  const auto up = UpByEdgePlanes(edges.normals(), kGuess);
  ASSERT_TRUE(up.has_value());
  EXPECT_LT(Apart_rad(up->up_world, kUp), 0.5 * kDegree);
  EXPECT_GT(up->count, 100);
}

// A field, a shore, a wood: edges in all directions, or none.
TEST(UprightEdges, SayNothingWhereNothingIsUpright) {
  EXPECT_FALSE(UpByEdgePlanes({}, kGuess).has_value());
  Edges any;
  any.Add(300, kUp, 1.0);
  EXPECT_FALSE(UpByEdgePlanes(any.normals(), kGuess).has_value());
  Edges level;
  level.Add(100, Eigen::Vector3d::UnitX(), 2.0 * kDegree);
  level.Add(100, Eigen::Vector3d::UnitY(), 2.0 * kDegree);
  EXPECT_FALSE(UpByEdgePlanes(level.normals(), kGuess).has_value());
  Edges few;
  few.Add(3, kUp, 0.0);
  EXPECT_FALSE(UpByEdgePlanes(few.normals(), kGuess).has_value());
}

TEST(UprightEdges, OfTinyAndEmptyPictures) {
  EXPECT_TRUE(FindEdgePlanes(cv::Mat(), Camera()).empty());
  for (const int size : {1, 2, 5}) {
    EXPECT_TRUE(
        FindEdgePlanes(cv::Mat(size, size, CV_8UC1, cv::Scalar(7)), Camera())
            .empty());
  }
}

// Two directions that do about as well: neither is believed.
TEST(UprightEdges, SayNothingBetweenTwo) {
  Edges edges;
  edges.Add(40, kUp, 0.5 * kDegree);
  edges.Add(36, Eigen::Vector3d(0.25, 0.0, 1.0).normalized(), 0.5 * kDegree);
  EXPECT_FALSE(UpByEdgePlanes(edges.normals(), kGuess).has_value());
}

TEST(UprightEdges, InDrawnPictures) {
  const geometry::CameraModel camera = Camera();
  std::vector<Eigen::Vector3d> normals;
  for (int view = 0; view < 10; ++view) {
    const geometry::Rigid3 camera_from_world = CameraFromWorld(0.8 * view);
    cv::Mat luma(720, 1'280, CV_8UC1, cv::Scalar(90));
    for (int post = -8; post <= 12; ++post) {
      // Its face towards the camera, 0.3 m wide and 2.5 m high, on the lens'
      // curve.
      const double x_m = 2.0 * post;
      const double y_m = 16.0 + 1.7 * (post % 3);
      std::vector<cv::Point> outline;
      for (const auto& [side, rises] :
           {std::pair(-0.15, true), {0.15, false}}) {
        for (int step = 0; step <= 10; ++step) {
          const double z_m = 0.25 * (rises ? step : 10 - step);
          const auto pixel = camera.ImageFromCamera(
              camera_from_world * Eigen::Vector3d(x_m + side, y_m, z_m));
          if (!pixel) continue;
          outline.emplace_back(
              static_cast<int>(std::lround(16.0 * (pixel->x() - 0.5))),
              static_cast<int>(std::lround(16.0 * (pixel->y() - 0.5))));
        }
      }
      if (outline.empty()) continue;
      cv::fillPoly(luma,
                   std::vector<std::vector<cv::Point>>{outline},
                   cv::Scalar(200),
                   cv::LINE_AA,
                   4);
    }
    for (const Eigen::Vector3d& normal : FindEdgePlanes(luma, camera)) {
      normals.push_back(camera_from_world.rotation.conjugate() * normal);
    }
  }
  const auto up = UpByEdgePlanes(normals, kGuess);
  ASSERT_TRUE(up.has_value());
  EXPECT_LT(Apart_rad(up->up_world, kUp), 0.3 * kDegree);
}

}  // namespace
}  // namespace groundlock::build::internal
