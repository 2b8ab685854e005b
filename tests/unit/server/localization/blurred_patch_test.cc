// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/blurred_patch.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "server/localization/follow/exposure_estimate.h"

namespace groundlock::localization {
namespace {

using Eigen::Vector2d;

constexpr int kWidth = 400;
constexpr int kHeight = 300;

// Smooth noise that is known between the pixels too.
cv::Mat Texture(std::uint64_t seed) {
  cv::Mat noise(kHeight, kWidth, CV_32F);
  cv::RNG random(seed);
  random.fill(noise, cv::RNG::UNIFORM, 0.0, 255.0);
  cv::GaussianBlur(noise, noise, cv::Size(), 1.5);
  cv::normalize(noise, noise, 40.0, 210.0, cv::NORM_MINMAX);
  return noise;
}

// What a camera records while the texture moves by `blur` about `shift`.
cv::Mat Record(const cv::Mat& texture,
               const Vector2d& shift,
               const Vector2d& blur,
               double gain = 1.0,
               double offset = 0.0) {
  constexpr int kMoments = 41;
  cv::Mat sum = cv::Mat::zeros(texture.size(), CV_32F);
  for (int i = 0; i < kMoments; ++i) {
    const Vector2d at = shift + ((i + 0.5) / kMoments - 0.5) * blur;
    const cv::Matx23d move(1.0, 0.0, at.x(), 0.0, 1.0, at.y());
    cv::Mat moved;
    cv::warpAffine(texture,
                   moved,
                   move,
                   texture.size(),
                   cv::INTER_CUBIC,
                   cv::BORDER_REFLECT_101);
    sum += moved;
  }
  cv::Mat image;
  sum.convertTo(image, CV_8U, gain / kMoments, offset);
  return image;
}

std::vector<Vector2d> Places() {
  std::vector<Vector2d> places;
  for (double y = 50.0; y < kHeight - 50.0; y += 20.0) {
    for (double x = 50.0; x < kWidth - 50.0; x += 20.0) {
      places.emplace_back(x, y);
    }
  }
  return places;
}

struct Errors {
  std::vector<double> px;  // sorted
  Vector2d mean = Vector2d::Zero();
};

Errors Align(const cv::Mat& key,
             const cv::Mat& current,
             const Vector2d& shift,
             const Vector2d& key_blur,
             const Vector2d& current_blur) {
  Errors errors;
  for (const Vector2d& place : Places()) {
    PatchPair pair;
    pair.key_point = place;
    pair.key_blur = key_blur;
    pair.current_blur = current_blur;
    const Vector2d truth = place + shift;
    const auto found =
        AlignPatch(key, current, pair, truth + Vector2d(0.6, -0.8));
    if (!found) continue;
    errors.px.push_back((*found - truth).norm());
    errors.mean += *found - truth;
  }
  errors.mean /= std::max<double>(1.0, static_cast<double>(errors.px.size()));
  std::sort(errors.px.begin(), errors.px.end());
  return errors;
}

TEST(BlurredPatchTest, FindsSharpPatchesInBlurredImages) {
  const cv::Mat texture = Texture(3);
  const Vector2d shift(2.3, -3.6);
  const Vector2d blur(2.0, 11.0);
  const cv::Mat sharp = Record(texture, Vector2d::Zero(), Vector2d::Zero());
  const cv::Mat blurred = Record(texture, shift, blur);
  const Errors errors = Align(sharp, blurred, shift, Vector2d::Zero(), blur);
  ASSERT_GT(errors.px.size(), Places().size() * 8 / 10);
  EXPECT_LT(errors.px[errors.px.size() / 2], 0.15);
  EXPECT_LT(errors.px[errors.px.size() * 9 / 10], 0.5);
  EXPECT_LT(errors.mean.norm(), 0.05);
  // Taken for sharp, most of the image is off by more.
  const Errors naive =
      Align(sharp, blurred, shift, Vector2d::Zero(), Vector2d::Zero());
  if (naive.px.size() > Places().size() / 2) {
    EXPECT_GT(naive.px[naive.px.size() / 2],
              2.0 * errors.px[errors.px.size() / 2]);
  }
}

TEST(BlurredPatchTest, EqualisesBlursOfBothImages) {
  const cv::Mat texture = Texture(4);
  const Vector2d shift(-1.7, 0.4);
  const Vector2d across(9.0, 0.0);
  const Vector2d along(0.0, 7.0);
  const cv::Mat key = Record(texture, Vector2d::Zero(), across);
  const cv::Mat current = Record(texture, shift, along);
  const Errors errors = Align(key, current, shift, across, along);
  ASSERT_GT(errors.px.size(), Places().size() * 7 / 10);
  EXPECT_LT(errors.px[errors.px.size() / 2], 0.3);
  EXPECT_LT(errors.mean.norm(), 0.1);
}

TEST(BlurredPatchTest, BrightnessDoesNotShiftIt) {
  const cv::Mat texture = Texture(5);
  const Vector2d shift(0.5, 1.25);
  const cv::Mat key = Record(texture, Vector2d::Zero(), Vector2d::Zero());
  const cv::Mat dim = Record(texture, shift, Vector2d::Zero(), 0.7, 12.0);
  const Errors errors =
      Align(key, dim, shift, Vector2d::Zero(), Vector2d::Zero());
  ASSERT_GT(errors.px.size(), Places().size() * 9 / 10);
  EXPECT_LT(errors.px[errors.px.size() * 9 / 10], 0.1);
  EXPECT_LT(errors.mean.norm(), 0.05);
}

TEST(BlurredPatchTest, RefusesOtherThingsAndBorders) {
  const cv::Mat key = Record(Texture(6), Vector2d::Zero(), Vector2d::Zero());
  const cv::Mat other = Record(Texture(7), Vector2d::Zero(), Vector2d::Zero());
  const Vector2d none = Vector2d::Zero();
  EXPECT_LT(Align(key, other, none, none, none).px.size(),
            Places().size() / 10);
  const cv::Mat flat(kHeight, kWidth, CV_8UC1, cv::Scalar(90));
  EXPECT_EQ(Align(flat, key, none, none, none).px.size(), 0U);
  EXPECT_EQ(Align(key, flat, none, none, none).px.size(), 0U);

  PatchPair pair;
  for (const Vector2d& place : {Vector2d(3.0, 100.0),
                                Vector2d(kWidth - 2.0, 100.0),
                                Vector2d(100.0, -40.0),
                                Vector2d(1e9, 1e9)}) {
    pair.key_point = place;
    EXPECT_FALSE(AlignPatch(key, key, pair, place));
    EXPECT_FALSE(PatchMismatch(key, key, pair, place));
  }
  pair.key_point = {100.0, 100.0};
  pair.current_blur = {1e4, 0.0};
  EXPECT_FALSE(AlignPatch(key, key, pair, pair.key_point));
  pair.current_blur = {NAN, 0.0};
  EXPECT_FALSE(AlignPatch(key, key, pair, pair.key_point));
}

TEST(ExposureEstimateTest, FindsTheExposureOfMovingFrames) {
  const cv::Mat texture = Texture(8);
  const cv::Mat sharp = Record(texture, Vector2d::Zero(), Vector2d::Zero());
  const Vector2d velocity_px_s(300.0, -500.0);
  for (const double exposure_s : {0.006, 0.0125, 0.021}) {
    ExposureEstimate exposure;
    EXPECT_EQ(exposure.seconds(), 0.0);
    const cv::Mat moving =
        Record(texture, Vector2d::Zero(), exposure_s * velocity_px_s);
    std::vector<MovingPatch> patches;
    for (const Vector2d& place : Places()) {
      MovingPatch& patch = patches.emplace_back();
      patch.pair.key_point = place;
      patch.pair.current_blur = velocity_px_s;
      patch.point = place;
    }
    exposure.Observe(sharp, moving, patches);
    EXPECT_NEAR(exposure.seconds(), exposure_s, 0.002);
    // Equal motion tells nothing, and changes nothing.
    const double before_s = exposure.seconds();
    for (MovingPatch& patch : patches) patch.pair.key_blur = velocity_px_s;
    exposure.Observe(moving, moving, patches);
    EXPECT_EQ(exposure.seconds(), before_s);
  }
}

}  // namespace
}  // namespace groundlock::localization
