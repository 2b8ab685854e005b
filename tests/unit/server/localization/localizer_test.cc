// SPDX-License-Identifier: Apache-2.0
#include "server/localization/localizer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <opencv2/core.hpp>

#include "server/localization/baseline_localizer.h"

namespace groundlock::localization {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST(LocalizerOptions, DefaultsAreTheThesisValuesAndValid) {
  const LocalizerOptions options;
  EXPECT_TRUE(options.Validate().ok()) << options.Validate();
  EXPECT_EQ(options.min_inliers, 100);
  EXPECT_EQ(options.ratio_test, 0.8);
  EXPECT_EQ(options.max_error_px, 2.0);
  EXPECT_EQ(options.ransac_max_iterations, 1'000);
}

TEST(LocalizerOptions, ErrorsNameTheField) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  const auto message = [](const LocalizerOptions& options) {
    return std::string(options.Validate().message());
  };
  EXPECT_THAT(message({.min_inliers = 3}), HasSubstr("min_inliers is 3"));
  EXPECT_THAT(message({.ratio_test = kNan}), HasSubstr("ratio_test"));
  EXPECT_THAT(message({.max_error_px = 0.0}), HasSubstr("max_error_px"));
  EXPECT_THAT(message({.ransac_confidence = 1.0}),
              HasSubstr("ransac_confidence"));
  EXPECT_THAT(message({.ransac_max_iterations = 0}),
              HasSubstr("ransac_max_iterations"));
  EXPECT_THAT(message({.min_landmark_views = 0}),
              HasSubstr("min_landmark_views"));
  EXPECT_THAT(message({.max_features = 99}), HasSubstr("max_features"));
  EXPECT_THAT(message({.lost_after = std::chrono::nanoseconds(-1)}),
              HasSubstr("lost_after"));
  EXPECT_THAT(message({.fast = {.max_followed_landmarks = 0}}),
              HasSubstr("fast: localizer option max_followed_landmarks is 0"));
  EXPECT_THAT(message({.fast = {.hurried_anchor_factor = 100'001}}),
              HasSubstr("hurried_anchor_factor"));
  EXPECT_THAT(message({.fast = {.anchor_period = -std::chrono::seconds(1)}}),
              HasSubstr("anchor_period_ns is -1000000000"));
}

TEST(CreateLocalizer, UnknownNamesListTheKnown) {
  const auto localizer = CreateLocalizer("magic", nullptr, {});
  EXPECT_EQ(localizer.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(localizer.status().message()), HasSubstr("baseline"));
  EXPECT_EQ(CreateLocalizer("baseline", nullptr, {}).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(ValidateRequest, FrameMustFitTheCamera) {
  image::Frame frame;
  LocalizationRequest request;
  EXPECT_FALSE(ValidateRequest(request).ok());
  request.frame = &frame;
  EXPECT_FALSE(ValidateRequest(request).ok());
  frame.luma = cv::Mat(1, 1, CV_8UC1, cv::Scalar(0));
  EXPECT_TRUE(ValidateRequest(request).ok());  // the default camera is 1x1
  request.masks_px.push_back(geometry::Box2::FromXywh(
      std::numeric_limits<double>::infinity(), 0.0, 1.0, 1.0));
  EXPECT_THAT(std::string(ValidateRequest(request).message()),
              HasSubstr("mask 0"));
  request.masks_px.clear();
  frame.luma = cv::Mat(2, 1, CV_8UC1, cv::Scalar(0));
  EXPECT_THAT(std::string(ValidateRequest(request).message()),
              HasSubstr("1x2"));
}

TEST(MakeUnique, KeepsTheClosestPerLandmarkAndFeature) {
  const std::vector<LandmarkCandidate> unique = MakeUnique({
      {.squared_distance = 9, .feature = 1, .landmark = 10},
      {.squared_distance = 4, .feature = 2, .landmark = 10},
      {.squared_distance = 5, .feature = 2, .landmark = 11},
      {.squared_distance = 7, .feature = 3, .landmark = 11},
  });
  EXPECT_THAT(
      unique,
      ElementsAre(LandmarkCandidate{4, 2, 10}, LandmarkCandidate{7, 3, 11}));
}

}  // namespace
}  // namespace groundlock::localization
