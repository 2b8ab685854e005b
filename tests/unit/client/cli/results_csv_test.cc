// SPDX-License-Identifier: Apache-2.0
#include "client/cli/results_csv.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

namespace groundlock::cli {
namespace {

// The names that scripts rely on, in their order.
constexpr const char* kHeader =
    "frame,t_s,camera_state,cam_x,cam_y,cam_z,cam_qw,cam_qx,cam_qy,cam_qz,"
    "inliers,target,target_state,confidence,"
    "box_x,box_y,box_w,box_h,ground_x,ground_y,ground_z,heading_rad,length_m,"
    "width_m,height_m,decode_ms,localize_ms,track_ms,total_ms\n";

sdk::FrameResult TrackedFrame() {
  sdk::FrameResult result;
  result.sequence = 7;
  result.capture_time = std::chrono::milliseconds(250);
  result.camera.state = sdk::CameraState::kTracked;
  result.camera.world_from_camera =
      geometry::Rigid3{Eigen::Quaterniond(0.5, -0.5, 0.5, -0.5), {1, 2, 3}};
  result.camera.num_inliers = 123;
  result.times = {.queue_ms = 9.0,
                  .decode_ms = 1.5,
                  .localize_ms = 2.25,
                  .track_ms = 3.0,
                  .total_ms = 7.0};
  return result;
}

sdk::TargetResult SeenTarget() {
  sdk::TargetResult target;
  target.id = "car";
  target.state = sdk::TargetState::kTracked;
  target.confidence = 0.875;
  target.box_px = geometry::Box2::FromXywh(10.5, 20, 30, 40.25);
  target.box_world = geometry::Box3{{}, {0.9, 0.5, 0.35}};
  target.ground_center_world = Eigen::Vector3d(4, 5, 0);
  target.heading_rad = -1.5;
  return target;
}

TEST(ResultsCsv, HasTheAgreedHeader) { EXPECT_EQ(ResultsCsvHeader(), kHeader); }

TEST(ResultsCsv, WritesEveryColumnInOrder) {
  sdk::FrameResult result = TrackedFrame();
  result.targets.push_back(SeenTarget());
  EXPECT_EQ(ResultsCsvRows(result),
            "7,0.250000,TRACKED,1.000000,2.000000,3.000000,"
            "0.500000000,-0.500000000,0.500000000,-0.500000000,123,"
            "car,TRACKED,0.8750,10.500,20.000,30.000,40.250,"
            "4.000000,5.000000,0.000000,-1.500000,0.9000,0.5000,0.3500,"
            "1.500,2.250,3.000,7.000\n");
}

TEST(ResultsCsv, LeavesEmptyWhatIsNotThere) {
  sdk::FrameResult result = TrackedFrame();
  result.camera = {};
  result.camera.state = sdk::CameraState::kLost;
  sdk::TargetResult target;
  target.id = "car";
  target.state = sdk::TargetState::kLost;
  target.confidence = std::numeric_limits<double>::quiet_NaN();
  result.targets.push_back(target);
  EXPECT_EQ(ResultsCsvRows(result),
            "7,0.250000,LOST,,,,,,,,0,car,LOST,,,,,,,,,,,,,"
            "1.500,2.250,3.000,7.000\n");
}

TEST(ResultsCsv, WritesOneRowPerTarget) {
  sdk::FrameResult result = TrackedFrame();
  const std::string none = ResultsCsvRows(result);
  EXPECT_EQ(std::count(none.begin(), none.end(), '\n'), 1);
  result.targets = {SeenTarget(), SeenTarget()};
  result.targets[1].id = "bus";
  const std::string two = ResultsCsvRows(result);
  EXPECT_EQ(std::count(two.begin(), two.end(), '\n'), 2);
  EXPECT_NE(two.find(",car,"), std::string::npos);
  EXPECT_LT(two.find(",car,"), two.find(",bus,"));
}

TEST(ResultsCsv, EveryRowHasAsManyFieldsAsTheHeader) {
  const auto commas = [](const std::string& line) {
    return std::count(line.begin(), line.end(), ',');
  };
  const auto expected = commas(kHeader);
  EXPECT_EQ(commas(ResultsCsvRows(TrackedFrame())), expected);
  const std::string dropped =
      ResultsCsvEmptyRow(3, std::chrono::milliseconds(125));
  EXPECT_EQ(commas(dropped), expected);
  EXPECT_EQ(dropped.substr(0, 12), "3,0.125000,,");
  EXPECT_EQ(commas(LocalizeCsvHeader()), expected + 1);
  EXPECT_EQ(commas(LocalizeCsvRow(0, {}, "a.jpg")), expected + 1);
  EXPECT_EQ(commas(LocalizeCsvEmptyRow(0, "a.jpg")), expected + 1);
}

TEST(ResultsCsv, QuotesFieldsThatNeedIt) {
  EXPECT_EQ(CsvField("plain.jpg"), "plain.jpg");
  EXPECT_EQ(CsvField("a,b"), "\"a,b\"");
  EXPECT_EQ(CsvField("say \"hi\""), "\"say \"\"hi\"\"\"");
  EXPECT_EQ(CsvField("two\nlines"), "\"two\nlines\"");
  const std::string row = LocalizeCsvEmptyRow(2, "my, photo.jpg");
  EXPECT_EQ(row.substr(row.size() - 17), ",\"my, photo.jpg\"\n");
}

}  // namespace
}  // namespace groundlock::cli
