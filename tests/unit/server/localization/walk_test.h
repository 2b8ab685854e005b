// SPDX-License-Identifier: Apache-2.0
// A walk before the rendered place's wall, localised frame by frame.
#ifndef GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_WALK_TEST_H_
#define GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_WALK_TEST_H_

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "server/localization/localizer.h"
#include "tests/support/perturbation.h"
#include "tests/support/rendered_place_test.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {

class WalkTest : public test_support::RenderedPlaceTest {
 protected:
  static constexpr std::chrono::milliseconds kFrame{42};

  // A walk to and fro before the wall: up to 1.3 m/s and 0.3 rad/s.
  static geometry::Rigid3 TruthAt(int frame) {
    const double phase = 0.06 * frame;
    return test_support::LookAlongY({1.0 * std::sin(0.9 * phase),
                                     0.25 * std::sin(0.7 * phase),
                                     1.65 + 0.08 * std::sin(1.7 * phase)},
                                    0.1 * std::sin(1.3 * phase + 0.5),
                                    -0.03 + 0.04 * std::sin(1.1 * phase));
  }
  static const cv::Mat& ImageAt(int frame) {
    static std::vector<cv::Mat> images;
    while (static_cast<int>(images.size()) <= frame) {
      images.push_back(
          place_->Render(TruthAt(static_cast<int>(images.size()))));
    }
    return images[frame];
  }

  static LocalizerOptions LocalizerOptionsOfWalk() {
    LocalizerOptions options;
    options.seed = test_support::PerturbedSeed(5);
    options.lost_after = std::chrono::milliseconds(800);
    return options;
  }
  static std::unique_ptr<Localizer> Create(
      bool wait_for_anchor = true,
      BackgroundRunner run_in_background = {},
      std::chrono::milliseconds lost_after = std::chrono::milliseconds(800)) {
    LocalizerOptions options = LocalizerOptionsOfWalk();
    options.wait_for_anchor = wait_for_anchor;
    options.lost_after = lost_after;
    auto localizer =
        CreateLocalizer("fast", map_, options, std::move(run_in_background));
    EXPECT_TRUE(localizer.ok()) << localizer.status();
    return *std::move(localizer);
  }
  static LocalizationResult Localize(
      Localizer& localizer,
      const cv::Mat& luma,
      int frame,
      std::vector<geometry::Box2> masks_px = {},
      const std::optional<PosePrior>& prior = std::nullopt) {
    image::Frame input;
    input.sequence = static_cast<std::uint64_t>(frame);
    input.capture_time = frame * kFrame;
    input.luma = luma;
    const auto result = localizer.Localize(
        {&input, place_->camera(), std::move(masks_px), prior});
    EXPECT_TRUE(result.ok()) << result.status();
    return result.ok() ? *result : LocalizationResult();
  }
  static LocalizationResult Localize(Localizer& localizer, int frame) {
    return Localize(localizer, ImageAt(frame), frame);
  }
  static cv::Mat Black() {
    return cv::Mat(ImageAt(0).size(), CV_8UC1, cv::Scalar(0));
  }
  static void ExpectNear(const LocalizationResult& result, int frame) {
    ASSERT_EQ(result.state, CameraState::kTracked) << frame;
    // Landmarks 5 to 9 m away, 60 px/m: a centimetre is a third of a pixel in
    // all landmarks together, far beyond what noise does.
    EXPECT_LT(
        test_support::CenterError(*result.world_from_camera, TruthAt(frame)),
        0.03)
        << frame;
    EXPECT_LT(
        test_support::AngleError_rad(*result.world_from_camera, TruthAt(frame)),
        0.004)
        << frame;
  }
};

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_WALK_TEST_H_
