// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/trajectory.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>

namespace groundlock::dashboard {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

std::vector<std::shared_ptr<const gl::FrameResult>> Sample() {
  std::vector<std::shared_ptr<const gl::FrameResult>> results;
  for (int i = 0; i < 3; ++i) {
    auto result = std::make_shared<gl::FrameResult>();
    result->set_sequence(10 + i);
    result->set_capture_time_ns(500'000'000LL * i);
    result->mutable_camera()->set_state(i == 0 ? gl::CAMERA_STATE_INITIALIZING
                                               : gl::CAMERA_STATE_TRACKED);
    if (i > 0) {
      auto* pose = result->mutable_camera()->mutable_world_from_camera();
      pose->mutable_rotation()->set_w(1.0);
      pose->mutable_translation()->set_x(100.0 * i);
      pose->mutable_translation()->set_z(2.0);
      gl::TargetResult* target = result->add_targets();
      target->set_target_id("car");
      target->set_state(gl::TARGET_STATE_TRACKED);
      target->mutable_ground_center_m()->set_y(50.0 * i);
      target->set_heading_rad(1.5707963267948966);
    }
    results.push_back(std::move(result));
  }
  return results;
}

TEST(Trajectory, CsvHasOneRowPerFrameAndTarget) {
  const auto csv =
      WriteTrajectory(Sample(), TrajectoryFormat::kCsv, "", std::nullopt);
  ASSERT_TRUE(csv.ok());
  EXPECT_THAT(*csv, StartsWith("frame,t_s,camera_state,cam_x,"));
  EXPECT_EQ(std::count(csv->begin(), csv->end(), '\n'), 4);
  std::size_t begin = 0;
  while (begin < csv->size()) {
    const std::size_t end = csv->find('\n', begin);
    EXPECT_EQ(std::count(csv->begin() + begin, csv->begin() + end, ','), 28)
        << csv->substr(begin, end - begin);
    begin = end + 1;
  }
  EXPECT_THAT(*csv, HasSubstr("\n10,0.000000,INITIALIZING,,,,,,,,0,,"));
  EXPECT_THAT(*csv,
              HasSubstr("\n11,0.500000,TRACKED,100.000000,0.000000,2.000000,"
                        "1.000000000,"));
  EXPECT_THAT(*csv, HasSubstr(",car,TRACKED,"));
}

TEST(Trajectory, TumHasThePosesThatThereAre) {
  const auto camera =
      WriteTrajectory(Sample(), TrajectoryFormat::kTum, "", std::nullopt);
  ASSERT_TRUE(camera.ok());
  EXPECT_THAT(*camera,
              StartsWith("0.500000000 100.000000 0.000000 2.000000 "
                         "0.000000000 0.000000000 0.000000000 1.000000000\n"));
  EXPECT_EQ(std::count(camera->begin(), camera->end(), '\n'), 2);
  const auto car =
      WriteTrajectory(Sample(), TrajectoryFormat::kTum, "car", std::nullopt);
  ASSERT_TRUE(car.ok());
  EXPECT_THAT(*car,
              StartsWith("0.500000000 0.000000 50.000000 0.000000 0.000000000 "
                         "0.000000000 0.707106781 0.707106781\n"));
  EXPECT_EQ(
      WriteTrajectory(Sample(), TrajectoryFormat::kTum, "bus", std::nullopt)
          .status()
          .code(),
      absl::StatusCode::kNotFound);
}

TEST(Trajectory, PlacesOnEarthNeedAnOrigin) {
  EXPECT_EQ(WriteTrajectory(Sample(), TrajectoryFormat::kKml, "", std::nullopt)
                .status()
                .code(),
            absl::StatusCode::kFailedPrecondition);
  gl::GeodeticPosition origin;
  origin.set_latitude_deg(48.0);
  origin.set_longitude_deg(11.0);
  origin.set_height_m(500.0);
  const auto text =
      WriteTrajectory(Sample(), TrajectoryFormat::kGeoJson, "", origin);
  ASSERT_TRUE(text.ok()) << text.status();
  const auto json = nlohmann::json::parse(*text);
  ASSERT_EQ(json["features"].size(), 2U);
  EXPECT_EQ(json["features"][0]["properties"]["name"], "camera");
  const auto& line = json["features"][0]["geometry"]["coordinates"];
  ASSERT_EQ(line.size(), 2U);
  // 100 m to the east at 48 degrees north: 1 degree is 74.6 km there.
  EXPECT_NEAR(line[0][0].get<double>() - 11.0, 100.0 / 74'628.0, 1e-6);
  EXPECT_NEAR(line[0][1].get<double>(), 48.0, 1e-6);
  EXPECT_NEAR(line[0][2].get<double>(), 502.0, 0.01);
  const auto kml =
      WriteTrajectory(Sample(), TrajectoryFormat::kKml, "", origin);
  ASSERT_TRUE(kml.ok());
  EXPECT_THAT(*kml, HasSubstr("<name>target car</name>"));
  EXPECT_THAT(*kml, HasSubstr("11.001339"));
}

}  // namespace
}  // namespace groundlock::dashboard
