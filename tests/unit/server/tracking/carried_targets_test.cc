// SPDX-License-Identifier: Apache-2.0
// What a session knows of its targets goes along when the session moves.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "server/tracking/tracking_session.h"
#include "tests/unit/server/tracking/drawn_session.h"
#include "tests/unit/server/tracking/painted_scene.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using ::testing::HasSubstr;

// What happens to a session's targets, frame by frame.
struct Story {
  std::string name;
  std::function<std::unique_ptr<TrackingSession>()> make;
  std::function<image::Frame(int frame)> draw;
  // Before the frame is processed: targets marked, moved or dropped.
  std::function<void(TrackingSession& session, int frame)> act;
  int frames = 0;
  std::vector<int> cuts = {};
};

// Both halves of what a session knows.
struct Carried {
  std::string camera;
  std::string targets;
};

Carried Save(const TrackingSession& session) {
  auto targets = session.SaveTargets();
  EXPECT_TRUE(targets.ok()) << targets.status();
  return {session.SaveCamera(), targets.ok() ? *std::move(targets) : ""};
}

absl::Status Restore(TrackingSession& session, const Carried& carried) {
  if (auto camera = session.RestoreCamera(carried.camera); !camera.ok()) {
    return camera;
  }
  return session.RestoreTargets(carried.targets);
}

void ExpectSame(const TargetResult& a, const TargetResult& b) {
  ASSERT_EQ(a.id, b.id);
  ASSERT_EQ(a.state, b.state);
  ASSERT_EQ(a.confidence, b.confidence);
  ASSERT_EQ(a.box_px.has_value(), b.box_px.has_value());
  if (a.box_px) {
    ASSERT_EQ(a.box_px->min_px, b.box_px->min_px);
    ASSERT_EQ(a.box_px->max_px, b.box_px->max_px);
  }
  ASSERT_EQ(a.box_world.has_value(), b.box_world.has_value());
  if (a.box_world) {
    ASSERT_EQ(a.box_world->world_from_object.translation,
              b.box_world->world_from_object.translation);
    ASSERT_EQ(a.box_world->world_from_object.rotation.coeffs(),
              b.box_world->world_from_object.rotation.coeffs());
    ASSERT_EQ(a.box_world->size_m, b.box_world->size_m);
  }
  ASSERT_EQ(a.ground_covariance_m2, b.ground_covariance_m2);
  ASSERT_EQ(a.heading_sigma_rad, b.heading_sigma_rad);
  ASSERT_EQ(a.front_known, b.front_known);
  ASSERT_EQ(a.size_covariance_m2, b.size_covariance_m2);
  ASSERT_EQ(a.velocity_world_m_s, b.velocity_world_m_s);
  ASSERT_EQ(a.body_kind, b.body_kind);
  ASSERT_EQ(a.age, b.age);
}

std::vector<TargetResult> Step(TrackingSession& session,
                               const Story& story,
                               const image::Frame& frame) {
  story.act(session, static_cast<int>(frame.sequence));
  std::vector<absl::Status> errors;
  const auto result = session.ProcessFrame(frame, std::nullopt, &errors);
  EXPECT_TRUE(result.ok()) << result.status();
  EXPECT_TRUE(errors.empty());
  return result.ok() ? result->targets : std::vector<TargetResult>();
}

// Tells the story once as a whole and, from each cut, by a session that has
// moved there; all that follow are the same to the bit. Returns the results of
// the whole.
std::vector<std::vector<TargetResult>> TellTwice(const Story& story) {
  std::vector<image::Frame> frames;
  for (int i = 0; i < story.frames; ++i) frames.push_back(story.draw(i));
  const auto whole = story.make();
  std::map<int, Carried> states;
  std::vector<std::vector<TargetResult>> expected;
  for (int i = 0; i < story.frames; ++i) {
    for (const int after : {0, 1, 20}) {
      const auto is_wanted = [&](int cut) { return cut + after == i; };
      if (std::any_of(story.cuts.begin(), story.cuts.end(), is_wanted)) {
        states[i] = Save(*whole);
      }
    }
    expected.push_back(Step(*whole, story, frames[i]));
  }
  const Carried end = Save(*whole);
  for (const int cut : story.cuts) {
    SCOPED_TRACE(story.name + ", cut before frame " + std::to_string(cut));
    const auto moved = story.make();
    const absl::Status restored = Restore(*moved, states[cut]);
    EXPECT_TRUE(restored.ok()) << restored;
    if (!restored.ok()) continue;
    // What was read is what was written.
    EXPECT_TRUE(Save(*moved).targets == states[cut].targets);
    for (int i = cut; i < story.frames; ++i) {
      SCOPED_TRACE(i);
      // Nor has anything gone another way that does not show yet.
      if (i == cut + 1 || i == cut + 20) {
        EXPECT_TRUE(Save(*moved).targets == states[i].targets);
      }
      const auto results = Step(*moved, story, frames[i]);
      EXPECT_EQ(results.size(), expected[i].size());
      for (std::size_t k = 0; k < std::min(results.size(), expected[i].size());
           ++k) {
        ExpectSame(results[k], expected[i][k]);
      }
      if (::testing::Test::HasFailure()) return expected;
    }
    EXPECT_TRUE(Save(*moved).targets == end.targets);
  }
  return expected;
}

// So many frames in which the target was in that state.
int CountOf(const std::vector<std::vector<TargetResult>>& results,
            const std::string& id,
            TargetState state) {
  int count = 0;
  for (const auto& targets : results) {
    for (const TargetResult& target : targets) {
      count += target.id == id && target.state == state ? 1 : 0;
    }
  }
  return count;
}

SessionOptions OptionsWith(const std::string& tracker) {
  SessionOptions options;
  options.tracker.name = tracker;
  options.target_lost_after = std::chrono::milliseconds(400);
  return options;
}

// Two targets before a camera that stands still: one is hidden and comes out
// where nobody expects it, the other one goes past.
Story DrawnStory(const std::string& tracker, bool with_camera) {
  Story story;
  story.name = tracker + (with_camera ? " on the ground" : " in the image");
  story.make = [=] { return MakeSession(with_camera, OptionsWith(tracker)); };
  story.draw = [](int frame) {
    cv::Mat bgr = Background();
    DrawTarget(bgr, TargetBox(2.0 - 0.02 * frame, 9.0));
    const bool hidden = frame >= 40 && frame < 56;
    const double x_m =
        frame < 56 ? -1.5 + 0.03 * frame : 1.6 - 0.03 * (frame - 56);
    if (!hidden) DrawTarget(bgr, TargetBox(x_m));
    return ToFrame(static_cast<std::uint64_t>(frame), bgr);
  };
  story.act = [](TrackingSession& session, int frame) {
    if (frame == 0) {
      EXPECT_TRUE(session.SetTarget("near", TargetBox(-1.5), {}).ok());
      // It starts later than the first cut.
      EXPECT_TRUE(
          session
              .SetTarget(
                  "far", TargetBox(2.0 - 0.02 * 12, 9.0), 12, {.kind = "car"})
              .ok());
    }
    if (frame == 100) {
      EXPECT_TRUE(session.MoveTarget("far", TargetBox(0.0, 9.0)).ok());
    }
  };
  // Before anything; followed; hidden; sought; as something like it is found.
  story.cuts = {0, 8, 41, 50, 57, 58, 59, 60, 70};
  story.frames = 132;
  return story;
}

TEST(CarriedTargets, OnTheGroundTheyGoOnTheSameToTheBit) {
  for (const char* tracker : {"act", "dcf"}) {
    const auto results = TellTwice(DrawnStory(tracker, true));
    if (HasFailure()) return;
    EXPECT_GT(CountOf(results, "near", TargetState::kTracked), 60) << tracker;
    EXPECT_GT(CountOf(results, "near", TargetState::kPredicted), 0) << tracker;
    EXPECT_GT(CountOf(results, "near", TargetState::kLost), 0) << tracker;
    EXPECT_GT(CountOf(results, "far", TargetState::kTracked), 60) << tracker;
  }
}

TEST(CarriedTargets, InTheImageTheyGoOnTheSameToTheBit) {
  for (const char* tracker : {"act", "dcf"}) {
    Story story = DrawnStory(tracker, false);
    story.cuts = {1, 30, 45, 58, 65};
    const auto results = TellTwice(story);
    if (HasFailure()) return;
    EXPECT_GT(CountOf(results, "near", TargetState::kTracked), 60) << tracker;
    EXPECT_GT(CountOf(results, "far", TargetState::kTracked), 60) << tracker;
  }
}

// A camera that flies about a place with a car, which stands, is measured,
// drives off, passes behind a post and turns, and a crate that stays: with
// points of their bodies, silhouettes, patches and views from several sides.
TEST(CarriedTargets, SeenFromAFlyingCameraTheyGoOnTheSameToTheBit) {
  Story story;
  story.name = "flight";
  story.make = [] { return PaintedScene::MakeSession(OptionsWith("dcf")); };
  story.draw = [scene = std::make_shared<PaintedScene>()](int frame) {
    return scene->FrameAt(frame);
  };
  story.act = [](TrackingSession& session, int frame) {
    if (frame > 0) return;
    EXPECT_TRUE(session.SetTarget("car", PaintedScene::CarBox(0), {}).ok());
    EXPECT_TRUE(session.SetTarget("crate", PaintedScene::CrateBox(0), {}).ok());
  };
  story.frames = 225;
  story.cuts = {35, 50, 75, 112, 118, 126, 165};
  const auto results = TellTwice(story);
  EXPECT_GT(CountOf(results, "car", TargetState::kTracked), 120);
  // How soon it is found again behind the post is not asked here.
  EXPECT_GT(CountOf(results, "car", TargetState::kPredicted), 0);
  EXPECT_GT(CountOf(results, "crate", TargetState::kTracked), 120);
}

TEST(CarriedTargets, WithoutAnyThereIsLittleToKnow) {
  const auto fresh = MakeSession(true);
  const auto moved = MakeSession(true);
  EXPECT_TRUE(Restore(*moved, Save(*fresh)).ok());
  EXPECT_TRUE(moved->TargetIds().empty());
  ASSERT_TRUE(fresh->SetTarget("a", TargetBox(0.0), 7).ok());
  const Carried state = Save(*fresh);
  EXPECT_LT(state.targets.size(), 200U);
  ASSERT_TRUE(Restore(*moved, state).ok());
  EXPECT_EQ(moved->TargetIds(), std::vector<std::string>{"a"});
}

TEST(CarriedTargets, TrackersThatKeepTheirStateToThemselvesAreNamed) {
  SessionOptions options;
  options.tracker.name = "mosse";
  const auto session = MakeSession(true, options);
  EXPECT_TRUE(session->SaveTargets().ok());  // as long as it follows none
  ASSERT_TRUE(session->SetTarget("a", TargetBox(0.0), {}).ok());
  ASSERT_TRUE(
      session->ProcessFrame(Draw(0, TargetBox(0.0), false), {}, nullptr).ok());
  const absl::Status status = session->SaveTargets().status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnimplemented);
  EXPECT_THAT(std::string(status.message()), HasSubstr("'mosse'"));
}

class DamagedTargetsTest : public ::testing::Test {
 protected:
  // One is followed, the other one is sought.
  DamagedTargetsTest() {
    const auto whole = MakeSession(true, OptionsWith("dcf"));
    EXPECT_TRUE(whole->SetTarget("a", TargetBox(-1.0), {}).ok());
    EXPECT_TRUE(whole->SetTarget("b", TargetBox(1.5, 8.0), {}).ok());
    EXPECT_TRUE(whole->SetTarget("c", TargetBox(0.5, 8.0), 99).ok());
    for (int i = 0; i < kFrame; ++i) {
      EXPECT_TRUE(whole->ProcessFrame(FrameAt(i), {}, nullptr).ok());
    }
    state_ = Save(*whole);
  }
  static image::Frame FrameAt(int frame) {
    cv::Mat bgr = Background();
    DrawTarget(bgr, TargetBox(-1.0 + 0.03 * frame));
    if (frame < 20) DrawTarget(bgr, TargetBox(1.5, 8.0));
    return ToFrame(static_cast<std::uint64_t>(frame), bgr);
  }
  // A session that has the camera's half.
  static std::unique_ptr<TrackingSession> Fresh(const std::string& camera) {
    auto session = MakeSession(true, OptionsWith("dcf"));
    EXPECT_TRUE(session->RestoreCamera(camera).ok());
    return session;
  }

  static constexpr int kFrame = 32;
  Carried state_;
};

TEST_F(DamagedTargetsTest, AreToldAndLeaveTheSessionAlone) {
  const auto session = Fresh(state_.camera);
  const std::string before = *session->SaveTargets();
  const auto restore = [&](const std::string& bytes) {
    const absl::Status status = session->RestoreTargets(bytes);
    EXPECT_TRUE(*session->SaveTargets() == before);
    return status;
  };
  const std::string& state = state_.targets;
  EXPECT_EQ(restore("").code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(restore(std::string(state.size(), 'x')).code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(restore(state + "x").code(), absl::StatusCode::kInvalidArgument);
  std::string changed = state;
  ++changed[9];  // the version
  EXPECT_EQ(restore(changed).code(), absl::StatusCode::kUnimplemented);
  // "dcf" becomes another one.
  changed = state;
  changed[15] = 'e';
  EXPECT_EQ(restore(changed).code(), absl::StatusCode::kFailedPrecondition);
  // The last frame's time is a later one, or an earlier one than all else is
  // of.
  changed = state;
  changed[25] = 1;
  EXPECT_EQ(restore(changed).code(), absl::StatusCode::kFailedPrecondition);
  changed = state;
  std::fill(changed.begin() + 19, changed.begin() + 27, '\0');
  const absl::Status early = restore(changed);
  EXPECT_EQ(early.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(early.message()), HasSubstr("is to come"));
  const absl::Status cut = restore(state.substr(0, state.size() - 1));
  EXPECT_EQ(cut.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(cut.message()), HasSubstr("search_turns"));
  // Without the camera's half they are of another frame.
  const auto without = MakeSession(true, OptionsWith("dcf"));
  EXPECT_EQ(without->RestoreTargets(state).code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_TRUE(session->RestoreTargets(state).ok());
}

TEST_F(DamagedTargetsTest, ASessionWithTargetsTakesInNoOthers) {
  const auto session = Fresh(state_.camera);
  ASSERT_TRUE(session->SetTarget("mine", TargetBox(0.0), {}).ok());
  EXPECT_EQ(session->RestoreTargets(state_.targets).code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(session->TargetIds(), std::vector<std::string>{"mine"});
}

TEST_F(DamagedTargetsTest, CutAnywhereTheyAreRefused) {
  const auto session = Fresh(state_.camera);
  const std::string& state = state_.targets;
  const std::size_t step = std::max<std::size_t>(1, state.size() / 150);
  for (std::size_t length = 0; length < state.size(); length += step) {
    EXPECT_FALSE(session->RestoreTargets(state.substr(0, length)).ok())
        << length;
  }
  for (std::size_t length = 0; length < 150; ++length) {
    EXPECT_FALSE(session->RestoreTargets(state.substr(0, length)).ok())
        << length;
  }
}

// Whatever the bytes are, they are refused, or the session goes on with them
// and knows the same when it is asked again.
TEST_F(DamagedTargetsTest, BytesOfStrangersAreHarmless) {
  const std::string& state = state_.targets;
  const std::vector<image::Frame> frames = {
      FrameAt(kFrame), FrameAt(kFrame + 1), FrameAt(kFrame + 2)};
  std::mt19937_64 engine(1);
  int accepted = 0;
  constexpr int kTries = 260;
  for (int i = 0; i < kTries; ++i) {
    std::string changed = state;
    for (std::uint64_t n = 1 + engine() % 2; n > 0; --n) {
      // The first half of them beside images and filters: those are long.
      const std::size_t at = i % 2 == 0 ? engine() % state.size()
                                        : state.size() - 1 - engine() % 3'000;
      changed[at] = static_cast<char>(engine());
    }
    const auto session = Fresh(state_.camera);
    if (!session->RestoreTargets(changed).ok()) continue;
    ++accepted;
    const std::string saved = *session->SaveTargets();
    const auto again = Fresh(state_.camera);
    ASSERT_TRUE(again->RestoreTargets(saved).ok());
    ASSERT_TRUE(*again->SaveTargets() == saved);
    for (const image::Frame& frame : frames) {
      EXPECT_TRUE(session->ProcessFrame(frame, {}, nullptr).ok());
    }
  }
  EXPECT_GT(accepted, kTries / 10);
  EXPECT_LT(accepted, kTries);
}

}  // namespace
}  // namespace groundlock::tracking
