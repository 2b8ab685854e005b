// SPDX-License-Identifier: Apache-2.0
// Anchors on threads beside the frames.
#include <gtest/gtest.h>

#include <functional>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <thread>
#include <vector>

#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::localization {
namespace {

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

using BackgroundAnchorsTest = WalkTest;

// One thread at a time: nothing for the thread sanitizer, under which
// descriptors are compared twenty times as slowly.
class AnchorsInTurnsTest : public WalkTest {
 protected:
  void SetUp() override {
#if defined(__SANITIZE_THREAD__)
    GTEST_SKIP() << "no two threads at a time in it";
#endif
  }
};

TEST_F(BackgroundAnchorsTest, TwoRunsAreEqualWithAndWithoutThreads) {
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

// Whoever is waited for runs at the waiter's priority: what no thread has begun
// the waiting frame seeks itself, and nothing it waits for gives way to other
// programs.
TEST_F(BackgroundAnchorsTest, NobodyWaitsForAThreadThatDoesNotCome) {
  std::vector<std::function<void()>> never_run;
  bool all_urgent = true;
  const auto localizer =
      Create(true, [&](Urgency urgency, std::function<void()> task) {
        all_urgent = all_urgent && urgency == Urgency::kNow;
        never_run.push_back(std::move(task));
      });
  const auto alone = Create(true);
  for (int frame = 0; frame < 36; ++frame) {
    const LocalizationResult result = Localize(*localizer, frame);
    const LocalizationResult expected = Localize(*alone, frame);
    ASSERT_EQ(result.state, CameraState::kTracked) << frame;
    ASSERT_EQ(result.world_from_camera->translation,
              expected.world_from_camera->translation)
        << frame;
    ASSERT_EQ(result.covariance, expected.covariance) << frame;
  }
  EXPECT_GE(never_run.size(), 1U);
  EXPECT_TRUE(all_urgent);
  // A thread that comes in the end finds nothing to do.
  for (const auto& task : never_run) task();
}

TEST_F(BackgroundAnchorsTest, AnchorsOnAThreadWithoutWaiting) {
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

TEST_F(BackgroundAnchorsTest, BackgroundWorkIsBounded) {
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

TEST_F(AnchorsInTurnsTest, SearchesGiveWayOnceACameraIsNowhere) {
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
TEST_F(AnchorsInTurnsTest, DroppedTasksDoNotBlockTheFramePath) {
  for (const bool wait_for_anchor : {true, false}) {
    const auto localizer =
        Create(wait_for_anchor, [](Urgency, const std::function<void()>&) {});
    for (int frame = 0; frame < 40; ++frame) {
      const LocalizationResult result = Localize(*localizer, frame);
      if (wait_for_anchor) ExpectNear(result, frame);
    }
  }
}

TEST_F(BackgroundAnchorsTest, MayBeDestroyedOrResetWhileItsAnchorRuns) {
  Threads threads;
  for (const bool wait_for_anchor : {false, true}) {
    for (const int last : {0, 7}) {
      auto localizer = Create(wait_for_anchor, threads.Runner());
      for (int frame = 0; frame <= last; ++frame) Localize(*localizer, frame);
      if (last % 2 == 0) localizer->Reset();
      localizer.reset();
    }
  }
  threads.Join();
}

// A sender may change its resolution in mid-stream.
TEST_F(AnchorsInTurnsTest, FramesMayChangeTheirSize) {
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
