// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/keyframes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/imgproc.hpp>

namespace groundlock::build {
namespace {

constexpr int kWidth = 320;
constexpr int kHeight = 180;

// A strip of texture that the camera moves along.
cv::Mat Strip() {
  cv::Mat strip(kHeight, 4 * kWidth, CV_8UC1);
  cv::RNG random(7);
  random.fill(strip, cv::RNG::UNIFORM, 0, 255);
  cv::GaussianBlur(strip, strip, cv::Size(), 2.0);
  cv::normalize(strip, strip, 0, 255, cv::NORM_MINMAX);
  return strip;
}

cv::Mat FrameAt(const cv::Mat& strip, int x, double blur = 0.0) {
  cv::Mat frame = strip(cv::Rect(x, 0, kWidth, kHeight)).clone();
  if (blur > 0.0) cv::GaussianBlur(frame, frame, cv::Size(), blur);
  return frame;
}

TEST(Sharpness, FallsWithBlurAndIsZeroWithoutContent) {
  const cv::Mat strip = Strip();
  const double sharp = Sharpness(FrameAt(strip, 0));
  EXPECT_LT(Sharpness(FrameAt(strip, 0, 2.0)), 0.5 * sharp);
  EXPECT_LT(Sharpness(FrameAt(strip, 0, 4.0)),
            Sharpness(FrameAt(strip, 0, 2.0)));
  EXPECT_EQ(Sharpness(cv::Mat(kHeight, kWidth, CV_8UC1, cv::Scalar(80))), 0.0);
}

TEST(KeyframeSelector, ASteadyCameraGivesOneKeyframe) {
  const cv::Mat strip = Strip();
  KeyframeSelector selector({});
  for (int i = 0; i < 30; ++i) selector.Add(FrameAt(strip, 0));
  const auto keyframes = selector.Finish();
  ASSERT_EQ(keyframes.size(), 1U);
  EXPECT_EQ(keyframes[0].frame, 0U);
}

TEST(KeyframeSelector, KeyframesAreAStepApart) {
  const cv::Mat strip = Strip();
  KeyframeOptions options;
  options.spacing = 0.1;  // 32 px: 16 frames of 2 px
  KeyframeSelector selector(options);
  for (int i = 0; i < 200; ++i) selector.Add(FrameAt(strip, 2 * i));
  const auto keyframes = selector.Finish();
  // Between the half and the whole of a step, from the second half of which
  // the sharpest comes.
  ASSERT_GE(keyframes.size(), 12U);
  ASSERT_LE(keyframes.size(), 26U);
  for (std::size_t i = 1; i + 1 < keyframes.size(); ++i) {
    EXPECT_GE(keyframes[i].frame - keyframes[i - 1].frame, 7U) << i;
    EXPECT_LE(keyframes[i].frame - keyframes[i - 1].frame, 17U) << i;
  }
}

TEST(KeyframeSelector, BlurredFramesAreAvoided) {
  const cv::Mat strip = Strip();
  KeyframeOptions options;
  options.spacing = 0.1;
  KeyframeSelector selector(options);
  // Only every fourth frame is sharp.
  for (int i = 0; i < 200; ++i) {
    selector.Add(FrameAt(strip, 2 * i, i % 4 == 0 ? 0.0 : 3.0));
  }
  const auto keyframes = selector.Finish();
  ASSERT_GE(keyframes.size(), 8U);
  // The last one ends the way and has less to choose from.
  for (std::size_t i = 0; i + 1 < keyframes.size(); ++i) {
    EXPECT_EQ(keyframes[i].frame % 4, 0U) << i;
    EXPECT_FALSE(keyframes[i].is_blurred);
  }
}

TEST(KeyframeSelector, WhereNothingCanBeFollowedEveryFrameCounts) {
  KeyframeSelector selector({});
  cv::RNG random(3);
  for (int i = 0; i < 6; ++i) {
    cv::Mat frame(kHeight, kWidth, CV_8UC1);
    random.fill(frame, cv::RNG::UNIFORM, 0, 255);
    cv::GaussianBlur(frame, frame, cv::Size(), 1.5);
    selector.Add(frame);
  }
  EXPECT_GE(selector.Finish().size(), 5U);
}

TEST(KeyframeSelector, BlackFramesAtTheStartAreSkipped) {
  const cv::Mat strip = Strip();
  KeyframeSelector selector({});
  for (int i = 0; i < 5; ++i) {
    selector.Add(cv::Mat(kHeight, kWidth, CV_8UC1, cv::Scalar(0)));
  }
  selector.Add(FrameAt(strip, 0));
  const auto keyframes = selector.Finish();
  ASSERT_EQ(keyframes.size(), 1U);
  EXPECT_EQ(keyframes[0].frame, 5U);
}

TEST(ThinOut, KeepsBothEndsAndSpreadsTheRest) {
  std::vector<Keyframe> keyframes(100);
  for (std::size_t i = 0; i < keyframes.size(); ++i) keyframes[i].frame = i;
  const auto thinned = ThinOut(keyframes, 10);
  ASSERT_EQ(thinned.size(), 10U);
  EXPECT_EQ(thinned.front().frame, 0U);
  EXPECT_EQ(thinned.back().frame, 99U);
  for (std::size_t i = 1; i < thinned.size(); ++i) {
    EXPECT_EQ(thinned[i].frame - thinned[i - 1].frame, 11U);
  }
  EXPECT_EQ(ThinOut(keyframes, 0).size(), 100U);
  EXPECT_EQ(ThinOut(keyframes, 1).size(), 1U);
}

TEST(KeyframeOptions, NamesTheField) {
  KeyframeOptions options;
  options.spacing = 0.0;
  EXPECT_THAT(std::string(options.Validate().message()),
              ::testing::HasSubstr("spacing"));
}

}  // namespace
}  // namespace groundlock::build
