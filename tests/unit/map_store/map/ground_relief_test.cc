// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/ground_relief.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <vector>

namespace groundlock::map {
namespace {

constexpr double kHalfSide_m = 12.0;
constexpr double kNoise_m = 0.01;

double Hills(double x, double y) {
  return 0.7 * std::sin(0.4 * x + 0.3) * std::cos(0.35 * y - 0.8);
}
double Level(double, double) { return 0.0; }

// Landmarks on the ground, on the walls around it and on a block that stands in
// the middle, seen by cameras at a man's height.
MapData Yard(const std::function<double(double, double)>& height_m) {
  constexpr std::array<double, 3> kParams = {900.0, 640.0, 360.0};
  MapData data;
  data.cameras.push_back(*geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, 1280, 720, kParams));
  data.in_world = true;
  data.metric = true;
  std::mt19937_64 random(5);
  const auto unit = [&] {
    return 2.0 * static_cast<double>(random() >> 11U) * 0x1.0p-53 - 1.0;
  };
  const auto add = [&](double x, double y, double above_m) {
    data.landmarks.push_back(
        {{x, y, height_m(x, y) + above_m + kNoise_m * unit()}, {}, 0.0F});
  };
  for (int i = 0; i < 4'000; ++i) {
    const double x = kHalfSide_m * unit();
    const double y = kHalfSide_m * unit();
    if (std::max(std::abs(x), std::abs(y)) > 1.0) add(x, y, 0.0);
  }
  for (int i = 0; i < 1'500; ++i) {  // walls
    const double along = kHalfSide_m * unit();
    const double above_m = 2.0 + 2.0 * unit();
    const double side = i % 2 == 0 ? kHalfSide_m : -kHalfSide_m;
    if (i % 4 < 2) {
      add(along, side, above_m);
    } else {
      add(side, along, above_m);
    }
  }
  for (int i = 0; i < 300; ++i) add(unit(), unit(), 1.2);  // the block's top
  for (int view = 0; view < 4; ++view) {
    const Eigen::Vector3d eye(view % 2 == 0 ? 5.0 : -5.0,
                              view < 2 ? 5.0 : -5.0,
                              1.6 + height_m(5.0, 5.0));
    MapViewData& seen = data.views.emplace_back();
    seen.name = std::to_string(view);
    seen.camera_from_world =
        geometry::Rigid3{Eigen::Quaterniond::Identity(), eye}.Inverse();
    for (std::size_t i = 0; i < data.landmarks.size(); ++i) {
      seen.keypoints_px.emplace_back(1.0F, 1.0F);
      seen.landmarks.push_back(static_cast<std::uint32_t>(i));
    }
  }
  return data;
}

TEST(GroundRelief, FollowsHillsAndNotWhatStandsOnThem) {
  const GroundRelief relief = EstimateGroundRelief(Yard(Hills));
  ASSERT_FALSE(relief.empty());
  ASSERT_TRUE(relief.Validate().ok());
  std::vector<double> errors_m;
  std::vector<double> slope_errors;
  for (double y = -10.0; y <= 10.0; y += 0.5) {
    for (double x = -10.0; x <= 10.0; x += 0.5) {
      const auto known = relief.At({x, y});
      ASSERT_TRUE(known) << x << ' ' << y;
      errors_m.push_back(std::abs(known->height - Hills(x, y)));
      constexpr double kStep_m = 1e-4;
      const Eigen::Vector2d slope(
          (Hills(x + kStep_m, y) - Hills(x - kStep_m, y)) / (2.0 * kStep_m),
          (Hills(x, y + kStep_m) - Hills(x, y - kStep_m)) / (2.0 * kStep_m));
      slope_errors.push_back((known->slope - slope).norm());
    }
  }
  std::sort(errors_m.begin(), errors_m.end());
  std::sort(slope_errors.begin(), slope_errors.end());
  EXPECT_LT(errors_m[errors_m.size() / 2], 0.02);
  EXPECT_LT(errors_m[errors_m.size() * 95 / 100], 0.10);
  EXPECT_LT(slope_errors[slope_errors.size() / 2], 0.03);
  // The block's place is not its top.
  EXPECT_LT(relief.At({0.0, 0.0})->height - Hills(0.0, 0.0), 0.3);
}

TEST(GroundRelief, LevelGroundIsAPlaneWhateverStandsOnIt) {
  EXPECT_TRUE(EstimateGroundRelief(Yard(Level)).empty());
}

TEST(GroundRelief, IsThatOfTheGroundPlane) {
  MapData data = Yard(Hills);
  const GroundRelief relief = EstimateGroundRelief(data);
  data.ground.d = 0.2;  // the plane 20 cm below
  const GroundRelief over_lower = EstimateGroundRelief(data);
  EXPECT_NEAR(over_lower.At({3.0, 4.0})->height - relief.At({3.0, 4.0})->height,
              0.2,
              0.03);
}

TEST(GroundRelief, NothingIsMadeOfNothing) {
  MapData data = Yard(Hills);
  data.ground_state = GroundState::kUnknown;
  EXPECT_TRUE(EstimateGroundRelief(data).empty());
  data.ground_state = GroundState::kMeasured;
  data.landmarks.resize(50);
  for (MapViewData& view : data.views) {
    view.landmarks.resize(50);
    view.keypoints_px.resize(50);
  }
  EXPECT_TRUE(EstimateGroundRelief(data).empty());
  EXPECT_TRUE(EstimateGroundRelief(MapData()).empty());
}

TEST(GroundRelief, KnowsItsHolesAndItsEnd) {
  MapData data = Yard(Hills);
  // Nobody saw the ground of one quarter.
  for (MapLandmarkData& landmark : data.landmarks) {
    if (landmark.p_world.x() > 2.0 && landmark.p_world.y() > 2.0) {
      landmark.p_world.z() += 30.0;
    }
  }
  const GroundRelief relief = EstimateGroundRelief(data);
  ASSERT_FALSE(relief.empty());
  EXPECT_TRUE(relief.At({-5.0, -5.0}));
  EXPECT_FALSE(relief.At({9.0, 9.0}));
  EXPECT_FALSE(relief.At({100.0, 0.0}));
  EXPECT_FALSE(relief.At({std::numeric_limits<double>::quiet_NaN(), 0.0}));
}

TEST(GroundRelief, IsASmoothFunctionOfItsKnots) {
  GroundRelief relief;
  relief.columns = 6;
  relief.step = 2.0;
  relief.origin_plane = {-3.0, 1.0};
  for (int i = 0; i < 30; ++i) {
    relief.knots.push_back({static_cast<float>(0.3 * std::sin(2.1 * i)), 0.1F});
  }
  ASSERT_TRUE(relief.Validate().ok());
  constexpr double kStep = 1e-5;
  for (const Eigen::Vector2d& p :
       {Eigen::Vector2d(0.7, 4.1), Eigen::Vector2d(4.99, 6.0)}) {
    const auto at = relief.At(p);
    ASSERT_TRUE(at);
    for (int axis = 0; axis < 2; ++axis) {
      const Eigen::Vector2d step = kStep * Eigen::Vector2d::Unit(axis);
      EXPECT_NEAR((relief.At(p + step)->height - relief.At(p - step)->height) /
                      (2.0 * kStep),
                  at->slope(axis),
                  1e-5);
    }
  }
}

TEST(GroundRelief, RefusesWhatBelongsToNoGrid) {
  GroundRelief relief;
  relief.columns = 3;
  relief.knots.resize(9);
  EXPECT_TRUE(relief.Validate().ok());
  const auto refuses = [](GroundRelief changed) {
    return changed.Validate().code() == absl::StatusCode::kInvalidArgument;
  };
  GroundRelief changed = relief;
  changed.knots.pop_back();
  EXPECT_TRUE(refuses(changed));
  changed = relief;
  changed.columns = 9;
  EXPECT_TRUE(refuses(changed));
  changed = relief;
  changed.columns = 0;
  EXPECT_TRUE(refuses(changed));
  changed = relief;
  changed.step = -1.0;
  EXPECT_TRUE(refuses(changed));
  changed = relief;
  changed.knots[4].coefficient = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(refuses(changed));
  changed = relief;
  changed.knots[4].sigma = -1.0F;
  EXPECT_TRUE(refuses(changed));
  changed = relief;
  changed.knots.resize(3 * GroundRelief::kMaxKnots);
  EXPECT_TRUE(refuses(changed));
}

}  // namespace
}  // namespace groundlock::map
