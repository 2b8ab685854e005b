// SPDX-License-Identifier: Apache-2.0
#include "client/cli/imu.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace groundlock::cli {
namespace {

using std::chrono::nanoseconds;
using ::testing::HasSubstr;

TEST(Imu, ReadsWhatEurocWrites) {
  const auto samples = InertialFromCsv(
      "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],...\n"
      "1403636579758555392,-0.0991,0.1473,0.0272,8.1476,-0.3759,-2.4026\r\n"
      "1403636579763555584,-0.0991,0.1487,0.0286,8.0332,-0.4004,-2.3863,7\n"
      "\n");
  ASSERT_TRUE(samples.ok()) << samples.status();
  ASSERT_EQ(samples->size(), 2U);
  EXPECT_EQ(samples->at(0).time, nanoseconds(1403636579758555392));
  EXPECT_EQ(samples->at(0).angular_rate_rad_s.y(), 0.1473);
  EXPECT_EQ(samples->at(1).acceleration_m_s2.z(), -2.3863);
}

TEST(Imu, ErrorsNameLineAndColumn) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"#t\n1,2,3,4,5,6\n", "line 2, column 7 (a_z): missing"},
      {"1,2,3,x,5,6,7\n", "line 1, column 4 (w_z): \"x\""},
      {"1,2,3,4,inf,6,7\n", "column 5 (a_x)"},
      {"-1,2,3,4,5,6,7\n", "column 1 (timestamp [ns])"},
      {"1.5,2,3,4,5,6,7\n", "nanoseconds"},
      {"5,2,3,4,5,6,7\n5,2,3,4,5,6,7\n", "line 2, column 1"},
  };
  for (const auto& [csv, what] : cases) {
    EXPECT_THAT(InertialFromCsv(csv).status().ToString(), HasSubstr(what));
  }
  EXPECT_THAT(ReadInertial("/nonexistent.csv").status().ToString(),
              HasSubstr("nonexistent.csv"));
}

TEST(Imu, ReadsTheUnit) {
  const auto imu = ImuFromJson(
      R"({"imu_from_camera_wxyz":[0.6,0,0.8,0],"gyroscope_bias_rad_s":0.1})");
  ASSERT_TRUE(imu.ok()) << imu.status();
  EXPECT_NEAR(imu->imu_from_camera.y(), 0.8, 1e-12);
  EXPECT_EQ(imu->gyroscope_bias_rad_s, 0.1);
  EXPECT_FALSE(imu->gyroscope_noise_rad_s_sqrt_hz);
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"[1]", "JSON object"},
      {"{}", "imu_from_camera_wxyz"},
      {R"({"imu_from_camera_wxyz":[1,0,0]})", "imu_from_camera_wxyz"},
      {R"({"imu_from_camera_wxyz":[2,0,0,0]})", "unit quaternion"},
      {R"({"imu_from_camera_wxyz":[1,0,0,0],)"
       R"("gyroscope_walk_rad_s2_sqrt_hz":-1})",
       "gyroscope_walk_rad_s2_sqrt_hz"},
  };
  for (const auto& [json, what] : cases) {
    EXPECT_THAT(ImuFromJson(json).status().ToString(), HasSubstr(what));
  }
}

TEST(Imu, DealsSamplesOutToFrames) {
  std::vector<sdk::InertialSample> samples;
  for (int i = 0; i < 20; ++i) {
    samples.push_back({nanoseconds(995 + 5 * i), {0.1 * i, 0, 0}, {}});
  }
  InertialTrack track(samples, nanoseconds(1'000));
  const auto times = [&](int capture_time) {
    std::vector<std::int64_t> result;
    for (const auto& sample : track.Until(nanoseconds(capture_time))) {
      result.push_back(sample.time.count());
    }
    return result;
  };
  EXPECT_THAT(times(0), testing::ElementsAre(0)) << "those before are gone";
  EXPECT_THAT(times(12), testing::ElementsAre(5, 10, 15));
  EXPECT_THAT(times(20), testing::ElementsAre(20));
  EXPECT_EQ(times(1'000).size(), 14U);
  EXPECT_TRUE(times(2'000).empty());
}

TEST(Imu, AFrameNeverBringsMoreThanItMay) {
  std::vector<sdk::InertialSample> samples;
  for (int i = 0; i < 10'000; ++i) samples.push_back({nanoseconds(i), {}, {}});
  InertialTrack track(samples, {});
  const auto first = track.Until(nanoseconds(6'000));
  ASSERT_EQ(first.size(), 4'096U);
  EXPECT_EQ(first.back().time.count(), 6'000);
  EXPECT_EQ(track.Until(nanoseconds(6'001)).size(), 1U);
}

}  // namespace
}  // namespace groundlock::cli
