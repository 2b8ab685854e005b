// SPDX-License-Identifier: Apache-2.0
#include "client/cli/priors.h"

#include <gtest/gtest.h>

#include <numbers>
#include <string>
#include <utility>
#include <vector>

namespace groundlock::cli {
namespace {

TEST(Priors, ReadsPositionsAndRotations) {
  const auto priors = PriorsFromCsv(
      "frame,sigma,x,y,z,qw,qx,qy,qz,rotation_sigma_deg,comment\n"
      "3,0.5,1,-2,3.5,,,,,,by hand\n"
      "7,,,,,0.6,0.8,0,0,2,compass\r\n"
      "\n"
      "9,2,0,0,1,1,0,0,0,90\n");
  ASSERT_TRUE(priors.ok()) << priors.status();
  ASSERT_EQ(priors->size(), 3U);
  const sdk::PosePrior& place = priors->at(3);
  EXPECT_EQ(*place.position_world, Eigen::Vector3d(1.0, -2.0, 3.5));
  EXPECT_EQ(place.position_sigma_m, 0.5);
  EXPECT_FALSE(place.rotation);
  const sdk::PosePrior& turn = priors->at(7);
  EXPECT_FALSE(turn.position_world);
  EXPECT_NEAR(turn.rotation->x(), 0.8, 1e-12);
  EXPECT_NEAR(turn.rotation_sigma_rad, std::numbers::pi / 90.0, 1e-12);
  EXPECT_TRUE(priors->at(9).position_world && priors->at(9).rotation);
}

TEST(Priors, ReadsPlacesOnTheEarth) {
  const auto priors = PriorsFromCsv(
      "frame,latitude,longitude,height,sigma\n0,58.41,15.62,60.5,3\n");
  ASSERT_TRUE(priors.ok()) << priors.status();
  EXPECT_EQ(*priors->at(0).geodetic_position,
            (geometry::GeodeticPosition{58.41, 15.62, 60.5}));
}

TEST(Priors, APositionMayBeThatOfASensorBesideTheCamera) {
  const auto priors = PriorsFromCsv(
      "frame,x,y,z,latitude,longitude,height,sigma,arm_x,arm_y,arm_z\n"
      "0,1,2,3,,,,1,0.1,-0.3,-1.2\n"
      "1,,,,58.41,15.62,60.5,3,0,-0.5,0\n"
      "2,1,2,3,,,,1,,,\n");
  ASSERT_TRUE(priors.ok()) << priors.status();
  EXPECT_EQ(priors->at(0).position_arm_camera_m,
            Eigen::Vector3d(0.1, -0.3, -1.2));
  EXPECT_EQ(priors->at(1).position_arm_camera_m,
            Eigen::Vector3d(0.0, -0.5, 0.0));
  EXPECT_FALSE(priors->at(2).position_arm_camera_m);
}

TEST(Priors, ErrorsNameLineAndColumn) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"", "line 1"},
      {"x,y,z\n", "frame"},
      {"frame,x,y,z,sigma\n1,2,3,4\n", "line 2, column sigma"},
      {"frame,x,y,z,sigma\n1,2,3,4,0\n", "line 2, column sigma"},
      {"frame,x,y,z,sigma\n1,2,nan,4,1\n", "line 2, column y"},
      {"frame,x,y,z,sigma\n-1,2,3,4,1\n", "line 2, column frame"},
      {"frame,x,y,z,sigma\n1,2,3,4,1\n1,2,3,4,1\n", "line 3, column frame"},
      {"frame,qw,qx,qy,qz,rotation_sigma_deg\n1,1,1,0,0,1\n", "column qw"},
      {"frame,latitude,longitude,height,sigma\n1,91,0,0,1\n", "line 2"},
      {"frame,x,y,z,sigma,arm_x,arm_y\n1,2,3,4,1,0,1\n",
       "line 2, column arm_z"},
      {"frame,x,y,z,sigma,arm_x,arm_y,arm_z\n1,2,3,4,1,0,inf,1\n",
       "line 2, column arm_y"},
      {"frame,x,y,z,sigma,arm_x,arm_y,arm_z\n1,,,,,1,2,3\n",
       "line 2, column arm_x"},
  };
  for (const auto& [csv, what] : cases) {
    const auto priors = PriorsFromCsv(csv);
    ASSERT_FALSE(priors.ok()) << csv;
    EXPECT_EQ(priors.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_NE(std::string(priors.status().message()).find(what),
              std::string::npos)
        << priors.status();
  }
  EXPECT_EQ(ReadPriors("/nonexistent.csv").status().code(),
            absl::StatusCode::kNotFound);
}

TEST(Priors, FlagsGiveOnePositionWithItsSigma) {
  EXPECT_FALSE(PriorFromFlags({})->has_value());
  const auto place = PriorFromFlags({"1,2,3", "", 0.5});
  ASSERT_TRUE(place.ok()) << place.status();
  EXPECT_EQ(*(*place)->position_world, Eigen::Vector3d(1.0, 2.0, 3.0));
  EXPECT_EQ((*place)->position_sigma_m, 0.5);
  const auto earth = PriorFromFlags({"", "58.4,15.6,60", 3.0});
  ASSERT_TRUE(earth.ok());
  EXPECT_EQ((*earth)->geodetic_position->latitude_deg, 58.4);
  for (const PriorFlags& wrong : {PriorFlags{"1,2,3", "", 0.0},
                                  PriorFlags{"1,2", "", 1.0},
                                  PriorFlags{"1,2,x", "", 1.0},
                                  PriorFlags{"1,2,3", "1,2,3", 1.0},
                                  PriorFlags{"", "95,2,3", 1.0}}) {
    EXPECT_FALSE(PriorFromFlags(wrong).ok());
  }
}

}  // namespace
}  // namespace groundlock::cli
