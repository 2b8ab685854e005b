// SPDX-License-Identifier: Apache-2.0
#include "server/image/patch_flow.h"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "server/image/frame.h"

namespace groundlock::image {
namespace {

const cv::Size kSize_px(320, 240);

// A smooth random texture, moved.
cv::Mat Texture(const cv::Point2d& moved_px, double brighter = 0.0) {
  cv::Mat image(kSize_px, CV_8UC1);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const double u = x - moved_px.x;
      const double v = y - moved_px.y;
      const double value = 30.0 * std::sin(0.31 * u + 0.17 * v) +
                           28.0 * std::sin(0.23 * v - 0.11 * u + 1.0) +
                           25.0 * std::sin(0.053 * u + 0.071 * v + 2.0) +
                           20.0 * std::sin(0.047 * u - 0.059 * v + 3.0);
      image.at<unsigned char>(y, x) =
          cv::saturate_cast<unsigned char>(128.0 + value + brighter);
    }
  }
  return image;
}

PatchFlowOptions From(int coarsest_level) {
  PatchFlowOptions options;
  options.coarsest_level = coarsest_level;
  return options;
}

TEST(PatchFlow, FindsAShiftToAFewHundredthsOfAPixel) {
  const auto before = BuildPyramid(Texture({}));
  for (const cv::Point2d shift :
       {cv::Point2d(0.0, 0.0), cv::Point2d(0.3, -0.7), cv::Point2d(2.4, 1.1)}) {
    const auto now = BuildPyramid(Texture(shift));
    for (const cv::Point2d from :
         {cv::Point2d(160.0, 120.0), cv::Point2d(40.25, 200.7)}) {
      const auto found = FollowPatch(*before, *now, from, from, From(0));
      ASSERT_TRUE(found) << shift;
      EXPECT_NEAR(found->point_px.x, from.x + shift.x, 0.03);
      EXPECT_NEAR(found->point_px.y, from.y + shift.y, 0.03);
      EXPECT_LT(found->difference, 1.0);
    }
  }
}

TEST(PatchFlow, CoarserLevelsReachFarther) {
  const auto before = BuildPyramid(Texture({}));
  const cv::Point2d shift(11.5, -8.25);
  const auto now = BuildPyramid(Texture(shift));
  const cv::Point2d from(150.0, 130.0);
  const auto far = FollowPatch(*before, *now, from, from, From(2));
  ASSERT_TRUE(far);
  EXPECT_NEAR(far->point_px.x, from.x + shift.x, 0.03);
  EXPECT_NEAR(far->point_px.y, from.y + shift.y, 0.03);
  const auto near = FollowPatch(*before, *now, from, from, From(0));
  EXPECT_TRUE(!near || near->difference > 5.0 * far->difference);
  // From a guess, none are needed; levels that are not there are left out.
  for (const int level : {0, 99}) {
    const auto guessed = FollowPatch(*before,
                                     *now,
                                     from,
                                     from + shift + cv::Point2d(1.0, -1.5),
                                     From(level));
    ASSERT_TRUE(guessed);
    EXPECT_NEAR(guessed->point_px.x, far->point_px.x, 0.03);
    EXPECT_NEAR(guessed->point_px.y, far->point_px.y, 0.03);
  }
}

TEST(PatchFlow, StopsAtTheFinestLevelAskedFor) {
  const auto before = BuildPyramid(Texture({}));
  const auto now = BuildPyramid(Texture({6.0, 3.0}));
  PatchFlowOptions options = From(3);
  options.finest_level = 1;
  const auto found =
      FollowPatch(*before, *now, {160.0, 120.0}, {160.0, 120.0}, options);
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->point_px.x, 166.0, 0.1);
  EXPECT_NEAR(found->point_px.y, 123.0, 0.1);
  options.finest_level = 99;
  EXPECT_FALSE(
      FollowPatch(*before, *now, {160.0, 120.0}, {160.0, 120.0}, options));
}

TEST(PatchFlow, AgreesWithOpenCv) {
  const cv::Mat one = Texture({});
  const cv::Mat two = Texture({1.3, -0.8}, 3.0);
  const auto before = BuildPyramid(one);
  const auto now = BuildPyramid(two);
  std::vector<cv::Point2f> points;
  for (int y = 20; y < 230; y += 30) {
    for (int x = 20; x < 310; x += 30) points.emplace_back(x + 0.25F, y + 0.5F);
  }
  std::vector<cv::Point2f> theirs;
  std::vector<unsigned char> found;
  std::vector<float> differences;
  cv::calcOpticalFlowPyrLK(one,
                           two,
                           points,
                           theirs,
                           found,
                           differences,
                           {LumaPyramid::kWindowPx, LumaPyramid::kWindowPx},
                           0);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const cv::Point2d from(points[i].x + kPixelCenter,
                           points[i].y + kPixelCenter);
    const auto ours = FollowPatch(*before, *now, from, from, From(0));
    ASSERT_EQ(ours.has_value(), found[i] != 0) << points[i];
    if (!ours) continue;
    EXPECT_NEAR(ours->point_px.x - kPixelCenter, theirs[i].x, 0.03);
    EXPECT_NEAR(ours->point_px.y - kPixelCenter, theirs[i].y, 0.03);
    EXPECT_NEAR(ours->difference, differences[i], 0.2);
  }
}

TEST(PatchFlow, WhatShowsNothingOrLeavesTheImageIsNotFound) {
  const auto before = BuildPyramid(Texture({}));
  const auto flat = BuildPyramid(cv::Mat(kSize_px, CV_8UC1, cv::Scalar(90)));
  cv::Mat stripes(kSize_px, CV_8UC1);
  for (int x = 0; x < stripes.cols; ++x) {
    stripes.col(x).setTo(128.0 + 100.0 * std::sin(0.3 * x));
  }
  const auto striped = BuildPyramid(stripes);
  const cv::Point2d middle(160.0, 120.0);
  EXPECT_FALSE(FollowPatch(*flat, *before, middle, middle, From(3)));
  EXPECT_FALSE(FollowPatch(*striped, *striped, middle, middle, From(3)));
  for (const cv::Point2d outside : {cv::Point2d(-0.1, 100.0),
                                    cv::Point2d(100.0, 240.1),
                                    cv::Point2d(1e300, 0.0),
                                    cv::Point2d(std::nan(""), 0.0)}) {
    EXPECT_FALSE(FollowPatch(*before, *before, middle, outside, From(3)));
    EXPECT_FALSE(FollowPatch(*before, *before, outside, middle, From(3)));
  }
  // Into the very corners, whose patches reach over the border.
  for (const cv::Point2d corner : {cv::Point2d(0.0, 0.0),
                                   cv::Point2d(320.0, 0.0),
                                   cv::Point2d(0.0, 240.0),
                                   cv::Point2d(320.0, 240.0)}) {
    for (const int level : {0, 3}) {
      const auto found =
          FollowPatch(*before, *before, corner, corner, From(level));
      if (found) {
        EXPECT_LT(cv::norm(found->point_px - corner), 0.01);
      }
    }
  }
}

}  // namespace
}  // namespace groundlock::image
