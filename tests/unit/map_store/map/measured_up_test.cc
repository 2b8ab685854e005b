// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/measured_up.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "map_store/map/map_data.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::map {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

double Apart_rad(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

// Twenty views in coordinates of their own, and what a drone that flies there
// on a circle of 8 units, each of `metres`, would have written.
class MeasuredUpOfPhotos : public ::testing::Test {
 protected:
  MeasuredUpOfPhotos()
      : data_(testing_map::MakeMapData({.num_views = 20, .pitch_rad = 0.6})) {
    const MapData truth = data_;
    data_.Transform(source_from_truth_);
    for (std::size_t v = 0; v < truth.views.size(); ++v) {
      const MapViewData& view = truth.views[v];
      PhotoReading& reading = readings_.emplace_back();
      reading.image = view.name;
      reading.up_camera =
          view.camera_from_world.rotation * Eigen::Vector3d::UnitZ();
      reading.p_local_m =
          kMetres * view.camera_from_world.Inverse().translation;
    }
  }

  void WithoutPositions() {
    for (PhotoReading& reading : readings_) reading.p_local_m.reset();
  }
  void WithoutAttitudes() {
    for (PhotoReading& reading : readings_) reading.up_camera.reset();
  }
  // Turns the attitude about an axis of its own.
  void Disturb(PhotoReading& reading, double angle_rad) {
    std::normal_distribution<double> normal(0.0, 1.0);
    const Eigen::Vector3d axis =
        Eigen::Vector3d{
            normal(generator_), normal(generator_), normal(generator_)}
            .cross(*reading.up_camera)
            .normalized();
    reading.up_camera = Eigen::AngleAxisd(angle_rad, axis) * *reading.up_camera;
  }
  std::optional<MeasuredUp> Measure() {
    warnings_.clear();
    return MeasureUp({readings_, edges_}, data_, warnings_);
  }

  static constexpr double kMetres = 5.0;
  const geometry::Similarity3 source_from_truth_{
      0.37,
      Eigen::Quaterniond(0.4, -0.7, 0.2, 0.55).normalized(),
      {3.0, -20.0, 7.0}};
  const Eigen::Vector3d up_ =
      source_from_truth_.rotation * Eigen::Vector3d::UnitZ();
  MapData data_;
  std::vector<PhotoReading> readings_;
  std::optional<UprightEdges> edges_;
  std::vector<std::string> warnings_;
  std::mt19937_64 generator_{3};
};

TEST_F(MeasuredUpOfPhotos, ByBoth) {
  const auto up = Measure();
  ASSERT_TRUE(up.has_value());
  EXPECT_LT(Apart_rad(up->up_world, up_), 1e-6);
  EXPECT_NE(up->basis.find("the attitudes of 20 photos"), std::string::npos);
  EXPECT_NE(up->basis.find("the GPS positions of 20 photos"),
            std::string::npos);
  EXPECT_TRUE(warnings_.empty());
}

TEST_F(MeasuredUpOfPhotos, ByAttitudesOfWhichSomeAreWrong) {
  WithoutPositions();
  // Those that are right lie within three degrees of each other.
  std::normal_distribution<double> noise(0.0, 0.7 * kDegree);
  for (PhotoReading& reading : readings_) Disturb(reading, noise(generator_));
  double wrong_rad = 0.6;
  for (const std::size_t i : {0U, 3U, 6U, 9U, 12U}) {
    Disturb(readings_[i], wrong_rad += 0.1);
  }
  // A folder may hold photos that are in no map.
  readings_.push_back({"elsewhere.jpg", Eigen::Vector3d::UnitX(), {}});
  const auto up = Measure();
  ASSERT_TRUE(up.has_value());
  EXPECT_LT(Apart_rad(up->up_world, up_), 2.0 * up->sigma_rad);
  EXPECT_LT(up->sigma_rad, 3.0 * kDegree);
  EXPECT_GE(up->sigma_rad, 1.0 * kDegree);
  EXPECT_NE(up->basis.find("the attitudes of 15 photos"), std::string::npos)
      << up->basis;
}

// Angles of another convention turn with the cameras.
TEST_F(MeasuredUpOfPhotos, AttitudesThatTurnWithTheCamerasAreLeftOut) {
  WithoutPositions();
  for (PhotoReading& reading : readings_) {
    reading.up_camera =
        Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitX()) * *reading.up_camera;
  }
  EXPECT_FALSE(Measure().has_value());
  ASSERT_EQ(warnings_.size(), 1U);
  EXPECT_NE(warnings_[0].find("attitudes contradict the map"),
            std::string::npos);
}

TEST_F(MeasuredUpOfPhotos, ByPositions) {
  WithoutAttitudes();
  std::normal_distribution<double> noise_m(0.0, 1.0);
  for (PhotoReading& reading : readings_) {
    for (double& x : *reading.p_local_m) x += noise_m(generator_);
  }
  *readings_[4].p_local_m += Eigen::Vector3d(60.0, 0.0, 40.0);
  const auto up = Measure();
  ASSERT_TRUE(up.has_value());
  EXPECT_LT(Apart_rad(up->up_world, up_), 2.0 * up->sigma_rad);
  // 1.4 m over the 28 m that a circle of 40 m spreads by.
  EXPECT_LT(up->sigma_rad, 4.0 * kDegree);
  EXPECT_GT(up->sigma_rad, 2.0 * kDegree);
}

TEST_F(MeasuredUpOfPhotos, PositionsOnALineTellNothing) {
  WithoutAttitudes();
  double along = 0.0;
  for (std::size_t i = 0; i < data_.views.size(); ++i, along += 1.0) {
    readings_[i].p_local_m = Eigen::Vector3d(10.0 * along, 0.0, 50.0);
    data_.views[i].camera_from_world.translation =
        -(data_.views[i].camera_from_world.rotation *
          Eigen::Vector3d(0.1 * along, 0.3, 0.0));
  }
  EXPECT_FALSE(Measure().has_value());
}

TEST_F(MeasuredUpOfPhotos, TwoThatContradictEachOtherTellNothing) {
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitX()).toRotationMatrix();
  for (PhotoReading& reading : readings_) {
    reading.p_local_m = turn * *reading.p_local_m;
  }
  EXPECT_FALSE(Measure().has_value());
  ASSERT_EQ(warnings_.size(), 1U);
  EXPECT_NE(warnings_[0].find("degrees apart"), std::string::npos);
}

TEST_F(MeasuredUpOfPhotos, EdgesAgreeOrTellAlone) {
  edges_ =
      UprightEdges{Eigen::AngleAxisd(0.03, up_.unitOrthogonal()) * up_, 200};
  const auto all = Measure();
  ASSERT_TRUE(all.has_value());
  EXPECT_NE(all->basis.find("200 edges"), std::string::npos);
  EXPECT_LT(Apart_rad(all->up_world, up_), 0.031);
  readings_.clear();
  const auto alone = Measure();
  ASSERT_TRUE(alone.has_value());
  EXPECT_EQ(alone->up_world, edges_->up_world);
  EXPECT_EQ(alone->basis, "200 edges of what stands upright");
}

TEST_F(MeasuredUpOfPhotos, EdgesThatContradictAttitudesTellNothing) {
  WithoutPositions();
  // Cameras that look nearly the same way, by which up may lean forward.
  data_.views.resize(3);
  const Eigen::Vector3d right =
      data_.views[1].camera_from_world.rotation.conjugate() *
      Eigen::Vector3d::UnitX();
  edges_ = UprightEdges{Eigen::AngleAxisd(0.2, right) * up_, 200};
  EXPECT_FALSE(Measure().has_value());
  ASSERT_EQ(warnings_.size(), 1U);
  EXPECT_NE(warnings_[0].find("200 edges"), std::string::npos);
}

// Level edges along the way of a drone that flies ahead and looks steeply down:
// in its images they point up.
TEST_F(MeasuredUpOfPhotos, EdgesAlongTheWayTellNothing) {
  readings_.clear();
  constexpr double kDown_rad = 75.0 * kDegree;
  Eigen::Matrix3d world_from_camera;
  world_from_camera << 0.0, -std::sin(kDown_rad), std::cos(kDown_rad),  //
      -1.0, 0.0, 0.0,                                                   //
      0.0, -std::cos(kDown_rad), -std::sin(kDown_rad);
  double along = 0.0;
  for (MapViewData& view : data_.views) {
    view.camera_from_world =
        geometry::Rigid3{Eigen::Quaterniond(world_from_camera),
                         Eigen::Vector3d(along += 2.0, 0.0, 30.0)}
            .Inverse();
  }
  edges_ = UprightEdges{Eigen::Vector3d::UnitX(), 500};
  EXPECT_FALSE(Measure().has_value());
  edges_ = UprightEdges{Eigen::Vector3d::UnitZ(), 500};
  EXPECT_TRUE(Measure().has_value());
}

TEST_F(MeasuredUpOfPhotos, TwoPhotosTellNothing) {
  readings_.resize(2);
  EXPECT_FALSE(Measure().has_value());
  readings_.clear();
  EXPECT_FALSE(Measure().has_value());
  EXPECT_TRUE(warnings_.empty());
}

}  // namespace
}  // namespace groundlock::map
