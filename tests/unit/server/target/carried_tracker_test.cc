// SPDX-License-Identifier: Apache-2.0
// What a 2D tracker knows goes along as plain data.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "server/target/target_tracker.h"
#include "tests/support/drawn_scene.h"

namespace groundlock::target {
namespace {

using geometry::Box2;
using test_support::Scene;
using test_support::Texture;

using Kept = std::vector<std::unique_ptr<Appearance>>;

std::vector<const Appearance*> PointersTo(const Kept& kept) {
  std::vector<const Appearance*> pointers;
  for (const auto& one : kept) pointers.push_back(one.get());
  return pointers;
}

// A tracker, and the appearances that its user keeps of it.
struct Followed {
  std::unique_ptr<TargetTracker> tracker;
  Kept kept;

  std::string Save() const {
    base::StateWriter writer;
    for (const auto& one : kept) tracker->SaveAppearance(writer, *one);
    tracker->SaveState(writer, PointersTo(kept));
    return writer.bytes();
  }
};

class CarriedTrackerTest : public ::testing::TestWithParam<std::string> {
 protected:
  static constexpr int kFrames = 60;

  // Both sides see the same pictures: with noise each drawing is another one.
  CarriedTrackerTest() {
    for (int frame = 0; frame < kFrames; ++frame) {
      frames_.push_back(Draw(frame));
    }
  }
  static std::unique_ptr<TargetTracker> Make() {
    return *CreateTargetTracker({.name = GetParam()});
  }
  // Nothing where it is refused.
  static Followed Restore(const std::string& bytes, std::size_t kept) {
    Followed followed;
    followed.tracker = Make();
    base::StateReader reader(bytes);
    for (; kept > 0; --kept) {
      followed.kept.push_back(followed.tracker->RestoreAppearance(reader));
    }
    if (reader.ok()) {
      followed.tracker->RestoreState(reader, PointersTo(followed.kept));
    }
    if (!reader.ok() || reader.remaining() > 0) return {};
    return followed;
  }
  const cv::Mat& At(int frame) const { return frames_[frame]; }
  cv::Mat Draw(int frame) const {
    const double x = 100.0 + 2.3 * frame;
    const double y = 100.0 + 10.0 * std::sin(0.2 * frame);
    // Hidden for a while, and something like it there.
    return Scene(
        background_, frame >= 20 && frame < 28 ? other_ : target_, x, y);
  }
  // All that a tracker is asked in a frame, each kind now and then.
  void Step(Followed& followed,
            int frame,
            std::vector<TargetObservation>& results) const {
    TargetTracker& tracker = *followed.tracker;
    const cv::Mat& image = At(frame);
    const bool fixed_size = frame % 5 < 2;
    // The frame brings no look: the last one's box is learnt.
    if (frame % 13 == 12) {
      tracker.Adopt();
      tracker.Learn(image);
      return;
    }
    if (frame % 4 == 1) {
      tracker.Expect({130.0 + 2.3 * frame, 120.0},
                     100.0 * Eigen::Matrix2d::Identity());
    }
    if (frame % 7 == 3) tracker.Recall(PointersTo(followed.kept));
    const auto seen = tracker.Detect(image, fixed_size);
    ASSERT_TRUE(seen.ok()) << seen.status();
    results.push_back(*seen);
    if (const auto growth = fixed_size
                                ? tracker.MeasureGrowth(image, seen->box_px)
                                : std::nullopt) {
      results.push_back({Box2::FromXywh(0, 0, *growth, *growth), *growth});
    }
    if (seen->confidence < 0.5) return;
    if (frame % 3 > 0) tracker.Adopt();
    if (frame % 9 < 6) tracker.Learn(image);
    if (frame % 16 == 5) tracker.Keep(followed.kept.emplace_back());
    if (!followed.kept.empty() && followed.kept.back() == nullptr) {
      followed.kept.pop_back();  // a tracker that keeps none
    }
  }
  Followed Start() const {
    Followed followed{Make(), {}};
    EXPECT_TRUE(
        followed.tracker->Initialize(At(0), Box2::FromXywh(100, 100, 60, 40))
            .ok());
    return followed;
  }

  cv::Mat background_ = Texture(400, 240, 1, 6.0);
  cv::Mat target_ = Texture(60, 40, 2, 3.0);
  cv::Mat other_ = Texture(60, 40, 3, 3.0);
  std::vector<cv::Mat> frames_;
};

TEST_P(CarriedTrackerTest, EveryFrameGoesOnTheSameToTheBit) {
  std::vector<std::string> states;
  std::vector<std::size_t> kept;
  std::vector<std::vector<TargetObservation>> expected(kFrames);
  Followed whole = Start();
  for (int frame = 1; frame < kFrames; ++frame) {
    states.push_back(whole.Save());
    kept.push_back(whole.kept.size());
    Step(whole, frame, expected[frame]);
  }
  for (int cut = 1; cut < kFrames; cut += 2) {
    SCOPED_TRACE(cut);
    Followed moved = Restore(states[cut - 1], kept[cut - 1]);
    ASSERT_NE(moved.tracker, nullptr);
    ASSERT_TRUE(moved.Save() == states[cut - 1]);
    for (int frame = cut; frame < std::min(kFrames, cut + 15); ++frame) {
      SCOPED_TRACE(frame);
      std::vector<TargetObservation> results;
      Step(moved, frame, results);
      ASSERT_EQ(results.size(), expected[frame].size());
      for (std::size_t i = 0; i < results.size(); ++i) {
        const TargetObservation& one = results[i];
        const TargetObservation& other = expected[frame][i];
        ASSERT_EQ(one.box_px.min_px, other.box_px.min_px);
        ASSERT_EQ(one.box_px.max_px, other.box_px.max_px);
        ASSERT_EQ(one.confidence, other.confidence);
        ASSERT_EQ(one.recognition, other.recognition);
      }
      // Nothing else is there that later frames could depend on.
      if (frame + 1 < kFrames) {
        ASSERT_TRUE(moved.Save() == states[frame]);
      }
    }
  }
}

TEST_P(CarriedTrackerTest, BytesOfStrangersAreHarmless) {
  Followed whole = Start();
  std::vector<TargetObservation> results;
  for (int frame = 1; frame < 26; ++frame) Step(whole, frame, results);
  const std::string state = whole.Save();
  const std::size_t kept = whole.kept.size();
  EXPECT_EQ(Restore(state + "x", kept).tracker, nullptr);
  std::mt19937_64 engine(1);
  for (int i = 0; i < 60; ++i) {
    const std::string cut = state.substr(0, engine() % state.size());
    EXPECT_EQ(Restore(cut, kept).tracker, nullptr) << cut.size();
  }
  int accepted = 0;
  for (int i = 0; i < 200; ++i) {
    std::string changed = state;
    // Half of them in the last fields: those before are long lists.
    const std::size_t among = i % 2 == 0 ? changed.size() : 300;
    for (std::uint64_t n = 1 + engine() % 3; n > 0; --n) {
      changed[changed.size() - 1 - engine() % among] =
          static_cast<char>(engine());
    }
    Followed moved = Restore(changed, kept);
    if (moved.tracker == nullptr) continue;
    ++accepted;
    ASSERT_TRUE(moved.Save() == changed);
    for (int frame = 26; frame < 28; ++frame) Step(moved, frame, results);
  }
  // Most bytes are a number's last digits.
  EXPECT_GT(accepted, 20);
  EXPECT_LT(accepted, 200);
}

INSTANTIATE_TEST_SUITE_P(Trackers,
                         CarriedTrackerTest,
                         ::testing::Values("act", "dcf"),
                         [](const auto& tracker) { return tracker.param; });

TEST(CarriedTracker, OpenCvsTrackersKeepTheirStateToThemselves) {
  for (const std::string& name : TargetTrackerNames()) {
    EXPECT_EQ((*CreateTargetTracker({.name = name}))->IsCarried(),
              name == "act" || name == "dcf")
        << name;
  }
}

}  // namespace
}  // namespace groundlock::target
