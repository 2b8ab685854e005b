// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/truth_csv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace groundlock::cli {
namespace {

using ::testing::HasSubstr;

constexpr char kCamera[] = "frame,t_s,cam_x,cam_y,cam_z,q_w,q_x,q_y,q_z";

TEST(TruthCsv, ReadsWhatTheSimulatorWrites) {
  const auto rows = TruthFromCsv(
      std::string(kCamera) +
      ",tgt_x,tgt_y,tgt_z,tgt_len,vis_x,vis_y,vis_w,vis_h,seen_fraction\n"
      "0,0.000000,1,2,3,1,0,0,0,4,5,0,0.9,10.5,20,30,40,0.75\r\n"
      "2,0.083333,1,2,3,0.6,0.8,0,0,4,5,0,0.9,,,,,0.0000\n"
      "3,0.125,1,2,3,1,0,0,0,4,5,0,0.9,10.5,20,0.00,0.00,0.001\n");
  ASSERT_TRUE(rows.ok()) << rows.status();
  ASSERT_EQ(rows->size(), 3U);
  const TruthRow& first = rows->at(0);
  EXPECT_EQ(first.world_from_camera.translation, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(*first.target_world, Eigen::Vector3d(4, 5, 0));
  EXPECT_EQ(first.visible_box_px->min_px, Eigen::Vector2d(10.5, 20));
  EXPECT_EQ(first.visible_box_px->max_px, Eigen::Vector2d(40.5, 60));
  EXPECT_EQ(first.seen_fraction, 0.75);
  EXPECT_EQ(rows->at(1).frame, 2U);
  EXPECT_EQ(rows->at(1).time.count(), 83'333'000);
  EXPECT_NEAR(rows->at(1).world_from_camera.rotation.x(), 0.8, 1e-12);
  EXPECT_FALSE(rows->at(1).visible_box_px);
  EXPECT_FALSE(rows->at(2).visible_box_px) << "a point spans no box";
}

TEST(TruthCsv, NeedsOnlyTheCamera) {
  const auto rows = TruthFromCsv(
      "q_w,q_x,q_y,q_z,frame,cam_x,cam_y,cam_z\n1,0,0,0,7,1,2,3\n");
  ASSERT_TRUE(rows.ok()) << rows.status();
  EXPECT_EQ(rows->at(0).frame, 7U);
  EXPECT_FALSE(rows->at(0).target_world);
  EXPECT_EQ(rows->at(0).seen_fraction, 0.0);
  const auto seen = TruthFromCsv(
      "frame,cam_x,cam_y,cam_z,q_w,q_x,q_y,q_z,vis_x,vis_y,vis_w,vis_h\n"
      "0,1,2,3,1,0,0,0,1,1,5,5\n");
  ASSERT_TRUE(seen.ok()) << seen.status();
  EXPECT_EQ(seen->at(0).seen_fraction, 1.0) << "a box is there to be seen";
}

TEST(TruthCsv, NamesLineAndColumnOfWhatIsWrong) {
  const std::string header = std::string(kCamera) + ",seen_fraction\n";
  const std::string good = "0,0,1,2,3,1,0,0,0,1\n";
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"", "line 1: there is no column \"frame\""},
      {"frame,cam_x,cam_y\n", "no column \"cam_z\""},
      {header, "no rows"},
      {header + "x,0,1,2,3,1,0,0,0,1\n", "line 2, column frame: \"x\""},
      {header + good + "0,0,1,2,3,1,0,0,0,1\n", "line 3, column frame"},
      {header + "0,0,1,2,3,1,0,0\n", "line 2, column q_z: \"\""},
      {header + "0,0,nan,2,3,1,0,0,0,1\n", "column cam_x: \"nan\""},
      {header + "0,0,1,2,3,1,1,0,0,1\n", "unit length"},
      {header + "0,1e300,1,2,3,1,0,0,0,1\n", "column t_s"},
      {header + "0,0,1,2,3,1,0,0,0,1.5\n", "column seen_fraction: \"1.5\""}};
  for (const auto& [csv, message] : cases) {
    const auto rows = TruthFromCsv(csv);
    ASSERT_FALSE(rows.ok()) << csv;
    EXPECT_THAT(std::string(rows.status().message()), HasSubstr(message));
  }
}

}  // namespace
}  // namespace groundlock::cli
