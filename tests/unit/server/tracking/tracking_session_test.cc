// SPDX-License-Identifier: Apache-2.0
// Control logic with the real 2D tracker on a small drawn scene and a known
// camera.
#include "server/tracking/tracking_session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/ground/ground_surface.h"
#include "server/tracking/search_places.h"
#include "tests/unit/server/tracking/drawn_session.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::CameraModel;
using localization::CameraState;
using std::chrono::milliseconds;

TEST(TrackingSession, KeepsAHiddenTargetOnItsWayAndFindsItAgain) {
  SessionOptions options;
  options.target_lost_after = milliseconds(400);
  const auto session = MakeSession(true, options);
  ASSERT_TRUE(session->SetTarget("car", TargetBox(-1.5), {}).ok());
  TargetState last = TargetState::kLost;
  bool was_lost = false;
  for (std::uint64_t i = 0; i < 70; ++i) {
    const double x_m = -1.5 + 0.04 * static_cast<double>(i);
    const bool hidden = i >= 40 && i < 55;
    const auto result =
        session->ProcessFrame(Draw(i, TargetBox(x_m), hidden), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->targets.size(), 1U);
    const TargetResult& target = result->targets[0];
    ASSERT_TRUE(target.box_world);
    const Eigen::Vector3d p = target.box_world->BottomCenterWorld();
    // A flat drawing of a box 1 m long: within half its length.
    EXPECT_LT((p - Eigen::Vector3d(x_m, 6.0, 0.0)).norm(), 0.5) << i;
    if (hidden && i >= 41) {
      EXPECT_NE(target.state, TargetState::kTracked) << i;
    }
    was_lost = was_lost || target.state == TargetState::kLost;
    last = target.state;
  }
  EXPECT_TRUE(was_lost);  // hidden for 600 ms, lost after 400 ms
  EXPECT_EQ(last, TargetState::kTracked);
}

// A person who stays where he is and sits down on his heels: the ground says
// that he looks as large as before.
TEST(TrackingSession, OfWhatIsNoRigidBodyTheImageTellsTheOutline) {
  const CameraModel camera = TestCamera();
  const Box2 standing_px = *ground::ProjectBodyHull(
      {&camera, KnownCamera::Pose(), {}},
      ground::UprightBox(
          {}, {0.0, 6.0, 0.0}, Eigen::Vector3d::UnitX(), {0.5, 0.5, 1.7}));
  SessionOptions options;
  options.tracker.name = "dcf";  // one that sees how large its target is
  const auto session = MakeSession(true, options);
  ASSERT_TRUE(session->SetTarget("person", standing_px, {}).ok());
  for (std::uint64_t i = 0; i < 60; ++i) {
    const double size =
        std::max(0.6, 1.0 - 0.4 * static_cast<double>(i) / 40.0);
    const Eigen::Vector2d size_px = size * standing_px.size_px();
    const Box2 seen_px =
        Box2::FromXywh(standing_px.center_px().x() - 0.5 * size_px.x(),
                       standing_px.max_px.y() - size_px.y(),
                       size_px.x(),
                       size_px.y());
    const auto result =
        session->ProcessFrame(Draw(i, seen_px, false), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    const TargetResult& target = result->targets[0];
    ASSERT_EQ(target.state, TargetState::kTracked) << i;
    EXPECT_GT(geometry::IntersectionOverUnion(*target.box_px, seen_px), 0.75)
        << i;
  }
}

// A tracker that sees no sizes is told them by the ground: a person comes
// nearer.
TEST(TrackingSession, OfWhatIsNoRigidBodyTheGroundTellsTheSizeToWhoSeesNone) {
  const CameraModel camera = TestCamera();
  const auto person_px = [&camera](double y_m) {
    return *ground::ProjectBodyHull(
        {&camera, KnownCamera::Pose(), {}},
        ground::UprightBox(
            {}, {0.0, y_m, 0.0}, Eigen::Vector3d::UnitX(), {0.5, 0.5, 1.7}));
  };
  SessionOptions options;
  options.tracker.name = "act";
  const auto session = MakeSession(true, options);
  ASSERT_TRUE(session->SetTarget("person", person_px(9.0), {}).ok());
  for (std::uint64_t i = 0; i < 75; ++i) {
    const Box2 seen_px = person_px(9.0 - 0.04 * static_cast<double>(i));
    const auto result =
        session->ProcessFrame(Draw(i, seen_px, false), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    const TargetResult& target = result->targets[0];
    ASSERT_EQ(target.state, TargetState::kTracked) << i;
    EXPECT_GT(geometry::IntersectionOverUnion(*target.box_px, seen_px), 0.7)
        << i;
  }
}

TEST(TrackingSession, WithoutACameraPoseTracksInTheImage) {
  const auto session = MakeSession(false);
  ASSERT_TRUE(session->SetTarget("a", TargetBox(-1.0), 2).ok());
  for (std::uint64_t i = 0; i < 10; ++i) {
    const Box2 box = TargetBox(-1.0 + 0.03 * static_cast<double>(i));
    const auto result = session->ProcessFrame(Draw(i, box, false), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->targets.size(), i < 2 ? 0U : 1U);
    if (i < 3) continue;
    EXPECT_FALSE(result->targets[0].box_world);
    EXPECT_EQ(result->targets[0].state, TargetState::kTracked);
  }
}

// The client names no lens, and the server one for whatever picture comes.
TEST(TrackingSession, WithoutAMapAPictureOfAnotherSizeIsRefused) {
  const std::array<double, 3> params = {250.0, 160.0, 120.0};
  const CameraModel small_camera = *CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 320, 240, params);
  const auto session = MakeSession(false);
  ASSERT_TRUE(session->SetTarget("a", TargetBox(-1.0), 0).ok());
  for (const std::uint64_t i : {0U, 1U, 2U}) {
    ASSERT_TRUE(
        session->ProcessFrame(Draw(i, TargetBox(-1.0), false), {}, nullptr)
            .ok());
  }
  cv::Mat small;
  cv::resize(Background(), small, {320, 240});
  const auto refused =
      session->ProcessFrame(ToFrame(3, small), small_camera, nullptr);
  EXPECT_EQ(refused.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(refused.status().message()),
              ::testing::HasSubstr("is 320x240 px, those before it 640x480"));
  const auto again =
      session->ProcessFrame(Draw(4, TargetBox(-1.0), false), {}, nullptr);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->targets.at(0).state, TargetState::kTracked);
}

// With a map each frame may have a lens of its own.
TEST(TrackingSession, WithAMapAPictureOfAnotherSizeIsTaken) {
  const std::array<double, 3> params = {250.0, 160.0, 120.0};
  const CameraModel small_camera = *CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 320, 240, params);
  const auto session = MakeSession(true);
  ASSERT_TRUE(
      session->ProcessFrame(Draw(0, TargetBox(0), true), {}, nullptr).ok());
  cv::Mat small;
  cv::resize(Background(), small, {320, 240});
  EXPECT_TRUE(
      session->ProcessFrame(ToFrame(1, small), small_camera, nullptr).ok());
}

TEST(TrackingSession, BadInputIsToldAndTheSessionLivesOn) {
  SessionOptions options;
  options.max_targets = 1;
  const auto session = MakeSession(true, options);
  EXPECT_EQ(session->SetTarget("a", Box2::FromXywh(1, 1, 0, 5), {}).code(),
            absl::StatusCode::kInvalidArgument);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(session->SetTarget("a", Box2::FromXywh(nan, 1, 5, 5), {}).code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(session->MoveTarget("a", TargetBox(0)).code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(session->DropTarget("a").code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(session->SetTarget("a", Box2::FromXywh(900, 0, 9, 9), {}).ok());
  EXPECT_EQ(session->SetTarget("b", TargetBox(0), {}).code(),
            absl::StatusCode::kResourceExhausted);
  std::vector<absl::Status> errors;
  ASSERT_TRUE(
      session->ProcessFrame(Draw(5, TargetBox(0), false), {}, &errors).ok());
  ASSERT_EQ(errors.size(), 1U);
  EXPECT_NE(errors[0].message().find("'a'"), absl::string_view::npos);
  EXPECT_TRUE(session->TargetIds().empty());
  // Backwards in time; wrong size; no pixels.
  EXPECT_FALSE(
      session->ProcessFrame(Draw(4, TargetBox(0), false), {}, nullptr).ok());
  image::Frame small = Draw(6, TargetBox(0), false);
  small.luma = small.luma(cv::Rect(0, 0, 64, 48)).clone();
  EXPECT_FALSE(session->ProcessFrame(small, {}, nullptr).ok());
  EXPECT_FALSE(session->ProcessFrame({}, {}, nullptr).ok());
  EXPECT_TRUE(
      session->ProcessFrame(Draw(7, TargetBox(0), false), {}, nullptr).ok());
  options.tracker.name = "crystal ball";
  EXPECT_FALSE(TrackingSession::Create(
                   nullptr, ground::MakePlaneSurface({}), TestCamera(), options)
                   .ok());
}

// While the camera is held or lost, the target is followed in the image; with
// the pose its place on the ground comes back.
TEST(TrackingSession, FollowsInTheImageWhileTheCameraIsHeldOrLost) {
  auto camera = std::make_unique<KnownCamera>();
  camera->held_from = 20;
  camera->lost_from = 30;
  camera->back_from = 40;
  camera->odometry_from = 50;
  const auto session = *TrackingSession::Create(std::move(camera),
                                                ground::MakePlaneSurface({}),
                                                TestCamera(),
                                                SessionOptions{});
  ASSERT_TRUE(session->SetTarget("car", TargetBox(-1.5), {}).ok());
  for (std::uint64_t i = 0; i < 60; ++i) {
    const double x_m = -1.5 + 0.04 * static_cast<double>(i);
    const auto result =
        session->ProcessFrame(Draw(i, TargetBox(x_m), false), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    const TargetResult& target = result->targets.at(0);
    EXPECT_EQ(target.state, TargetState::kTracked) << i;
    ASSERT_TRUE(target.box_px) << i;
    EXPECT_LT((target.box_px->center_px() - TargetBox(x_m).center_px()).norm(),
              20.0)
        << i;
    EXPECT_EQ(target.box_world.has_value(), i < 30 || i >= 40) << i;
    if (i >= 20 && i < 30) {
      EXPECT_EQ(result->camera.state, CameraState::kHeld);
      // The camera may have moved: the ground knows less.
      EXPECT_GT(target.ground_covariance_m2.trace(), 0.0) << i;
    }
    // Beyond the map's end targets keep their boxes.
    if (i >= 50) {
      EXPECT_EQ(result->camera.state, CameraState::kOdometry);
    }
    if (!target.box_world) continue;
    const Eigen::Vector3d p = target.box_world->BottomCenterWorld();
    EXPECT_LT((p - Eigen::Vector3d(x_m, 6.0, 0.0)).norm(), 0.5) << i;
  }
}

TEST(TrackingSession, FollowsSeveralTargetsApart) {
  const auto session = MakeSession(true);
  const auto left = [](std::uint64_t i) {
    return TargetBox(-2.0 + 0.02 * static_cast<double>(i));
  };
  const auto right = [](std::uint64_t i) {
    return TargetBox(2.0 - 0.01 * static_cast<double>(i));
  };
  ASSERT_TRUE(session->SetTarget("left", left(0), {}).ok());
  ASSERT_TRUE(session->SetTarget("right", right(5), 5).ok());
  for (std::uint64_t i = 0; i < 50; ++i) {
    cv::Mat bgr = Background();
    if (i < 20) DrawTarget(bgr, left(i));
    DrawTarget(bgr, right(i));
    const auto result = session->ProcessFrame(ToFrame(i, bgr), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    ASSERT_EQ(result->targets.size(), i < 5 ? 1U : 2U);
    const TargetResult& first = result->targets[0];
    EXPECT_EQ(first.id, "left");
    // Hidden, it must not become the other one.
    EXPECT_EQ(first.state,
              i < 20 ? TargetState::kTracked : TargetState::kPredicted)
        << i;
    if (i < 5) continue;
    EXPECT_EQ(result->targets[1].id, "right");
    EXPECT_EQ(result->targets[1].state, TargetState::kTracked) << i;
    EXPECT_LT(
        (result->targets[1].box_px->center_px() - right(i).center_px()).norm(),
        15.0)
        << i;
  }
  ASSERT_TRUE(session->DropTarget("left").ok());
  EXPECT_EQ(session->TargetIds(), std::vector<std::string>{"right"});
}

TEST(TrackingSession, AMovedTargetIsLookedForThere) {
  for (const bool with_camera : {true, false}) {
    const auto session = MakeSession(with_camera);
    ASSERT_TRUE(session->SetTarget("car", TargetBox(-1.5), {}).ok());
    for (std::uint64_t i = 0; i < 20; ++i) {
      // It jumps, and the user says where to.
      const double x_m = i < 10 ? -1.5 : 1.5;
      if (i == 10) {
        ASSERT_TRUE(session->MoveTarget("car", TargetBox(1.45)).ok());
      }
      const auto result =
          session->ProcessFrame(Draw(i, TargetBox(x_m), false), {}, nullptr);
      ASSERT_TRUE(result.ok()) << result.status();
      const TargetResult& target = result->targets.at(0);
      EXPECT_EQ(target.state, TargetState::kTracked) << i;
      EXPECT_LT(
          (target.box_px->center_px() - TargetBox(x_m).center_px()).norm(),
          15.0)
          << with_camera << i;
      if (!with_camera) continue;
      const Eigen::Vector3d p = target.box_world->BottomCenterWorld();
      EXPECT_LT((p - Eigen::Vector3d(x_m, 6.0, 0.0)).norm(), 0.5) << i;
    }
  }
}

// It vanishes and comes back where nothing predicts it.
TEST(TrackingSession, FindsATargetAnywhereInTheImage) {
  for (const bool with_camera : {true, false}) {
    const auto session = MakeSession(with_camera);
    ASSERT_TRUE(session->SetTarget("car", TargetBox(-1.8), {}).ok());
    int seen_again = -1;
    for (std::uint64_t i = 0; i < 90; ++i) {
      const double x_m = i < 15 ? -1.8 : 2.0;
      const auto result = session->ProcessFrame(
          Draw(i, TargetBox(x_m), i >= 15 && i < 50), {}, nullptr);
      ASSERT_TRUE(result.ok()) << result.status();
      const TargetResult& target = result->targets.at(0);
      if (i >= 17 && i < 50) {
        EXPECT_NE(target.state, TargetState::kTracked) << i;
      }
      if (i >= 50 && seen_again < 0 && target.state == TargetState::kTracked) {
        seen_again = static_cast<int>(i);
        EXPECT_LT(
            (target.box_px->center_px() - TargetBox(x_m).center_px()).norm(),
            20.0);
      }
    }
    // A few places a frame cover the image in time; three frames confirm. With
    // the ground it is looked for all over from frame 65 on. Noise of one grey
    // level moves it by a look, which is two frames: 75 or 77 without a camera.
    EXPECT_GE(seen_again, 50) << with_camera;
    EXPECT_LE(seen_again, with_camera ? 85 : 80) << with_camera;
  }
}

// It drove out of the picture, and stands at its edge: where it was predicted
// most of it is out of view, and there it cannot be looked for.
TEST(TrackingSession, FindsWhatIsPredictedJustBeyondThePicturesEdge) {
  const auto session = MakeSession(/*with_camera=*/true);
  const auto place_m = [](std::uint64_t i) {
    return i < 25 ? -2.6 - 0.06 * static_cast<double>(i) : -3.2;
  };
  ASSERT_TRUE(session->SetTarget("car", TargetBox(-2.6), {}).ok());
  int seen_again = -1;
  for (std::uint64_t i = 0; i < 70; ++i) {
    const Box2 there_px = TargetBox(place_m(i));
    const auto result = session->ProcessFrame(
        Draw(i, there_px, i >= 20 && i < 26), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    const TargetResult& target = result->targets.at(0);
    if (i == 25) {
      ASSERT_TRUE(target.box_px);
      EXPECT_LT(target.box_px->center_px().x(), 0.0);
      EXPECT_GT(target.box_px->max_px.x(), 0.0);
    }
    if (i >= 26 && seen_again < 0 && target.state == TargetState::kTracked) {
      seen_again = static_cast<int>(i);
      EXPECT_LT((target.box_px->center_px() - there_px.center_px()).norm(),
                20.0);
    }
  }
  EXPECT_GE(seen_again, 26);
  EXPECT_LE(seen_again, 34);
}

// It came towards the camera, which it seems to have passed; but it turned
// round unseen.
TEST(TrackingSession, FindsWhatIsPredictedBehindTheCamera) {
  const auto session = MakeSession(/*with_camera=*/true);
  const auto place_m = [](std::uint64_t i) {
    return i < 20 ? 6.0 - 0.12 * static_cast<double>(i) : 6.0;
  };
  ASSERT_TRUE(session->SetTarget("car", TargetBox(0.5), {}).ok());
  int seen_again = -1;
  for (std::uint64_t i = 0; i < 130; ++i) {
    const Box2 there_px = TargetBox(0.5, place_m(i));
    const auto result = session->ProcessFrame(
        Draw(i, there_px, i >= 20 && i < 90), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    const TargetResult& target = result->targets.at(0);
    if (i == 89) {
      ASSERT_TRUE(target.box_world);
      EXPECT_LT(target.box_world->BottomCenterWorld().y(), 0.0);
    }
    if (i >= 90 && seen_again < 0 && target.state == TargetState::kTracked) {
      seen_again = static_cast<int>(i);
      EXPECT_LT((target.box_px->center_px() - there_px.center_px()).norm(),
                20.0);
    }
  }
  EXPECT_GE(seen_again, 90);
}

// The map has a step in the ground that is not there: what drives over it is
// suddenly a metre away, as far as the ground tells.
TEST(TrackingSession, WhatGoesOnInTheImageIsFollowedWhateverTheGroundSays) {
  map::GroundRelief relief;
  relief.columns = 81;
  relief.step = 0.25;
  relief.origin_plane = {-10.0, 0.0};
  for (int row = 0; row < 81; ++row) {
    for (int column = 0; column < 81; ++column) {
      relief.knots.push_back({column < 40 ? 0.0F : 0.35F, 0.005F});
    }
  }
  const auto session =
      *TrackingSession::Create(std::make_unique<KnownCamera>(),
                               ground::MakeReliefSurface({}, relief),
                               TestCamera(),
                               SessionOptions());
  ASSERT_TRUE(session->SetTarget("car", TargetBox(-1.5), {}).ok());
  int unseen = 0;
  for (std::uint64_t i = 0; i < 75; ++i) {
    const Box2 there_px = TargetBox(-1.5 + 0.04 * static_cast<double>(i));
    const auto result =
        session->ProcessFrame(Draw(i, there_px, false), {}, nullptr);
    ASSERT_TRUE(result.ok()) << result.status();
    const TargetResult& target = result->targets.at(0);
    if (target.state != TargetState::kTracked) {
      ++unseen;
      continue;
    }
    EXPECT_LT((target.box_px->center_px() - there_px.center_px()).norm(), 25.0)
        << i;
  }
  // 6 or 12, by the noise in the frames: it is looked for by what moves.
  EXPECT_LE(unseen, 12);
}

// The same while frames wait: by turns in one place, and then in none.
TEST(TrackingSession, AHurriedSessionSearchesLess) {
  for (const int places : {1, 0}) {
    SessionOptions options;
    options.max_hurried_search_places = places;
    const auto session = MakeSession(/*with_camera=*/false, options);
    ASSERT_TRUE(session->SetTarget("car", TargetBox(-1.8), {}).ok());
    session->SetHurried(true);
    int seen_again = -1;
    for (std::uint64_t i = 0; i < 300 && seen_again < 0; ++i) {
      const double x_m = i < 15 ? -1.8 : 2.0;
      const auto result = session->ProcessFrame(
          Draw(i, TargetBox(x_m), i >= 15 && i < 50), {}, nullptr);
      ASSERT_TRUE(result.ok()) << result.status();
      if (i >= 50 && result->targets.at(0).state == TargetState::kTracked) {
        seen_again = static_cast<int>(i);
      }
    }
    if (places == 0) {
      EXPECT_EQ(seen_again, -1);
    } else {
      EXPECT_GT(seen_again, 75) << "as soon as with all places";
    }
  }
}

TEST(SearchOffsets, CoverTheEllipseNearestFirstAndAreBounded) {
  Eigen::Matrix2d covariance;
  covariance << 900.0, 0.0, 0.0, 4.0;
  const auto offsets = SearchOffsets({20.0, 20.0}, covariance);
  ASSERT_FALSE(offsets.empty());
  EXPECT_NEAR(offsets[0].norm(), 20.0, 1e-9);
  for (const Eigen::Vector2d& offset : offsets) {
    EXPECT_LE(std::abs(offset.x()), 61.0);
    EXPECT_DOUBLE_EQ(offset.y(), 0.0);
  }
  EXPECT_LE(SearchOffsets({2.0, 2.0}, 1e12 * covariance).size(),
            static_cast<std::size_t>(kMaxSearchPlaces));
  EXPECT_TRUE(SearchOffsets({0.0, 0.0}, covariance).empty());
}

TEST(ImagePlaces, CoverTheImageAndAreBounded) {
  const auto places = ImagePlaces({100.0, 80.0}, {640.0, 480.0});
  ASSERT_EQ(places.size(), 7U * 6U);
  for (double x = 0.0; x <= 640.0; x += 20.0) {
    for (double y = 0.0; y <= 480.0; y += 20.0) {
      bool near = false;
      for (const Eigen::Vector2d& place : places) {
        near = near || (std::abs(place.x() - x) <= 50.0 &&
                        std::abs(place.y() - y) <= 40.0);
      }
      EXPECT_TRUE(near) << x << "," << y;
    }
  }
  for (const Eigen::Vector2d& step : {Eigen::Vector2d(1.0, 1.0),
                                      Eigen::Vector2d(0.01, 1e6),
                                      Eigen::Vector2d(1e6, 1e-6)}) {
    const auto many = ImagePlaces(step, {8192.0, 4096.0});
    EXPECT_GE(many.size(), 1U);
    EXPECT_LE(many.size(), static_cast<std::size_t>(kMaxImagePlaces));
  }
  EXPECT_TRUE(ImagePlaces({0.0, 1.0}, {640.0, 480.0}).empty());
}

// Above the horizon there is nothing; below it, the lower in the image the
// larger.
TEST(ImagePlaces, AreAsFarApartAsTheTargetLooksLarge) {
  const auto step_at = [](const Eigen::Vector2d& pixel_px) {
    const double below_px = pixel_px.y() - 200.0;
    return below_px < 20.0
               ? std::nullopt
               : std::optional(Eigen::Vector2d(0.8 * below_px, 0.4 * below_px));
  };
  const auto places = ImagePlaces(step_at, {1280.0, 720.0});
  EXPECT_LT(places.size(), 300U);
  // Each pixel is in reach of a place at which it looks about as large.
  for (double y = 260.0; y < 720.0; y += 13.0) {
    for (double x = 5.0; x < 1280.0; x += 13.0) {
      const bool is_covered =
          std::any_of(places.begin(), places.end(), [&](const auto& place) {
            const Eigen::Vector2d step_px = *step_at(place);
            const Eigen::Vector2d off_px = (place - Eigen::Vector2d(x, y));
            return std::abs(off_px.x()) <= 0.51 * step_px.x() &&
                   std::abs(off_px.y()) <= 0.51 * step_px.y();
          });
      EXPECT_TRUE(is_covered) << x << " " << y;
    }
  }
  for (const auto& place : places) EXPECT_GE(place.y(), 220.0);
  // However fine the steps are, and without any.
  const auto fine = [](const Eigen::Vector2d&) {
    return std::optional(Eigen::Vector2d(0.5, 0.5));
  };
  const auto many = ImagePlaces(fine, {8192.0, 4096.0});
  EXPECT_LE(many.size(), static_cast<std::size_t>(kMaxImagePlaces));
  EXPECT_GT(many.size(), 100U);
  const auto none = [](const Eigen::Vector2d&) {
    return std::optional<Eigen::Vector2d>();
  };
  EXPECT_TRUE(ImagePlaces(none, {1280.0, 720.0}).empty());
  const auto zero = [](const Eigen::Vector2d&) {
    return std::optional(Eigen::Vector2d(0.0, 50.0));
  };
  EXPECT_TRUE(ImagePlaces(zero, {1280.0, 720.0}).empty());
  EXPECT_TRUE(ImagePlaces(step_at, {0.0, 720.0}).empty());
}

}  // namespace
}  // namespace groundlock::tracking
