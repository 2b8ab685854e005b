// SPDX-License-Identifier: Apache-2.0
// A session's knowledge of its camera, saved and restored elsewhere.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "server/localization/fast_localizer_state.h"
#include "tests/unit/server/localization/same_result.h"
#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::localization {
namespace {

using ::testing::HasSubstr;

class CarriedStateTest : public WalkTest {
 protected:
  // Some seconds of everything: the walk, a moment of nothing, a thing in the
  // way that is masked, one long enough to be lost.
  static LocalizationResult Step(Localizer& localizer, int frame) {
    const bool is_black =
        (frame >= 20 && frame < 24) || (frame >= 60 && frame < 84);
    std::vector<geometry::Box2> masks_px;
    if (frame % 7 < 3) {
      masks_px.push_back(geometry::Box2::FromXywh(200.0, 120.0, 90.0, 60.0));
    }
    return Localize(localizer,
                    is_black ? Black() : ImageAt(frame),
                    frame,
                    std::move(masks_px));
  }
};

TEST_F(CarriedStateTest, TheNextHundredResultsAreTheSameToTheBit) {
  constexpr int kFrames = 136;
  // Before anything; with an anchor under way; held; lost; and in between.
  constexpr int kCuts[] = {0, 3, 17, 22, 31, 36};
  const auto whole = Create();
  std::vector<LocalizationResult> expected;
  std::vector<std::string> states;
  std::vector<CameraState> seen;
  for (int frame = 0; frame < kFrames; ++frame) {
    states.push_back(whole->Save());
    expected.push_back(Step(*whole, frame));
    seen.push_back(expected.back().state);
  }
  EXPECT_THAT(seen, ::testing::Contains(CameraState::kHeld));
  EXPECT_THAT(seen, ::testing::Contains(CameraState::kLost));
  bool had_pending = false;
  for (const int cut : kCuts) {
    const auto state = LoadState(states[cut], *map_, LocalizerOptionsOfWalk());
    ASSERT_TRUE(state.ok()) << state.status();
    had_pending |= state->pending.has_value();
    const auto moved = Create();
    ASSERT_TRUE(moved->Restore(states[cut]).ok());
    // What was read is what was written.
    EXPECT_TRUE(moved->Save() == states[cut]) << cut;
    for (int frame = cut; frame < std::min(cut + 100, kFrames); ++frame) {
      ExpectSame(Step(*moved, frame), expected[frame], frame);
      if (HasFatalFailure()) return;
    }
  }
  EXPECT_TRUE(had_pending);
}

// A live session whose first search takes long: its request goes along, and the
// frames that are kept until it ends.
TEST_F(CarriedStateTest, AnchorsUnderWayAndFramesKeptForThemGoOn) {
  constexpr int kSought = 4;
  constexpr int kCut = 10;
  std::vector<std::function<void()>> waiting;
  const auto source = Create(/*wait_for_anchor=*/false,
                             [&](Urgency, std::function<void()> task) {
                               waiting.push_back(std::move(task));
                             });
  for (int frame = 0; frame <= kSought; ++frame) Localize(*source, frame);
  auto state = LoadState(source->Save(), *map_, LocalizerOptionsOfWalk());
  ASSERT_TRUE(state.ok()) << state.status();
  ASSERT_TRUE(state->pending);
  EXPECT_TRUE(state->pending->is_search);
  FrameBridge& bridge = state->bridge.emplace();
  bridge.Begin(/*before_known=*/true);
  for (int frame = kSought + 1; frame < kCut; ++frame) {
    image::Frame kept;
    kept.sequence = static_cast<std::uint64_t>(frame);
    kept.capture_time = frame * kFrame;
    kept.luma = ImageAt(frame);
    bridge.Add(kept, std::nullopt);
    ++state->frame_index;
  }
  const std::string bytes = SaveState(*state, *map_);
  int searches = 0;
  const BackgroundRunner at_once = [&](Urgency urgency,
                                       const std::function<void()>& task) {
    if (urgency == Urgency::kNow) ++searches;
    task();
  };
  const auto moved = Create(/*wait_for_anchor=*/false, at_once);
  const auto again = Create(/*wait_for_anchor=*/false, at_once);
  ASSERT_TRUE(moved->Restore(bytes).ok());
  ASSERT_TRUE(moved->Save() == bytes);
  ASSERT_TRUE(again->Restore(moved->Save()).ok());
  EXPECT_EQ(searches, 2);
  for (int frame = kCut; frame < kCut + 10; ++frame) {
    const LocalizationResult result = Localize(*moved, frame);
    ExpectNear(result, frame);
    ExpectSame(result, Localize(*again, frame), frame);
    if (HasFatalFailure()) return;
  }
}

TEST_F(CarriedStateTest, GyroscopesSamplesAndBiasGoAlong) {
  const auto rate_at = [](int frame) {
    const auto before = TruthAt(frame - 1).rotation;
    const auto now = TruthAt(frame).rotation;
    const double dt_s = std::chrono::duration<double>(kFrame).count();
    return Eigen::Vector3d(geometry::RotationVector(before.conjugate() * now) /
                               dt_s +
                           Eigen::Vector3d(0.02, -0.03, 0.01));
  };
  LocalizerOptions options = LocalizerOptionsOfWalk();
  options.imu.emplace();
  const auto create = [&] { return *CreateLocalizer("fast", map_, options); };
  const auto step = [&](Localizer& localizer, int frame) {
    image::Frame input;
    input.sequence = static_cast<std::uint64_t>(frame);
    input.capture_time = frame * kFrame;
    input.luma = frame % 11 == 5 ? Black() : ImageAt(frame);
    const std::vector<InertialSample> samples = {
        {frame * kFrame + std::chrono::milliseconds(1),
         rate_at(frame),
         Eigen::Vector3d::Zero()},
        {frame * kFrame + std::chrono::milliseconds(22),
         rate_at(frame),
         Eigen::Vector3d::Zero()}};
    LocalizationRequest request{&input, place_->camera(), {}};
    request.inertial = samples;
    const auto result = localizer.Localize(request);
    EXPECT_TRUE(result.ok()) << result.status();
    return result.ok() ? *result : LocalizationResult();
  };
  const auto whole = create();
  for (int frame = 0; frame < 15; ++frame) step(*whole, frame);
  const std::string state = whole->Save();
  const auto moved = create();
  ASSERT_TRUE(moved->Restore(state).ok());
  EXPECT_TRUE(moved->Save() == state);
  for (int frame = 15; frame < 45; ++frame) {
    ExpectSame(step(*whole, frame), step(*moved, frame), frame);
    if (HasFatalFailure()) return;
  }
  // A session without a gyroscope knows no such state.
  EXPECT_EQ(Create()->Restore(state).code(),
            absl::StatusCode::kInvalidArgument);
}

TEST_F(CarriedStateTest, TheBaselineGoesOnToo) {
  LocalizerOptions options;
  const auto create = [&] {
    return *CreateLocalizer("baseline", map_, options);
  };
  const auto whole = create();
  for (int frame = 0; frame < 2; ++frame) Localize(*whole, frame);
  const std::string state = whole->Save();
  const auto moved = create();
  ASSERT_TRUE(moved->Restore(state).ok());
  EXPECT_TRUE(moved->Save() == state);
  for (int frame = 2; frame < 5; ++frame) {
    const cv::Mat image = frame == 3 ? Black() : ImageAt(frame);
    ExpectSame(
        Localize(*whole, image, frame), Localize(*moved, image, frame), frame);
  }
}

TEST_F(CarriedStateTest, SaysWhatIsWrongAndLeavesTheSessionAlone) {
  const auto localizer = Create();
  for (int frame = 0; frame < 18; ++frame) Localize(*localizer, frame);
  const std::string state = localizer->Save();
  const auto code = [&](const std::string& bytes) {
    return localizer->Restore(bytes).code();
  };
  EXPECT_EQ(code(""), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code("GLCAMERA"), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code(state + "x"), absl::StatusCode::kInvalidArgument);
  std::string changed = state;
  for (const char version : {0, 1, 127}) {
    changed[8] = version;
    EXPECT_EQ(code(changed), absl::StatusCode::kUnimplemented);
  }
  changed = state;
  changed[20] ^= 1;  // the map's hash
  EXPECT_EQ(code(changed), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ((*CreateLocalizer("baseline", map_, {}))->Restore(state).code(),
            absl::StatusCode::kFailedPrecondition);
  // Not a number, where the last turn's first part is: the last field.
  changed = state;
  for (std::size_t i = changed.size() - 32; i < changed.size() - 24; ++i) {
    changed[i] = '\xff';
  }
  const absl::Status refused = localizer->Restore(changed);
  EXPECT_EQ(refused.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("last_turn"));
  EXPECT_TRUE(localizer->Save() == state);
  ExpectNear(Localize(*localizer, 18), 18);
}

// Whatever the bytes are, they are refused or lead nobody outside.
TEST_F(CarriedStateTest, BytesOfStrangersAreHarmless) {
  const auto localizer = Create(
      /*wait_for_anchor=*/false, [](Urgency, const std::function<void()>&) {});
  const auto source = Create();
  for (int frame = 0; frame < 18; ++frame) Localize(*source, frame);
  const std::string state = source->Save();
  ASSERT_TRUE(localizer->Restore(state).ok());
  std::mt19937_64 engine(1);
  for (int i = 0; i < 40; ++i) {
    const std::size_t length = engine() % state.size();
    EXPECT_FALSE(localizer->Restore(state.substr(0, length)).ok()) << length;
  }
  // The fields stand behind the images.
  constexpr std::size_t kFields = 40'000;
  int accepted = 0;
  for (int i = 0; i < 400; ++i) {
    std::string changed = state;
    for (std::uint64_t n = 1 + engine() % 3; n > 0; --n) {
      changed[changed.size() - 1 - engine() % kFields] =
          static_cast<char>(engine());
    }
    if (!localizer->Restore(changed).ok()) continue;
    ++accepted;
    for (int frame = 18; frame < 20; ++frame) {
      image::Frame input;
      input.sequence = static_cast<std::uint64_t>(frame);
      input.capture_time = frame * kFrame;
      input.luma = ImageAt(frame);
      const auto result = localizer->Localize({&input, place_->camera(), {}});
      EXPECT_TRUE(result.ok()) << result.status();
    }
  }
  // Most bytes are a number's last digits.
  EXPECT_GT(accepted, 40);
  EXPECT_LT(accepted, 400);
}

}  // namespace
}  // namespace groundlock::localization
