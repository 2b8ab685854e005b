// SPDX-License-Identifier: Apache-2.0
// What a session knows of its camera goes along when the session moves.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "server/tracking/tracking_session.h"
#include "tests/unit/server/localization/same_result.h"
#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::tracking {
namespace {

using localization::CameraState;
using ::testing::HasSubstr;

class CarriedCameraTest : public localization::WalkTest {
 protected:
  static constexpr int kCut = 18;
  static constexpr int kFrames = kCut + 100;
  // A target is marked after the cut.
  static constexpr int kMarked = kCut + 30;

  static std::unique_ptr<TrackingSession> CreateSession(
      const std::shared_ptr<const map::Map>& map = map_) {
    SessionOptions options;
    options.localization = LocalizerOptionsOfWalk();
    options.seed = 3;
    auto session = TrackingSession::Create(map, place_->camera(), options);
    EXPECT_TRUE(session.ok()) << session.status();
    return *std::move(session);
  }
  static absl::StatusOr<FrameResult> TryStep(TrackingSession& session,
                                             int frame) {
    // For as long that the camera is held, and then long enough to be lost.
    const bool is_black =
        (frame >= 22 && frame < 26) || (frame >= 70 && frame < 94);
    image::Frame input;
    input.sequence = static_cast<std::uint64_t>(frame);
    input.capture_time = frame * kFrame;
    input.luma = is_black ? Black() : ImageAt(frame);
    return session.ProcessFrame(input, std::nullopt, nullptr);
  }
  static FrameResult Step(TrackingSession& session, int frame) {
    const auto result = TryStep(session, frame);
    EXPECT_TRUE(result.ok()) << result.status();
    return result.ok() ? *result : FrameResult();
  }
  static void ExpectSameTargets(const FrameResult& a, const FrameResult& b) {
    SCOPED_TRACE(a.sequence);
    ASSERT_EQ(a.targets.size(), b.targets.size());
    for (std::size_t i = 0; i < a.targets.size(); ++i) {
      const TargetResult& one = a.targets[i];
      const TargetResult& other = b.targets[i];
      ASSERT_EQ(one.id, other.id);
      ASSERT_EQ(one.state, other.state);
      ASSERT_EQ(one.confidence, other.confidence);
      ASSERT_EQ(one.box_px.has_value(), other.box_px.has_value());
      if (one.box_px) {
        ASSERT_EQ(one.box_px->min_px, other.box_px->min_px);
        ASSERT_EQ(one.box_px->max_px, other.box_px->max_px);
      }
    }
  }
};

TEST_F(CarriedCameraTest, TheNextHundredResultsAreTheSameToTheBit) {
  const auto box_px = geometry::Box2::FromXywh(260.0, 150.0, 80.0, 60.0);
  const auto whole = CreateSession();
  for (int frame = 0; frame < kCut; ++frame) Step(*whole, frame);
  const std::string state = whole->SaveCamera();
  const auto moved = CreateSession();
  ASSERT_TRUE(moved->RestoreCamera(state).ok());
  EXPECT_TRUE(moved->SaveCamera() == state);

  std::vector<CameraState> seen;
  std::size_t targets = 0;
  for (int frame = kCut; frame < kFrames; ++frame) {
    if (frame == kMarked) {
      ASSERT_TRUE(whole->SetTarget("t", box_px, std::nullopt).ok());
      ASSERT_TRUE(moved->SetTarget("t", box_px, std::nullopt).ok());
    }
    const FrameResult a = Step(*whole, frame);
    const FrameResult b = Step(*moved, frame);
    localization::ExpectSame(a.camera, b.camera, frame);
    ExpectSameTargets(a, b);
    if (HasFatalFailure()) return;
    seen.push_back(a.camera.state);
    targets += a.targets.size();
  }
  EXPECT_THAT(seen, ::testing::Contains(CameraState::kTracked));
  EXPECT_THAT(seen, ::testing::Contains(CameraState::kHeld));
  EXPECT_THAT(seen, ::testing::Contains(CameraState::kLost));
  EXPECT_EQ(targets, static_cast<std::size_t>(kFrames - kMarked));
}

// The camera's masks depend on the targets, and they on the camera.
TEST_F(CarriedCameraTest, WithItsTargetsTheNextResultsAreTheSameToTheBit) {
  const auto whole = CreateSession();
  for (int frame = 0; frame < kCut; ++frame) {
    if (frame == 4) {
      ASSERT_TRUE(
          whole
              ->SetTarget("t",
                          geometry::Box2::FromXywh(260.0, 150.0, 80.0, 60.0),
                          std::nullopt)
              .ok());
    }
    Step(*whole, frame);
  }
  const auto targets = whole->SaveTargets();
  ASSERT_TRUE(targets.ok()) << targets.status();
  const auto moved = CreateSession();
  ASSERT_TRUE(moved->RestoreCamera(whole->SaveCamera()).ok());
  const absl::Status restored = moved->RestoreTargets(*targets);
  ASSERT_TRUE(restored.ok()) << restored;
  EXPECT_TRUE(*moved->SaveTargets() == *targets);
  for (int frame = kCut; frame < kCut + 65; ++frame) {
    const FrameResult a = Step(*whole, frame);
    const FrameResult b = Step(*moved, frame);
    localization::ExpectSame(a.camera, b.camera, frame);
    ASSERT_EQ(a.targets.size(), 1U);
    ExpectSameTargets(a, b);
    if (HasFatalFailure()) return;
  }
  EXPECT_TRUE(*moved->SaveTargets() == *whole->SaveTargets());
}

TEST_F(CarriedCameraTest, TimeGoesOn) {
  const auto whole = CreateSession();
  for (int frame = 0; frame < 3; ++frame) Step(*whole, frame);
  const auto moved = CreateSession();
  ASSERT_TRUE(moved->RestoreCamera(whole->SaveCamera()).ok());
  const absl::Status backwards = TryStep(*moved, 1).status();
  EXPECT_EQ(backwards.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(backwards.message()), HasSubstr("before"));
  EXPECT_EQ(Step(*moved, 3).camera.state, CameraState::kTracked);
}

TEST_F(CarriedCameraTest, SaysWhatIsWrongAndLeavesTheSessionAlone) {
  const auto whole = CreateSession();
  for (int frame = 0; frame < 3; ++frame) Step(*whole, frame);
  const std::string state = whole->SaveCamera();
  const auto moved = CreateSession();
  const std::string fresh = moved->SaveCamera();
  const auto code = [&](const std::string& bytes) {
    return moved->RestoreCamera(bytes).code();
  };
  EXPECT_EQ(code(""), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(code(std::string(state.size(), 'x')),
            absl::StatusCode::kInvalidArgument);
  for (const std::size_t length : {9U, 11U, 14U, 21U, 100U}) {
    EXPECT_EQ(code(state.substr(0, length)), absl::StatusCode::kInvalidArgument)
        << length;
  }
  EXPECT_EQ(code(state + "x"), absl::StatusCode::kInvalidArgument);
  std::string changed = state;
  changed[9] = 2;  // the version
  EXPECT_EQ(code(changed), absl::StatusCode::kUnimplemented);
  changed = state;
  changed[11] = 2;  // whether there is a time
  const absl::Status no_time = moved->RestoreCamera(changed);
  EXPECT_EQ(no_time.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(no_time.message()), HasSubstr("last_time"));
  EXPECT_TRUE(moved->SaveCamera() == fresh);

  // A session without a map knows no place, and one that has gone its own way
  // takes in no other one's.
  EXPECT_EQ(CreateSession(nullptr)->RestoreCamera(state).code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(whole->RestoreCamera(state).code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(code(state), absl::StatusCode::kOk);
}

TEST_F(CarriedCameraTest, WithoutAMapOnlyTimeAndHurryAreKnown) {
  const auto whole = CreateSession(nullptr);
  whole->SetHurried(true);
  Step(*whole, 5);
  const std::string state = whole->SaveCamera();
  const auto moved = CreateSession(nullptr);
  ASSERT_TRUE(moved->RestoreCamera(state).ok());
  EXPECT_EQ(moved->SaveCamera(), state);
  EXPECT_FALSE(TryStep(*moved, 4).ok());
}

}  // namespace
}  // namespace groundlock::tracking
