// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/ground_relief.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "tests/unit/map_store/map/yard_map.h"

namespace groundlock::map {
namespace {

using testing_map::Hills;
using testing_map::Level;
using testing_map::Yard;

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
