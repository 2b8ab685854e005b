// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/view_turn.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

namespace groundlock::tracking {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// A far camera that looks at a target: from `azimuth` in the target's axes and
// from so high, and rolls clockwise by `roll`, as the image turns the other
// way.
ViewTurn::View ViewFrom(double azimuth_deg,
                        double elevation_deg,
                        double roll_deg = 0.0) {
  const double a = azimuth_deg * kDegree;
  const double e = elevation_deg * kDegree;
  ViewTurn::View view;
  view.to_eye = {
      std::cos(a) * std::cos(e), std::sin(a) * std::cos(e), std::sin(e)};
  const Eigen::Vector3d right(-std::sin(a), std::cos(a), 0.0);
  const Eigen::Vector3d down = right.cross(view.to_eye);
  Eigen::Matrix<double, 2, 3> px_per_m;
  px_per_m << right.transpose(), down.transpose();
  EXPECT_GT(-px_per_m(1, 2), 0.0) << "upright is up in the image";
  view.px_per_m = 100.0 *
                  Eigen::Rotation2Dd(-roll_deg * kDegree).toRotationMatrix() *
                  px_per_m;
  view.lean_rad = -roll_deg * kDegree;
  view.width_m = 0.7;
  view.height_m = 0.35;
  return view;
}

class ViewTurnTest : public ::testing::Test {
 protected:
  void Start(const ViewTurn::View& view) {
    turn_.Follow(view);
    turn_.Learn(0.0);
  }
  void Next(const ViewTurn::View& view) {
    turn_.Follow(view);
    turn_.Learn(0.04);
  }
  double angle_deg() const { return turn_.angle_rad() / kDegree; }

  ViewTurn turn_;
};

TEST_F(ViewTurnTest, ACameraThatRollsTurnsWhatItSees) {
  Start(ViewFrom(200.0, 20.0));
  for (int i = 1; i <= 35; ++i) Next(ViewFrom(200.0, 20.0, i));
  EXPECT_NEAR(angle_deg(), -35.0, 0.1);
  for (int i = 34; i >= 0; --i) Next(ViewFrom(200.0, 20.0, i));
  EXPECT_EQ(angle_deg(), 0.0);
}

TEST_F(ViewTurnTest, AlsoWhileItIsOutOfSight) {
  Start(ViewFrom(10.0, 30.0));
  turn_.Follow(ViewFrom(10.0, 30.0, -50.0));
  EXPECT_NEAR(angle_deg(), 50.0, 0.1);
}

TEST_F(ViewTurnTest, WithoutAViewNothingIsLearnt) {
  turn_.Learn(0.0);
  Start(ViewFrom(10.0, 30.0, 25.0));
  EXPECT_EQ(angle_deg(), 0.0);
  turn_.Learn(0.04);
  turn_.Follow(ViewFrom(10.0, 30.0, 45.0));
  EXPECT_NEAR(angle_deg(), -20.0, 0.1);
}

TEST_F(ViewTurnTest, ASmallTurnIsNone) {
  Start(ViewFrom(10.0, 30.0));
  Next(ViewFrom(10.0, 30.0, 7.0));
  EXPECT_EQ(angle_deg(), 0.0);
  Next(ViewFrom(10.0, 30.0, 9.0));
  EXPECT_NEAR(angle_deg(), -9.0, 0.1);
  // Once turned, it is so until hardly anything is left of it.
  Next(ViewFrom(10.0, 30.0, 6.0));
  EXPECT_NEAR(angle_deg(), -6.0, 0.1);
  Next(ViewFrom(10.0, 30.0, 4.0));
  EXPECT_EQ(angle_deg(), 0.0);
}

TEST_F(ViewTurnTest, FromAboveATargetTurnsInTheImage) {
  Start(ViewFrom(0.0, 89.0));
  for (int i = 1; i <= 60; ++i) Next(ViewFrom(3.0 * i, 89.0));
  EXPECT_NEAR(std::abs(angle_deg()), 180.0, 1.0);
  for (int i = 1; i <= 60; ++i) Next(ViewFrom(180.0 + 3.0 * i, 89.0));
  EXPECT_EQ(angle_deg(), 0.0);
}

TEST_F(ViewTurnTest, FromTheSideItStaysUprightAllAround) {
  Start(ViewFrom(0.0, 15.0));
  for (int i = 1; i <= 180; ++i) {
    Next(ViewFrom(2.0 * i, 15.0));
    EXPECT_EQ(angle_deg(), 0.0) << i;
  }
}

TEST_F(ViewTurnTest, AnotherSideOfItIsNotATurnedOne) {
  Start(ViewFrom(-90.0, 18.0));
  for (const double azimuth_deg : {-130.0, 0.0, 90.0}) {
    turn_.Follow(ViewFrom(azimuth_deg, 18.0));
    EXPECT_EQ(angle_deg(), 0.0);
  }
}

TEST_F(ViewTurnTest, BackFromAboveItReturnsToTheUpright) {
  Start(ViewFrom(0.0, 20.0));
  for (int i = 0; i <= 65; ++i) Next(ViewFrom(0.0, 20.0 + i));
  for (int i = 0; i <= 90; ++i) Next(ViewFrom(i, 85.0));
  const double above_deg = angle_deg();
  EXPECT_NEAR(std::abs(above_deg), 90.0, 5.0);
  double last_deg = above_deg;
  for (int i = 0; i <= 65; ++i) {
    Next(ViewFrom(90.0, 85.0 - i));
    // Never by more than a filter follows.
    EXPECT_LT(std::abs(std::remainder(angle_deg() - last_deg, 360.0)), 6.0);
    last_deg = angle_deg();
  }
  for (int i = 0; i < 150; ++i) Next(ViewFrom(90.0, 20.0));
  EXPECT_EQ(angle_deg(), 0.0);
}

}  // namespace
}  // namespace groundlock::tracking
