// SPDX-License-Identifier: Apache-2.0
#include "server/localization/fast_localizer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <vector>

#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::localization {
namespace {

using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::LookAlongY;
using test_support::RenderedPlace;

using FastLocalizerTest = WalkTest;

TEST_F(FastLocalizerTest, FindsTheFirstFrameWithoutAPrior) {
  for (const int frame : {0, 25, 60}) {
    const auto localizer = Create();
    const LocalizationResult result = Localize(*localizer, frame);
    ExpectNear(result, frame);
    EXPECT_GE(result.num_inliers, 40);
    EXPECT_EQ(result.inliers.size(),
              static_cast<std::size_t>(result.num_inliers));
  }
}

TEST_F(FastLocalizerTest, TracksWithSmallAndHonestErrors) {
  const auto localizer = Create();
  std::vector<double> errors_m;
  double sum_normalised = 0.0;
  constexpr int kFrames = 90;
  for (int frame = 0; frame < kFrames; ++frame) {
    const LocalizationResult result = Localize(*localizer, frame);
    ExpectNear(result, frame);
    const geometry::Vector6d error =
        PoseDifference(*result.world_from_camera, TruthAt(frame));
    errors_m.push_back(error.head<3>().norm());
    sum_normalised += error.dot(result.covariance.ldlt().solve(error));
    EXPECT_EQ(result.inliers.size(),
              static_cast<std::size_t>(result.num_inliers));
  }
  std::sort(errors_m.begin(), errors_m.end());
  EXPECT_LT(errors_m[kFrames / 2], 0.006);
  EXPECT_LT(errors_m[kFrames * 95 / 100], 0.015);
  // Six, if the covariance were exact. The map of the place has no errors of
  // its own beyond SIFT's, for which the localiser leaves room; errors of
  // neighbouring frames are one.
  const double normalised = sum_normalised / kFrames;
  RecordProperty("mean_normalised_squared_error", std::to_string(normalised));
  EXPECT_GT(normalised, 0.5);
  EXPECT_LT(normalised, 12.0);
}

TEST_F(FastLocalizerTest, TakesPriorsAndIsNotBrokenByWrongOnes) {
  PosePrior right;
  right.position_world = TruthAt(25).translation + Eigen::Vector3d(0.4, 0, 0);
  right.position_sigma = 0.5;
  PosePrior both = right;
  both.rotation = geometry::QuaternionFromRotationVector({0.02, 0.0, 0.05}) *
                  TruthAt(25).rotation;
  both.rotation_sigma_rad = 0.1;
  PosePrior elsewhere;
  elsewhere.position_world = Eigen::Vector3d(80.0, -300.0, 10.0);
  elsewhere.position_sigma = 0.1;
  PosePrior turned = elsewhere;
  turned.rotation = LookAlongY({0, 0, 0}, 2.5, 0.4).rotation;
  turned.rotation_sigma_rad = 0.01;
  for (const PosePrior& prior : {right, both, elsewhere, turned}) {
    const auto localizer = Create();
    ExpectNear(Localize(*localizer, ImageAt(25), 25, {}, prior), 25);
    // Nor in the frames that follow.
    ExpectNear(Localize(*localizer, ImageAt(26), 26, {}, prior), 26);
    // Nor does a right one make a place of another.
    EXPECT_NE(Localize(*Create(), Black(), 25, {}, prior).state,
              CameraState::kTracked);
  }
  PosePrior on_earth;
  on_earth.geodetic_position = geometry::GeodeticPosition{58.4, 15.6, 60.0};
  on_earth.position_sigma = 3.0;
  const auto localizer = Create();
  image::Frame input;
  input.luma = ImageAt(0);
  EXPECT_EQ(localizer->Localize({&input, place_->camera(), {}, on_earth})
                .status()
                .code(),
            absl::StatusCode::kFailedPrecondition);
  PosePrior wrong = right;
  wrong.position_sigma = 0.0;
  EXPECT_EQ(localizer->Localize({&input, place_->camera(), {}, wrong})
                .status()
                .code(),
            absl::StatusCode::kInvalidArgument);
}

// Half a second in the dark, in the middle of a turn.
TEST_F(FastLocalizerTest, OtherSensorsSteerThePoseInTheDark) {
  constexpr int kSeen = 30;
  // Of the map alone the rotation is known to 1 rad by then, and to 0.2 rad
  // after a fifth of a second.
  constexpr int kDark = 14;
  constexpr int kShortlyDark = 5;
  const auto prior_of = [](int frame) {
    PosePrior prior;
    const Eigen::Vector3d arm(0.1, -0.3, 0.0);
    const geometry::Rigid3 truth = TruthAt(frame);
    prior.position_world = truth.translation + truth.rotation * arm +
                           Eigen::Vector3d(0.05, -0.05, 0.02);
    prior.position_sigma = 0.1;
    prior.position_arm_camera = arm;
    prior.rotation =
        geometry::QuaternionFromRotationVector({0.01, 0.0, -0.02}) *
        truth.rotation;
    prior.rotation_sigma_rad = 0.03;
    return prior;
  };
  struct Errors {
    double center_m = 0.0;
    double angle_rad = 0.0;
  };
  const auto walk = [&](bool with_sensors, bool are_wrong, int dark) {
    const auto localizer = Create();
    Errors errors;
    for (int frame = 0; frame < kSeen + dark; ++frame) {
      std::optional<PosePrior> prior;
      if (with_sensors) prior = prior_of(frame);
      if (frame >= kSeen && are_wrong) {
        prior->position_world->x() += 30.0;
        prior->rotation = LookAlongY({0, 0, 0}, 2.5, 0.4).rotation;
      }
      const auto result = Localize(*localizer,
                                   frame < kSeen ? ImageAt(frame) : Black(),
                                   frame,
                                   {},
                                   prior);
      EXPECT_EQ(result.state,
                frame < kSeen ? CameraState::kTracked : CameraState::kHeld);
      if (!result.world_from_camera) return errors;
      errors.center_m =
          test_support::CenterError(*result.world_from_camera, TruthAt(frame));
      errors.angle_rad = test_support::AngleError_rad(*result.world_from_camera,
                                                      TruthAt(frame));
    }
    return errors;
  };
  const Errors alone = walk(false, false, kDark);
  const Errors steered = walk(true, false, kDark);
  std::printf("alone %.3f m, %.4f rad; steered %.3f m, %.4f rad\n",
              alone.center_m,
              alone.angle_rad,
              steered.center_m,
              steered.angle_rad);
  // What they err was learnt while the map was seen.
  EXPECT_LT(steered.center_m, 0.03);
  EXPECT_LT(steered.angle_rad, 0.01);
  EXPECT_LT(steered.center_m, 0.5 * alone.center_m);
  EXPECT_LT(steered.angle_rad, 0.5 * alone.angle_rad);
  // Wrong ones are told by what is known.
  const Errors briefly = walk(false, false, kShortlyDark);
  const Errors misled = walk(true, true, kShortlyDark);
  EXPECT_NEAR(misled.center_m, briefly.center_m, 0.01);
  EXPECT_NEAR(misled.angle_rad, briefly.angle_rad, 0.01);
}

TEST_F(FastLocalizerTest, NeverTracksWhatIsNotThePlace) {
  const RenderedPlace elsewhere(2);
  std::mt19937 engine(1);
  const auto lost = Create();
  const auto tracking = Create();
  int frame = 0;
  Localize(*tracking, frame);
  for (int i = 0; i < 24; ++i) {
    cv::Mat mirrored;
    cv::flip(ImageAt(2 * i), mirrored, 1);
    cv::Mat noise(mirrored.size(), CV_8UC1);
    for (int y = 0; y < noise.rows; ++y) {
      for (int x = 0; x < noise.cols; ++x) {
        noise.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(engine());
      }
    }
    // Of the size of things: fine noise has features everywhere.
    cv::GaussianBlur(noise, noise, cv::Size(), 1.0 + 0.1 * i);
    cv::normalize(noise, noise, 0, 255, cv::NORM_MINMAX);
    const cv::Mat flat(mirrored.size(), CV_8UC1, cv::Scalar(7 * i));
    const bool is_lost = i % 4 < 2;
    for (const cv::Mat& image :
         {flat,
          mirrored,
          i % 2 == 0 ? noise : elsewhere.Render(TruthAt(2 * i))}) {
      ++frame;
      const CameraState state =
          Localize(is_lost ? *lost : *tracking, image, frame).state;
      EXPECT_NE(state, CameraState::kTracked) << i;
      if (is_lost) {
        EXPECT_EQ(state, CameraState::kInitializing) << i;
      }
    }
  }
}

TEST_F(FastLocalizerTest, HoldsThenLosesThenComesBack) {
  const auto localizer = Create();
  for (int frame = 0; frame <= 5; ++frame) Localize(*localizer, frame);
  LocalizationResult before;
  for (int frame = 6; frame <= 26; ++frame) {
    // 0.8 s are 19.05 frames after frame 5.
    const LocalizationResult result = Localize(*localizer, Black(), frame);
    if (frame <= 24) {
      ASSERT_EQ(result.state, CameraState::kHeld) << frame;
      ASSERT_TRUE(result.world_from_camera);
      EXPECT_TRUE(result.inliers.empty());
      if (before.world_from_camera) {
        EXPECT_GT(result.covariance(0, 0), before.covariance(0, 0));
        EXPECT_GT(result.covariance(5, 5), before.covariance(5, 5));
      }
      before = result;
    } else {
      ASSERT_EQ(result.state, CameraState::kLost) << frame;
      EXPECT_FALSE(result.world_from_camera);
    }
  }
  for (int frame = 27; frame < 32; ++frame) {
    ExpectNear(Localize(*localizer, frame), frame);
  }
}

TEST_F(FastLocalizerTest, CapturesFarApartInTimeAreLostAtOnce) {
  const auto localizer = Create();
  Localize(*localizer, 0);
  // By the frames' own clock, not by their number.
  EXPECT_EQ(Localize(*localizer, Black(), 100).state, CameraState::kLost);
}

TEST_F(FastLocalizerTest, ComesBackAfterAShortGap) {
  const auto localizer = Create();
  for (int frame = 0; frame < 40; ++frame) {
    const bool is_black = frame >= 12 && frame < 20;
    const LocalizationResult result =
        Localize(*localizer, is_black ? Black() : ImageAt(frame), frame);
    if (is_black) {
      EXPECT_EQ(result.state, CameraState::kHeld) << frame;
    } else {
      ExpectNear(result, frame);
    }
  }
}

// In the middle of a turn nothing is seen for a sixth of a second.
TEST_F(FastLocalizerTest, CoastsThroughATurn) {
  const auto localizer = Create();
  for (int frame = 0; frame < 40; ++frame) {
    const bool is_black = frame >= 16 && frame < 20;
    const LocalizationResult result =
        Localize(*localizer, is_black ? Black() : ImageAt(frame), frame);
    ASSERT_TRUE(result.world_from_camera);
    EXPECT_EQ(result.state,
              is_black ? CameraState::kHeld : CameraState::kTracked);
    EXPECT_EQ(result.reset_count, 1U);
    // A degree.
    EXPECT_LT(AngleError_rad(*result.world_from_camera, TruthAt(frame)), 0.0175)
        << frame;
  }
}

// Another place is seen, by a camera that turns as before: nothing is verified,
// but its corners tell the rotation.
TEST_F(FastLocalizerTest, BridgesTheRotationByImageCorners) {
  const RenderedPlace elsewhere(2);
  // Searches of the map, which would find nothing there, cost the most.
  bool may_search = true;
  const auto localizer =
      Create(false, [&](Urgency, const std::function<void()>& task) {
        if (may_search) task();
      });
  const auto truth = [](int frame) {
    return LookAlongY({0.0, 0.0, 1.65}, 0.012 * std::max(0, frame - 6), 0.0);
  };
  LocalizationResult result;
  for (int frame = 0; frame < 20; ++frame) {
    may_search = frame < 8;
    const RenderedPlace& place = may_search ? *place_ : elsewhere;
    result = Localize(*localizer, place.Render(truth(frame)), frame);
    if (frame == 0) continue;  // its anchor comes with the next
    EXPECT_EQ(result.state,
              may_search ? CameraState::kTracked : CameraState::kHeld);
  }
  // 8 degrees since it was last seen.
  EXPECT_LT(AngleError_rad(*result.world_from_camera, truth(19)), 0.0175);
  // It knows so, and that it does not know where it is.
  EXPECT_LT(result.covariance(5, 5), 0.05 * 0.05);
  EXPECT_GT(result.covariance(0, 0), 0.1 * 0.1);
  may_search = true;
  for (int frame = 20; frame < 23; ++frame) {
    result = Localize(*localizer, place_->Render(truth(19)), frame);
  }
  EXPECT_EQ(result.state, CameraState::kTracked);
  EXPECT_LT(CenterError(*result.world_from_camera, truth(19)), 0.03);
}

TEST_F(FastLocalizerTest, LeavesOutMasks) {
  const auto localizer = Create();
  const std::vector<geometry::Box2> masks_px = {
      geometry::Box2::FromXywh(220.0, 120.0, 200.0, 180.0)};
  for (int frame = 0; frame < 30; ++frame) {
    // Something large moves there, to the right: 4 px a frame.
    cv::Mat luma = ImageAt(frame).clone();
    const cv::Mat target =
        ImageAt(0)(cv::Rect(10 + 4 * (30 - frame), 20, 196, 176));
    target.copyTo(luma(cv::Rect(222, 122, 196, 176)));
    const LocalizationResult result =
        Localize(*localizer, luma, frame, masks_px);
    ExpectNear(result, frame);
    for (const LandmarkMatch& match : result.inliers) {
      EXPECT_FALSE(masks_px[0].Contains(match.pixel_px)) << frame;
    }
  }
}

TEST_F(FastLocalizerTest, TakesUpAnAnchorThatComesSecondsLate) {
  constexpr int kLate = 55;  // 2.3 s: only every fourth frame is kept
  std::vector<std::function<void()>> tasks;
  const auto localizer =
      Create(false, [&](Urgency, std::function<void()> task) {
        tasks.push_back(std::move(task));
      });
  for (int frame = 0; frame < kLate; ++frame) {
    EXPECT_EQ(Localize(*localizer, frame).state, CameraState::kInitializing);
  }
  ASSERT_EQ(tasks.size(), 1U);
  tasks[0]();
  for (int frame = kLate; frame < kLate + 3; ++frame) {
    ExpectNear(Localize(*localizer, frame), frame);
  }
}

TEST_F(FastLocalizerTest, ResetForgets) {
  const auto localizer = Create();
  for (int frame = 0; frame < 5; ++frame) Localize(*localizer, frame);
  localizer->Reset();
  const LocalizationResult black = Localize(*localizer, Black(), 5);
  EXPECT_EQ(black.state, CameraState::kInitializing);
  EXPECT_FALSE(black.world_from_camera);
  ExpectNear(Localize(*localizer, 6), 6);
}

TEST_F(FastLocalizerTest, WrongFramesAreErrorsAndHarmless) {
  const auto localizer = Create();
  Localize(*localizer, 0);
  image::Frame small;
  small.luma = cv::Mat(36, 64, CV_8UC1, cv::Scalar(0));
  EXPECT_EQ(localizer->Localize({&small, place_->camera(), {}}).status().code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(
      localizer->Localize({nullptr, place_->camera(), {}}).status().code(),
      absl::StatusCode::kInvalidArgument);
  ExpectNear(Localize(*localizer, 1), 1);
}

}  // namespace
}  // namespace groundlock::localization
