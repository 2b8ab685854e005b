// SPDX-License-Identifier: Apache-2.0
#include "client/cli/track_summary.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace groundlock::cli {
namespace {

using ::testing::HasSubstr;

sdk::FrameResult Result(sdk::CameraState camera,
                        sdk::TargetState target,
                        double total_ms) {
  sdk::FrameResult result;
  result.camera.state = camera;
  result.targets.push_back({});
  result.targets[0].id = "car";
  result.targets[0].state = target;
  result.times.total_ms = total_ms;
  return result;
}

TEST(Median, IsTheMiddleValue) {
  EXPECT_EQ(Median({}), 0.0);
  EXPECT_EQ(Median({3.0}), 3.0);
  EXPECT_EQ(Median({9.0, 1.0, 2.0}), 2.0);
  EXPECT_EQ(Median({9.0, 1.0, 2.0, 4.0}), 3.0);
}

TEST(TrackSummary, CountsSharesOfProcessedFrames) {
  TrackSummary summary;
  using C = sdk::CameraState;
  using T = sdk::TargetState;
  summary.Add(Result(C::kTracked, T::kTracked, 10.0));
  summary.Add(Result(C::kTracked, T::kTracked, 20.0));
  summary.Add(Result(C::kHeld, T::kPredicted, 90.0));
  summary.Add(Result(C::kTracked, T::kPredicted, 30.0));
  summary.Add(sdk::FrameDropped{});
  summary.Add(sdk::FrameError{});
  const auto json = nlohmann::json::parse(summary.ToJson(2.0, "s1"));
  EXPECT_EQ(json["session_id"], "s1");
  EXPECT_EQ(json["frames"]["processed"], 4);
  EXPECT_EQ(json["frames"]["dropped"], 1);
  EXPECT_EQ(json["frames"]["failed"], 1);
  EXPECT_EQ(json["camera_tracked_share"], 0.75);
  EXPECT_EQ(json["targets"]["car"]["seen_share"], 0.5);
  EXPECT_EQ(json["targets"]["car"]["last_state"], "PREDICTED");
  EXPECT_EQ(json["median_ms"]["total"], 25.0);
  EXPECT_EQ(json["frames_per_s"], 2.0);
  EXPECT_EQ(summary.last_states(), "camera TRACKED, car PREDICTED");
  const std::string text = summary.ToText(2.0);
  EXPECT_THAT(text, HasSubstr("4 processed, 1 dropped, 1 failed"));
  EXPECT_THAT(text, HasSubstr("tracked in 75.0 %"));
  EXPECT_THAT(text, HasSubstr("seen in 50.0 % of 4 frames"));
}

TEST(TrackSummary, OfNothingIsStillValid) {
  const auto json = nlohmann::json::parse(TrackSummary().ToJson(0.0, ""));
  EXPECT_EQ(json["camera_tracked_share"], 0.0);
  EXPECT_EQ(json["frames_per_s"], 0.0);
}

}  // namespace
}  // namespace groundlock::cli
