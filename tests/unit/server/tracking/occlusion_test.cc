// SPDX-License-Identifier: Apache-2.0
// What stands before a target: shares of a box, and what the map knows.
#include "server/tracking/occlusion.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <limits>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <span>
#include <string>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/map/map_data.h"
#include "server/ground/box_fit.h"
#include "server/tracking/standing_landmarks.h"
#include "server/tracking/tracking_session.h"
#include "tests/support/drawn_scene.h"
#include "tests/support/perturbation.h"
#include "tests/support/rendered_plane_map.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using geometry::CameraModel;

ExpectedBody BodyAt(double x_m, double y_m, double size_m) {
  ExpectedBody body;
  body.box_world = ground::UprightBox({},
                                      {x_m, y_m, 0.0},
                                      Eigen::Vector3d::UnitX(),
                                      Eigen::Vector3d::Constant(size_m));
  return body;
}

TEST(StandsBefore, TheNearerOfTwoThatAreApart) {
  const Eigen::Vector3d eye(0.0, 0.0, 1.6);
  EXPECT_TRUE(StandsBefore(eye, BodyAt(0, 4, 1), BodyAt(0, 6, 1)));
  EXPECT_FALSE(StandsBefore(eye, BodyAt(0, 6, 1), BodyAt(0, 4, 1)));
  // A rider and what is ridden are one thing.
  EXPECT_FALSE(StandsBefore(eye, BodyAt(0, 5.8, 1), BodyAt(0, 6, 1)));
}

geometry::ConvexPolygon Rectangle(const Box2& box_px) {
  return {{box_px.min_px,
           {box_px.max_px.x(), box_px.min_px.y()},
           box_px.max_px,
           {box_px.min_px.x(), box_px.max_px.y()}}};
}

TEST(BoxCover, CountsWhatOtherBodiesHideOnce) {
  BoxCover cover(Box2::FromXywh(100, 100, 100, 60));
  EXPECT_DOUBLE_EQ(cover.share(), 0.0);
  cover.Add(Rectangle(Box2::FromXywh(300, 100, 100, 60)));
  EXPECT_DOUBLE_EQ(cover.share(), 0.0);
  cover.Add(Rectangle(Box2::FromXywh(150, 0, 200, 200)));
  EXPECT_NEAR(cover.share(), 0.5, 1e-9);
  cover.Add(Rectangle(Box2::FromXywh(150, 0, 200, 200)));
  EXPECT_NEAR(cover.share(), 0.5, 1e-9);
  cover.Add(Rectangle(Box2::FromXywh(0, 0, 300, 130)));
  EXPECT_NEAR(cover.share(), 0.75, 1e-9);
}

// What is hidden in one corner of a box is no part of a body that fills only
// the opposite one.
TEST(BoxCover, WhatIsHiddenOfABodyIsNotThatOfItsBox) {
  BoxCover cover(Box2::FromXywh(100, 100, 100, 60));
  const geometry::ConvexPolygon left{{{100, 100}, {150, 100}, {100, 160}}};
  cover.Add(left);
  const geometry::ConvexPolygon right{{{200, 100}, {200, 160}, {150, 160}}};
  EXPECT_GT(cover.share(), 0.2);
  EXPECT_DOUBLE_EQ(cover.ShareOf(right), 0.0);
  cover.Add(right);
  EXPECT_DOUBLE_EQ(cover.ShareOf(right), 1.0);
  EXPECT_LT(cover.share(), 0.6);
  // Outside the box nothing is known.
  const geometry::ConvexPolygon outside{{{300, 0}, {310, 0}, {310, 10}}};
  EXPECT_DOUBLE_EQ(cover.ShareOf(outside), 0.0);
}

std::vector<FrontPoint> Points(double first_x, double last_x, double range_m) {
  std::vector<FrontPoint> points;
  for (double x = first_x; x <= last_x; x += 15.0) {
    for (double y = 95.0; y <= 165.0; y += 17.0) {
      points.push_back({{x, y}, range_m});
    }
  }
  return points;
}

TEST(BoxCover, ASurfaceHidesWhatLiesBetweenItsPoints) {
  const Box2 box = Box2::FromXywh(100, 100, 100, 60);
  BoxCover right(box);
  right.Add(Points(150, 210, 3.0));
  // And a little beyond: a column of cells.
  EXPECT_NEAR(right.share(), 0.6, 0.05);
  BoxCover all(box);
  all.Add(Points(90, 210, 3.0));
  EXPECT_GE(all.share(), 0.95);
}

// A wall in the right half of what is looked at, and something small before it
// or beside it.
TEST(BoxCover, TellsOfAPartHowMuchOfItIsHidden) {
  BoxCover cover(Box2::FromXywh(100, 100, 100, 60));
  cover.Add(Points(150, 210, 3.0));
  EXPECT_DOUBLE_EQ(cover.ShareOf(Box2::FromXywh(165, 125, 12, 7)), 1.0);
  EXPECT_DOUBLE_EQ(cover.ShareOf(Box2::FromXywh(115, 125, 12, 7)), 0.0);
  EXPECT_NEAR(
      cover.ShareOf(Box2::FromXywh(100, 100, 100, 60)), cover.share(), 1e-12);
  EXPECT_DOUBLE_EQ(cover.ShareOf(Box2::FromXywh(300, 125, 12, 7)), 0.0);
}

TEST(BoxCover, StrayPointsHideNothing) {
  const Box2 box = Box2::FromXywh(100, 100, 100, 60);
  // One, two, and two posts with the target between them.
  const std::vector<FrontPoint> stray = {{{150, 130}, 3.0}, {{155, 132}, 3.0}};
  BoxCover few(box);
  few.Add(std::span(stray).first(1));
  few.Add(stray);
  EXPECT_DOUBLE_EQ(few.share(), 0.0);
  // Near each other in the image alone.
  const std::vector<FrontPoint> deep = {
      {{150, 130}, 2.0}, {{155, 132}, 3.0}, {{152, 135}, 4.5}};
  BoxCover apart(box);
  apart.Add(deep);
  EXPECT_DOUBLE_EQ(apart.share(), 0.0);
  BoxCover posts(box);
  posts.Add(Points(90, 95, 3.0));
  posts.Add(Points(205, 210, 3.0));
  EXPECT_LE(posts.share(), 0.25);
}

TEST(BoxCover, TakesAnyBoxAndAnyNumberOfPoints) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  std::vector<FrontPoint> many(1'000, {{150, 130}, 3.0});
  many[3].pixel_px.setConstant(nan);
  many[4].pixel_px.setConstant(1e300);
  BoxCover cover(Box2::FromXywh(100, 100, 100, 60));
  cover.Add(many);
  EXPECT_GT(cover.share(), 0.0);
  for (const Box2& box : {Box2::FromXywh(0, 0, 0, 0),
                          Box2::FromXywh(5, 5, -3, 8),
                          Box2::FromXywh(nan, 0, 5, 5)}) {
    BoxCover none(box);
    none.Add(many);
    EXPECT_DOUBLE_EQ(none.share(), 0.0);
  }
}

constexpr std::array<double, 3> kPinhole = {500.0, 320.0, 240.0};

CameraModel Camera() {
  return *CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 640, 480, kPinhole);
}

// A wall, 2 m wide and 1.5 m high, at y = 3 m left of the y axis, and ground
// right of it, as views from behind the origin see them.
map::MapData WallMap() {
  map::MapData data;
  data.source_format = "made up";
  data.metric = true;
  data.in_world = true;
  data.cameras.push_back(Camera());
  for (int i = 0; i < 8; ++i) {
    map::MapViewData& view = data.views.emplace_back();
    view.name = "view" + std::to_string(i);
    view.camera_from_world =
        test_support::LookAlongY({0.3 * i - 1.2, -2.0, 1.6}, 0.0, -0.1)
            .Inverse();
  }
  const auto add = [&](const Eigen::Vector3d& p_world) {
    const auto landmark = static_cast<std::uint32_t>(data.landmarks.size());
    data.landmarks.push_back({p_world, {}, 0.0F});
    for (map::MapViewData& view : data.views) {
      const auto pixel =
          data.cameras[0].ImageFromCamera(view.camera_from_world * p_world);
      if (!pixel || !data.cameras[0].IsInsideImage(*pixel)) continue;
      view.keypoints_px.push_back(pixel->cast<float>());
      view.landmarks.push_back(landmark);
    }
  };
  for (int i = 0; i <= 20; ++i) {
    const double x = -2.0 + 0.1 * i;
    for (int k = 0; k <= 15; ++k) add({x, 3.0, 0.1 * k});
    for (int k = 0; k <= 10; ++k) add({x + 2.0, 0.3 * k, 0.0});
  }
  return data;
}

TEST(StandingLandmarks, AreBeforeWhatStandsBehindThem) {
  const auto map = test_support::OpenTemporaryMap(WallMap());
  StandingLandmarks standing(map, 3);
  const CameraModel camera = Camera();
  // Not where a view of the map is.
  const ground::GroundView view{
      &camera, test_support::LookAlongY({0.1, -0.5, 1.6}, 0.0, -0.1), {}};
  standing.Follow(view, 7.0);
  const auto hidden = [&](double x_m, double y_m, double sigma_m) {
    ExpectedBody body = BodyAt(x_m, y_m, 0.8);
    body.outline_px = *ground::ProjectBodyHull(view, body.box_world);
    body.sigma_m = sigma_m;
    BoxCover cover(body.outline_px);
    cover.Add(standing.Before(view, body));
    return cover.share();
  };
  EXPECT_GE(hidden(-1.5, 6.0, 0.1), 0.95);        // behind the wall
  EXPECT_DOUBLE_EQ(hidden(1.5, 6.0, 0.1), 0.0);   // beside it
  EXPECT_DOUBLE_EQ(hidden(-1.0, 2.0, 0.1), 0.0);  // before it
  EXPECT_DOUBLE_EQ(hidden(-1.0, 3.2, 0.1), 0.0);  // at it
  // Nobody knows whether it is behind.
  EXPECT_DOUBLE_EQ(hidden(-1.5, 6.0, 2.0), 0.0);
  const double half = hidden(0.1, 6.0, 0.1);
  EXPECT_GT(half, 0.2);
  EXPECT_LT(half, 0.8);
}

TEST(StandingLandmarks, AFrameReadsABoundedPartOfTheMap) {
  map::MapData data = WallMap();
  const std::size_t wall = data.landmarks.size();
  // What is far away comes first in the file; and a dense cloud near the wall.
  for (std::size_t i = 0; i < 3 * StandingLandmarks::kReadPerFrame; ++i) {
    const double at = 1e-4 * static_cast<double>(i);
    data.landmarks.push_back(
        {{i % 2 == 0 ? 500.0 : -2.0 + at, 3.0, 1.0}, {}, 0.0F});
    for (std::size_t v = 0; v < 3; ++v) {
      data.views[v].keypoints_px.emplace_back(1.0F, 1.0F);
      data.views[v].landmarks.push_back(
          static_cast<std::uint32_t>(data.landmarks.size() - 1));
    }
  }
  std::reverse(data.landmarks.begin(), data.landmarks.end());
  const auto last = static_cast<std::uint32_t>(data.landmarks.size() - 1);
  for (map::MapViewData& view : data.views) {
    for (std::uint32_t& landmark : view.landmarks) landmark = last - landmark;
  }
  ASSERT_GT(wall, 100U);
  const auto map = test_support::OpenTemporaryMap(data);
  StandingLandmarks standing(map, 3);
  const CameraModel camera = Camera();
  const ground::GroundView view{
      &camera, test_support::LookAlongY({0.1, -0.5, 1.6}, 0.0, -0.1), {}};
  ExpectedBody body = BodyAt(-1.5, 6.0, 0.8);
  body.outline_px = *ground::ProjectBodyHull(view, body.box_world);
  std::vector<double> shares;
  for (int frame = 0; frame < 6; ++frame) {
    standing.Follow(view, 7.0);
    const auto points = standing.Before(view, body);
    EXPECT_LE(points.size(), BoxCover::kMaxPoints);
    BoxCover cover(body.outline_px);
    cover.Add(points);
    shares.push_back(cover.share());
  }
  EXPECT_LT(shares[0], 0.9);
  EXPECT_GE(shares[5], 0.9);
}

class FixedCamera : public localization::Localizer {
 public:
  static geometry::Rigid3 Pose() {
    return test_support::LookAlongY({0.1, -0.5, 1.6}, 0.0, -0.1);
  }
  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest&) override {
    localization::LocalizationResult result;
    result.state = localization::CameraState::kTracked;
    result.world_from_camera = Pose();
    return result;
  }
  void Reset() override {}
};

// A target goes behind the wall: a session that has the map is surer of that,
// and earlier; before, and without anything in the way, it says the same.
TEST(TrackingSession, IsLessSureOfWhatTheMapHides) {
  const auto map = test_support::OpenTemporaryMap(WallMap());
  const CameraModel camera = Camera();
  const ground::GroundView view{&camera, FixedCamera::Pose(), {}};
  const auto body = [&](int frame) {
    ExpectedBody expected = BodyAt(1.6 - 0.05 * frame, 6.0, 0.8);
    expected.outline_px = *ground::ProjectBodyHull(view, expected.box_world);
    return expected;
  };
  const auto pixel = [&](const Eigen::Vector3d& p_world) {
    const Eigen::Vector2d p =
        *camera.ImageFromCamera(view.world_from_camera.Inverse() * p_world);
    return cv::Point2d(p.x(), p.y());
  };
  const auto draw = [&](int frame) {
    cv::Mat bgr = test_support::Texture(640, 480, 5, 2.0);
    const Box2 box = body(frame).outline_px;
    cv::rectangle(bgr,
                  cv::Rect2d(box.x(), box.y(), box.width(), box.height()),
                  {30, 30, 220},
                  cv::FILLED);
    cv::rectangle(
        bgr,
        cv::Rect2d(box.x(), box.y(), 0.4 * box.width(), 0.6 * box.height()),
        {230, 60, 20},
        cv::FILLED);
    // The wall.
    cv::rectangle(bgr,
                  cv::Rect2d(pixel({-2.0, 3.0, 1.5}), pixel({0.0, 3.0, 0.0})),
                  cv::Scalar::all(120),
                  cv::FILLED);
    image::Frame result = image::Frame::FromBgr(test_support::Perturbed(bgr));
    result.sequence = static_cast<std::uint64_t>(frame);
    result.capture_time = std::chrono::milliseconds(40 * frame);
    return result;
  };
  SessionOptions options;
  options.tracker.name = "dcf";
  const auto with = *TrackingSession::Create(std::make_unique<FixedCamera>(),
                                             ground::MakePlaneSurface({}),
                                             camera,
                                             options,
                                             map);
  const auto without = *TrackingSession::Create(std::make_unique<FixedCamera>(),
                                                ground::MakePlaneSurface({}),
                                                camera,
                                                options);
  for (auto* session : {with.get(), without.get()}) {
    ASSERT_TRUE(session->SetTarget("car", body(0).outline_px, {}).ok());
  }
  constexpr double kAsGoodAsGone = 0.02;
  double hidden_with = 0.0;
  double hidden_without = 0.0;
  for (int frame = 0; frame < 50; ++frame) {
    const image::Frame drawn = draw(frame);
    const auto a = with->ProcessFrame(drawn, {}, nullptr);
    const auto b = without->ProcessFrame(drawn, {}, nullptr);
    ASSERT_TRUE(a.ok() && b.ok());
    const TargetResult& known = a->targets.at(0);
    const TargetResult& unknown = b->targets.at(0);
    if (frame < 15) {
      EXPECT_EQ(known.state, TargetState::kTracked) << frame;
      EXPECT_DOUBLE_EQ(known.confidence, unknown.confidence) << frame;
    } else if (frame >= 38) {
      EXPECT_EQ(known.state, TargetState::kPredicted) << frame;
      hidden_with += known.confidence;
      hidden_without += unknown.confidence;
    }
  }
  // Where both are as good as gone, neither is any surer than the other.
  EXPECT_LT(hidden_with, std::max(0.5 * hidden_without, 12 * kAsGoodAsGone));
}

// A session that moves takes along what of the map stands about its targets.
TEST(TrackingSession, WhatTheMapHidesGoesAlong) {
  const auto map = test_support::OpenTemporaryMap(WallMap());
  const CameraModel camera = Camera();
  const ground::GroundView view{&camera, FixedCamera::Pose(), {}};
  const auto make = [&] {
    SessionOptions options;
    options.tracker.name = "dcf";
    return *TrackingSession::Create(std::make_unique<FixedCamera>(),
                                    ground::MakePlaneSurface({}),
                                    camera,
                                    options,
                                    map);
  };
  const auto box_px = [&](int frame) {
    return *ground::ProjectBodyHull(
        view, BodyAt(0.8 - 0.04 * frame, 6.0, 0.8).box_world);
  };
  const auto pixel = [&](const Eigen::Vector3d& p_world) {
    const Eigen::Vector2d p =
        *camera.ImageFromCamera(view.world_from_camera.Inverse() * p_world);
    return cv::Point2d(p.x(), p.y());
  };
  const auto draw = [&](int frame) {
    cv::Mat bgr = test_support::Texture(640, 480, 5, 2.0);
    const Box2 box = box_px(frame);
    cv::rectangle(bgr,
                  cv::Rect2d(box.x(), box.y(), box.width(), box.height()),
                  {30, 30, 220},
                  cv::FILLED);
    cv::rectangle(bgr,
                  cv::Rect2d(pixel({-2.0, 3.0, 1.5}), pixel({0.0, 3.0, 0.0})),
                  cv::Scalar::all(120),
                  cv::FILLED);
    image::Frame result = image::Frame::FromBgr(bgr);
    result.sequence = static_cast<std::uint64_t>(frame);
    result.capture_time = std::chrono::milliseconds(40 * frame);
    return result;
  };
  const auto whole = make();
  ASSERT_TRUE(whole->SetTarget("car", box_px(0), {}).ok());
  constexpr int kCut = 12;
  for (int frame = 0; frame < kCut; ++frame) {
    ASSERT_TRUE(whole->ProcessFrame(draw(frame), {}, nullptr).ok());
  }
  const std::string state = *whole->SaveTargets();
  const auto moved = make();
  ASSERT_TRUE(moved->RestoreCamera(whole->SaveCamera()).ok());
  ASSERT_TRUE(moved->RestoreTargets(state).ok());
  EXPECT_TRUE(*moved->SaveTargets() == state);
  int hidden = 0;
  for (int frame = kCut; frame < kCut + 60; ++frame) {
    const image::Frame drawn = draw(frame);
    const auto a = whole->ProcessFrame(drawn, {}, nullptr);
    const auto b = moved->ProcessFrame(drawn, {}, nullptr);
    ASSERT_TRUE(a.ok() && b.ok());
    ASSERT_EQ(a->targets.at(0).state, b->targets.at(0).state) << frame;
    ASSERT_EQ(a->targets.at(0).confidence, b->targets.at(0).confidence)
        << frame;
    hidden += a->targets.at(0).state == TargetState::kTracked ? 0 : 1;
  }
  EXPECT_GT(hidden, 5);
  EXPECT_TRUE(*moved->SaveTargets() == *whole->SaveTargets());
  // A session that asks no map takes it not.
  SessionOptions options;
  options.tracker.name = "dcf";
  const auto other = *TrackingSession::Create(std::make_unique<FixedCamera>(),
                                              ground::MakePlaneSurface({}),
                                              camera,
                                              options);
  ASSERT_TRUE(other->RestoreCamera(moved->SaveCamera()).ok());
  EXPECT_EQ(other->RestoreTargets(state).code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace groundlock::tracking
