// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/body_kind.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "server/ground/ground_model.h"
#include "server/tracking/ground_target.h"

namespace groundlock::tracking {
namespace {

using Eigen::Vector3d;
using geometry::Box2;
using geometry::Box3;

constexpr double kDegree = std::numbers::pi / 180.0;

const geometry::CameraModel& Lens() {
  constexpr std::array<double, 3> kParams = {900.0, 640.0, 360.0};
  static const geometry::CameraModel lens = *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 1280, 720, kParams);
  return lens;
}

// Looks along x, at a place `distance_m` ahead on level ground.
ground::GroundView ViewFrom(double height_m, double distance_m) {
  const Vector3d forward = Vector3d(distance_m, 0.0, -height_m).normalized();
  const Vector3d right = -Vector3d::UnitY();
  Eigen::Matrix3d R;
  R << right, forward.cross(right), forward;
  return {&Lens(), {Eigen::Quaterniond(R), {0.0, 0.0, height_m}}, {}};
}

struct Drawn {
  Box3 body_world;
  double axis_rad = 0.0;
  Box2 box_px;
};

// Bodies about `size_m`, anywhere near the view's middle and turned in any way,
// with boxes drawn about them as people do: each edge off by 2 % of the box.
std::vector<Drawn> Draw(const ground::GroundView& view,
                        double distance_m,
                        const Vector3d& size_m,
                        const Vector3d& log_sigma) {
  // A roof and corners that are not those that a fit takes for granted.
  const ground::BodyShape shape{.plan = 0.75, .roof = 0.65, .clearance = 0.1};
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  std::vector<Drawn> drawn;
  for (int i = 0; i < 100; ++i) {
    Drawn& one = drawn.emplace_back();
    one.axis_rad = std::numbers::pi * uniform(random);
    Vector3d size = size_m;
    for (int k = 0; k < 3; ++k) {
      size[k] *= std::exp(log_sigma[k] * normal(random));
    }
    one.body_world = ground::UprightBox(
        view.ground_world,
        {distance_m, 0.2 * distance_m * uniform(random), 0.0},
        {std::cos(one.axis_rad), std::sin(one.axis_rad), 0.0},
        size);
    one.box_px = *ground::ProjectBodyHull(view, one.body_world, shape);
    const Eigen::Vector2d side_px = one.box_px.size_px();
    for (int k = 0; k < 2; ++k) {
      one.box_px.min_px[k] += 0.02 * side_px[k] * normal(random);
      one.box_px.max_px[k] += 0.02 * side_px[k] * normal(random);
    }
  }
  return drawn;
}

double Median(std::vector<double> values) {
  std::nth_element(
      values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

double AxisError_rad(const Box3& box_world, double axis_rad) {
  const Vector3d axis =
      box_world.world_from_object.rotation * Vector3d::UnitX();
  return std::abs(std::remainder(std::atan2(axis.y(), axis.x()) - axis_rad,
                                 std::numbers::pi));
}

const Vector3d kCar_m(4.4, 1.8, 1.55);
const Vector3d kCarSigma(0.09, 0.06, 0.08);

TEST(BodyKind, SaysHowLargeACarIsAndHowItMayStand) {
  for (const auto& [height_m, distance_m] :
       {std::pair{1.65, 8.0}, std::pair{8.0, 30.0}, std::pair{30.0, 90.0}}) {
    const ground::GroundView view = ViewFrom(height_m, distance_m);
    std::vector<double> length, width, off_rad;
    double normalized2 = 0.0;
    for (const Drawn& one : Draw(view, distance_m, kCar_m, kCarSigma)) {
      const auto found = FitLikelyKind(view, one.box_px);
      if (!found) continue;
      EXPECT_EQ(found->kind.name, "car");
      const Vector3d ratio =
          found->fit.box.size_m.cwiseQuotient(one.body_world.size_m);
      length.push_back(ratio.x());
      width.push_back(ratio.y());
      off_rad.push_back(AxisError_rad(found->fit.box, one.axis_rad));
      normalized2 += std::pow(
          off_rad.back() / std::hypot(found->axis_sigma_rad, 4.0 * kDegree), 2);
    }
    ASSERT_GE(length.size(), 85u) << height_m << " m";
    EXPECT_NEAR(Median(length), 1.0, 0.05) << height_m << " m";
    EXPECT_NEAR(Median(width), 1.0, 0.05) << height_m << " m";
    EXPECT_LT(Median(off_rad), 20.0 * kDegree) << height_m << " m";
    // It does not take itself for surer than it is.
    EXPECT_LT(normalized2 / static_cast<double>(off_rad.size()), 2.0)
        << height_m << " m";
  }
}

TEST(BodyKind, TellsAPersonFromACar) {
  const ground::GroundView view = ViewFrom(3.0, 12.0);
  int people = 0;
  for (const Drawn& one :
       Draw(view, 12.0, {0.6, 0.55, 1.75}, {0.1, 0.1, 0.05})) {
    const auto found = FitLikelyKind(view, one.box_px);
    if (!found) continue;
    EXPECT_EQ(found->kind.name, "person");
    ++people;
  }
  EXPECT_GE(people, 80);
}

TEST(BodyKind, TakesNothingSmallForARoadUser) {
  const ground::GroundView view = ViewFrom(1.65, 8.0);
  for (const Vector3d& size_m : {Vector3d(0.9, 0.5, 0.35),    // a model car
                                 Vector3d(0.4, 0.4, 0.4)}) {  // a crate
    for (const Drawn& one : Draw(view, 8.0, size_m, Vector3d::Zero())) {
      EXPECT_FALSE(FitLikelyKind(view, one.box_px).has_value());
    }
  }
}

TEST(BodyKind, GivesATargetItsBodyWhereLengthsAreMetres) {
  CameraView camera{ViewFrom(8.0, 30.0)};
  const Box2 box_px =
      Draw(camera.view, 30.0, kCar_m, Vector3d::Zero()).front().box_px;
  ASSERT_TRUE(FitLikelyKind(camera.view, box_px).has_value());
  const auto create = [&](const Box2& drawn_px) {
    return *GroundTarget::Create(camera,
                                 drawn_px,
                                 std::chrono::nanoseconds(0),
                                 BoxCenter::kTexture,
                                 motion::MotionOptions());
  };
  EXPECT_EQ(create(box_px).kind(), nullptr);
  camera.metric = true;
  const GroundTarget car = create(box_px);
  ASSERT_NE(car.kind(), nullptr);
  EXPECT_EQ(car.kind()->name, "car");
  EXPECT_NEAR(car.box().size_m.y(), kCar_m.y(), 0.2 * kCar_m.y());
  EXPECT_LT(car.HeadingSigma_rad(), GroundTarget::kAnyHeading_rad);
  // What the image's edge cuts is not as large as it looks.
  const Eigen::Vector2d to_edge(-box_px.min_px.x(), 0.0);
  EXPECT_EQ(create({box_px.min_px + to_edge, box_px.max_px + to_edge}).kind(),
            nullptr);
}

TEST(TargetBody, TellsAKindOrASizeOrNothing) {
  EXPECT_EQ(*KindOf({}), std::nullopt);
  const auto van = *KindOf({.kind = "van"});
  ASSERT_TRUE(van.has_value());
  EXPECT_EQ(van->name, "van");
  EXPECT_FALSE(van->was_measured);
  const auto crate = *KindOf({.kind = "", .size_m = Vector3d(1.2, 0.8, 1.0)});
  ASSERT_TRUE(crate.has_value());
  EXPECT_TRUE(crate->name.empty());
  EXPECT_TRUE(crate->was_measured);
  const auto long_car = *KindOf({.kind = "car", .size_m = Vector3d(6, 2, 1.5)});
  ASSERT_TRUE(long_car.has_value());
  EXPECT_EQ(long_car->name, "car");
  EXPECT_EQ(long_car->size_m.x(), 6.0);
}

TEST(TargetBody, RefusesWhatIsNoBody) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const auto refusal = [](const TargetBody& told) {
    return std::string(KindOf(told).status().message());
  };
  EXPECT_THAT(refusal({.kind = "tank"}),
              testing::AllOf(testing::HasSubstr("body.kind: 'tank'"),
                             testing::HasSubstr("car, van")));
  for (const double bad : {0.0, -1.0, kNan, kInfinity, 1'000.0}) {
    EXPECT_THAT(refusal({.kind = "", .size_m = Vector3d(4.0, bad, 1.0)}),
                testing::HasSubstr("body.size_m.y"))
        << bad;
  }
  EXPECT_THAT(refusal({.kind = "", .size_m = Vector3d(101.0, 1.0, 1.0)}),
              testing::HasSubstr("body.size_m: 101 x 1 x 1"));
}

// A limousine is 45 % longer than cars are, and lower for its footprint.
const Vector3d kLimousine_m(6.5, 1.9, 1.4);

TEST(TargetBody, GivesTheSizeThatWasTold) {
  CameraView camera{ViewFrom(8.0, 30.0)};
  camera.metric = true;
  const auto told = *KindOf({.kind = "car", .size_m = kLimousine_m});
  const auto error = [&](const Drawn& one,
                         const std::optional<BodyKind>& kind) {
    const auto target = GroundTarget::Create(camera,
                                             one.box_px,
                                             std::chrono::nanoseconds(0),
                                             BoxCenter::kTexture,
                                             motion::MotionOptions(),
                                             kind);
    return (target->box().size_m - kLimousine_m)
        .cwiseQuotient(kLimousine_m)
        .cwiseAbs()
        .maxCoeff();
  };
  std::vector<double> with, without;
  for (const Drawn& one :
       Draw(camera.view, 30.0, kLimousine_m, Vector3d::Zero())) {
    with.push_back(error(one, told));
    without.push_back(error(one, std::nullopt));
  }
  EXPECT_LT(*std::max_element(with.begin(), with.end()), 0.12);
  EXPECT_GT(Median(without), 0.25);
}

// Once its way tells the heading, the drawn box is fitted anew: that leaves the
// size open, and what was told still holds.
TEST(TargetBody, StaysWhenItDrivesOff) {
  CameraView camera{ViewFrom(8.0, 30.0)};
  for (const bool metric : {true, false}) {
    // Lengths that were told are of the map's unit, whatever that is.
    camera.metric = metric;
    const auto told = *KindOf({.kind = "", .size_m = kLimousine_m});
    const auto body_at = [&](double y_m) {
      return ground::UprightBox(camera.view.ground_world,
                                {30.0, y_m, 0.0},
                                Vector3d::UnitY(),
                                kLimousine_m);
    };
    const auto box_px = [&](double y_m) {
      return *ground::ProjectBodyHull(camera.view, body_at(y_m));
    };
    auto target = *GroundTarget::Create(camera,
                                        box_px(-6.0),
                                        std::chrono::nanoseconds(0),
                                        BoxCenter::kTexture,
                                        motion::MotionOptions(),
                                        told);
    for (int i = 1; i <= 40; ++i) {
      target.Predict(std::chrono::milliseconds(100 * i));
      const auto sighting = target.Lift(camera, box_px(-6.0 + 0.3 * i));
      ASSERT_TRUE(sighting.has_value()) << i;
      target.Update(camera, *sighting);
    }
    ASSERT_TRUE(target.heading_known());
    const Box3 box = target.box();
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(box.size_m[k], kLimousine_m[k], 0.1 * kLimousine_m[k]) << k;
    }
    EXPECT_LT(AxisError_rad(box, std::numbers::pi / 2), 5.0 * kDegree);
  }
}

// Without metres a kind tells proportions.
TEST(TargetBody, TellsProportionsInMapUnits) {
  constexpr double kUnits = 0.2;  // to a metre
  const ground::GroundView view = ViewFrom(kUnits * 8.0, kUnits * 30.0);
  const auto bus = *KindOf({.kind = "bus"});
  std::vector<double> length_over_width, length;
  for (const Drawn& one : Draw(view,
                               kUnits * 30.0,
                               kUnits * Vector3d(12.0, 2.9, 3.3),
                               Vector3d::Zero())) {
    const auto found = FitKind(view, one.box_px, *bus, /*metric=*/false);
    ASSERT_TRUE(found.has_value());
    const Vector3d& size = found->fit.box.size_m;
    length_over_width.push_back(size.x() / size.y());
    length.push_back(size.x() / kUnits);
  }
  EXPECT_NEAR(Median(length_over_width), 12.0 / 2.9, 0.1 * 12.0 / 2.9);
  EXPECT_NEAR(Median(length), 12.0, 0.15 * 12.0);
}

TEST(BodyKind, IsABoatOnlyIfThatIsTold) {
  CameraView camera{ViewFrom(8.0, 30.0)};
  camera.metric = true;
  const Drawn boat =
      Draw(camera.view, 30.0, {6.0, 2.2, 1.5}, Vector3d::Zero()).front();
  const GroundTarget told = *GroundTarget::Create(camera,
                                                  boat.box_px,
                                                  std::chrono::nanoseconds(0),
                                                  BoxCenter::kTexture,
                                                  motion::MotionOptions(),
                                                  *KindOf({.kind = "boat"}));
  ASSERT_NE(told.kind(), nullptr);
  EXPECT_EQ(told.kind()->name, "boat");
  for (const Drawn& one :
       Draw(camera.view, 30.0, {6.0, 2.2, 1.5}, Vector3d::Constant(0.2))) {
    const auto found = FitLikelyKind(camera.view, one.box_px);
    EXPECT_TRUE(!found || found->kind.name != "boat");
  }
}

}  // namespace
}  // namespace groundlock::tracking
