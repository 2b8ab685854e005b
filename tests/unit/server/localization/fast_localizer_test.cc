// SPDX-License-Identifier: Apache-2.0
#include "server/localization/fast_localizer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "tests/support/rendered_plane_map.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

using geometry::Rigid3;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::LookAlongY;
using test_support::RenderedPlace;

constexpr nanoseconds kFrame = milliseconds(42);

// Runs tasks on threads of its own; joins them in the end.
class Threads {
 public:
  BackgroundRunner Runner() {
    return [this](Urgency, std::function<void()> task) {
      threads_.emplace_back(std::move(task));
    };
  }
  void Join() {
    for (std::thread& thread : threads_) thread.join();
    threads_.clear();
  }
  std::size_t size() const { return threads_.size(); }
  ~Threads() { Join(); }

 private:
  std::vector<std::thread> threads_;
};

class FastLocalizerTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    // Sessions are the threads; OpenCV's own, which no sanitizer sees into,
    // would only look like races.
    cv::setNumThreads(1);
    if (map_ != nullptr) return;
    place_ = std::make_unique<RenderedPlace>(1);
    map_ = test_support::OpenTemporaryMap(
        MapFromViews(*place_, test_support::MappingViews()));
    ASSERT_NE(map_, nullptr);
  }

  // A walk to and fro before the wall: up to 1.3 m/s and 0.3 rad/s.
  static Rigid3 TruthAt(int frame) {
    const double phase = 0.06 * frame;
    return LookAlongY({1.0 * std::sin(0.9 * phase),
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

  static std::unique_ptr<Localizer> Create(
      bool wait_for_anchor = true, BackgroundRunner run_in_background = {}) {
    LocalizerOptions options;
    options.wait_for_anchor = wait_for_anchor;
    options.seed = 5;
    options.lost_after = milliseconds(800);
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
    EXPECT_LT(CenterError(*result.world_from_camera, TruthAt(frame)), 0.03)
        << frame;
    EXPECT_LT(AngleError_rad(*result.world_from_camera, TruthAt(frame)), 0.004)
        << frame;
  }

  static std::unique_ptr<RenderedPlace> place_;
  static std::shared_ptr<const map::Map> map_;
};
std::unique_ptr<RenderedPlace> FastLocalizerTest::place_;
std::shared_ptr<const map::Map> FastLocalizerTest::map_;

// One thread from beginning to end: nothing for the thread sanitizer, under
// which descriptors are compared twenty times as slowly.
class FastLocalizerAloneTest : public FastLocalizerTest {
 protected:
  void SetUp() override {
#if defined(__SANITIZE_THREAD__)
    GTEST_SKIP() << "no threads in it";
#endif
  }
};

TEST_F(FastLocalizerAloneTest, FindsTheFirstFrameWithoutAPrior) {
  for (const int frame : {0, 25, 60}) {
    const auto localizer = Create();
    const LocalizationResult result = Localize(*localizer, frame);
    ExpectNear(result, frame);
    EXPECT_GE(result.num_inliers, 40);
    EXPECT_EQ(result.inliers.size(),
              static_cast<std::size_t>(result.num_inliers));
  }
}

TEST_F(FastLocalizerAloneTest, TracksWithSmallAndHonestErrors) {
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

TEST_F(FastLocalizerAloneTest, TakesPriorsAndIsNotBrokenByWrongOnes) {
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

TEST_F(FastLocalizerTest, TwoRunsAreEqualWithAndWithoutThreads) {
  constexpr int kFrames = 36;
  std::vector<std::vector<LocalizationResult>> runs;
  Threads threads;
  for (const bool with_threads : {false, true}) {
    const auto localizer =
        Create(true, with_threads ? threads.Runner() : BackgroundRunner());
    std::vector<LocalizationResult>& results = runs.emplace_back();
    for (int frame = 0; frame < kFrames; ++frame) {
      const bool is_black = frame >= 3 && frame < 5;
      results.push_back(
          Localize(*localizer, is_black ? Black() : ImageAt(frame), frame));
    }
  }
  EXPECT_GE(threads.size(), 1U);  // there was an anchor to wait for
  for (std::size_t run = 1; run < runs.size(); ++run) {
    for (int frame = 0; frame < kFrames; ++frame) {
      const LocalizationResult& one = runs[0][frame];
      const LocalizationResult& two = runs[run][frame];
      ASSERT_EQ(one.state, two.state) << frame;
      ASSERT_EQ(one.num_inliers, two.num_inliers) << frame;
      ASSERT_EQ(one.world_from_camera.has_value(),
                two.world_from_camera.has_value());
      if (!one.world_from_camera) continue;
      ASSERT_EQ(one.world_from_camera->translation,
                two.world_from_camera->translation)
          << frame;
      ASSERT_EQ(one.world_from_camera->rotation.coeffs(),
                two.world_from_camera->rotation.coeffs());
      ASSERT_EQ(one.covariance, two.covariance) << frame;
    }
  }
}

TEST_F(FastLocalizerAloneTest, NeverTracksWhatIsNotThePlace) {
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

TEST_F(FastLocalizerAloneTest, HoldsThenLosesThenComesBack) {
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

TEST_F(FastLocalizerAloneTest, CapturesFarApartInTimeAreLostAtOnce) {
  const auto localizer = Create();
  Localize(*localizer, 0);
  // By the frames' own clock, not by their number.
  EXPECT_EQ(Localize(*localizer, Black(), 100).state, CameraState::kLost);
}

TEST_F(FastLocalizerAloneTest, ComesBackAfterAShortGap) {
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
TEST_F(FastLocalizerAloneTest, CoastsThroughATurn) {
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
TEST_F(FastLocalizerAloneTest, BridgesTheRotationByImageCorners) {
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

TEST_F(FastLocalizerAloneTest, LeavesOutMasks) {
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

TEST_F(FastLocalizerTest, AnchorsOnAThreadWithoutWaiting) {
  Threads threads;
  {
    const auto localizer = Create(false, threads.Runner());
    // The first frame does not wait.
    EXPECT_EQ(Localize(*localizer, 0).state, CameraState::kInitializing);
    EXPECT_EQ(threads.size(), 1U);
    threads.Join();
    for (int frame = 1; frame < 60; ++frame) {
      ExpectNear(Localize(*localizer, frame), frame);
      // As if a live camera gave the thread its time, now and then.
      if (frame % 5 == 0) threads.Join();
    }
    for (int frame = 60; frame < 66; ++frame) {
      EXPECT_EQ(Localize(*localizer, Black(), frame).state, CameraState::kHeld);
    }
    threads.Join();
    // By now the key frame's landmarks are elsewhere: an anchor brings it back.
    for (int frame = 66; frame < 80; ++frame) {
      const LocalizationResult result = Localize(*localizer, frame);
      threads.Join();
      if (frame > 68) ExpectNear(result, frame);
    }
  }
}

TEST_F(FastLocalizerTest, BackgroundWorkIsBounded) {
  Threads threads;
  // The frame path itself has looked: no task looks again.
  const auto waiting = Create(true, threads.Runner());
  for (int frame = 0; frame < 5; ++frame) Localize(*waiting, Black(), frame);
  EXPECT_EQ(threads.size(), 0U);
  // One task at a time.
  std::vector<std::function<void()>> tasks;
  const auto live = Create(false, [&](Urgency, std::function<void()> task) {
    tasks.push_back(std::move(task));
  });
  for (int frame = 0; frame < 5; ++frame) Localize(*live, Black(), frame);
  EXPECT_EQ(tasks.size(), 1U);
}

TEST_F(FastLocalizerAloneTest, TakesUpAnAnchorThatComesSecondsLate) {
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

TEST_F(FastLocalizerTest, SearchesGiveWayOnceACameraIsNowhere) {
  std::vector<Urgency> urgencies;
  const auto localizer =
      Create(false, [&](Urgency urgency, const std::function<void()>& task) {
        urgencies.push_back(urgency);
        task();
      });
  for (int frame = 0; frame < 10; ++frame) Localize(*localizer, Black(), frame);
  ASSERT_GE(urgencies.size(), 8U);
  EXPECT_EQ(urgencies.front(), Urgency::kNow);
  EXPECT_EQ(urgencies.back(), Urgency::kLater);
  urgencies.clear();
  // Found: what follows only refreshes.
  for (int frame = 10; frame < 50; ++frame) Localize(*localizer, frame);
  ASSERT_FALSE(urgencies.empty());
  EXPECT_EQ(urgencies.back(), Urgency::kLater);
  urgencies.clear();
  // Gone again: at once.
  for (int frame = 50; frame < 52; ++frame)
    Localize(*localizer, Black(), frame);
  ASSERT_FALSE(urgencies.empty());
  EXPECT_EQ(urgencies.front(), Urgency::kNow);
}

// A pool that shuts down drops its tasks: sessions go on without anchors.
TEST_F(FastLocalizerTest, DroppedTasksDoNotBlockTheFramePath) {
  for (const bool wait_for_anchor : {true, false}) {
    const auto localizer =
        Create(wait_for_anchor, [](Urgency, const std::function<void()>&) {});
    for (int frame = 0; frame < 40; ++frame) {
      const LocalizationResult result = Localize(*localizer, frame);
      if (wait_for_anchor) ExpectNear(result, frame);
    }
  }
}

TEST_F(FastLocalizerTest, MayBeDestroyedOrResetWhileItsAnchorRuns) {
  Threads threads;
  for (const bool wait_for_anchor : {false, true}) {
    for (int last = 0; last < 15; last += 7) {
      auto localizer = Create(wait_for_anchor, threads.Runner());
      for (int frame = 0; frame <= last; ++frame) Localize(*localizer, frame);
      if (last % 2 == 0) localizer->Reset();
      localizer.reset();
    }
  }
  threads.Join();
}

TEST_F(FastLocalizerAloneTest, ResetForgets) {
  const auto localizer = Create();
  for (int frame = 0; frame < 5; ++frame) Localize(*localizer, frame);
  localizer->Reset();
  const LocalizationResult black = Localize(*localizer, Black(), 5);
  EXPECT_EQ(black.state, CameraState::kInitializing);
  EXPECT_FALSE(black.world_from_camera);
  ExpectNear(Localize(*localizer, 6), 6);
}

TEST_F(FastLocalizerAloneTest, WrongFramesAreErrorsAndHarmless) {
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

// A sender may change its resolution in mid-stream.
TEST_F(FastLocalizerAloneTest, FramesMayChangeTheirSize) {
  Threads threads;
  for (const bool wait_for_anchor : {true, false}) {
    const auto localizer =
        wait_for_anchor ? Create() : Create(false, threads.Runner());
    const auto localize = [&](int frame, const cv::Size& size_px) {
      image::Frame input;
      input.sequence = static_cast<std::uint64_t>(frame);
      input.capture_time = frame * kFrame;
      if (size_px == ImageAt(frame).size()) {
        input.luma = ImageAt(frame);
      } else {
        cv::resize(
            ImageAt(frame), input.luma, size_px, 0.0, 0.0, cv::INTER_AREA);
      }
      const auto result = localizer->Localize(
          {&input,
           place_->camera().Rescaled(size_px.width, size_px.height),
           {}});
      threads.Join();
      ASSERT_TRUE(result.ok()) << result.status();
      if (wait_for_anchor && size_px.width >= 480) ExpectNear(*result, frame);
    };
    for (int frame = 0; frame < 12; ++frame) localize(frame, {640, 360});
    for (int frame = 12; frame < 24; ++frame) localize(frame, {480, 270});
    for (int frame = 24; frame < 26; ++frame) localize(frame, {1, 1});
    for (int frame = 26; frame < 28; ++frame) localize(frame, {8, 300});
    for (int frame = 28; frame < 34; ++frame) localize(frame, {640, 360});
  }
}

}  // namespace
}  // namespace groundlock::localization
