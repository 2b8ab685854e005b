// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/given_terrain.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <string>

#include "map_store/map/alignment.h"
#include "map_store/map/map.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::map {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing_map::MakeMapData;

constexpr float kNobodyKnows = std::numeric_limits<float>::quiet_NaN();

GivenTerrain Terrain(const std::function<double(double, double)>& height,
                     double step = 0.5,
                     double half_side = 12.0) {
  GivenTerrain terrain;
  terrain.first = {-half_side, -half_side};
  terrain.step = step;
  const int side = static_cast<int>(std::lround(2.0 * half_side / step)) + 1;
  terrain.columns = static_cast<std::size_t>(side);
  for (int row = 0; row < side; ++row) {
    for (int column = 0; column < side; ++column) {
      terrain.z.push_back(static_cast<float>(
          height(-half_side + step * column, -half_side + step * row)));
    }
  }
  return terrain;
}

double Hills(double x, double y) {
  return 0.8 * std::sin(0.45 * x) * std::cos(0.4 * y);
}

// A metric map whose ground is at z = `height`.
MapData MapAt(double height) {
  MapData data = MakeMapData();
  geometry::Similarity3 up;
  up.translation.z() = height;
  data.Transform(up);
  data.ground = {Eigen::Vector3d::UnitZ(), -height};
  data.in_world = true;
  return data;
}

AlignmentRequest Request(const GivenTerrain& terrain) {
  AlignmentRequest request;
  request.ground = terrain;
  return request;
}

TEST(GivenTerrainTest, TheSplineIsTheTerrain) {
  const GroundRelief relief = ReliefOf(Terrain(Hills), 0.25, 0.05);
  ASSERT_TRUE(relief.Validate().ok()) << relief.Validate();
  double worst = 0.0;
  for (double x = -11.0; x < 11.0; x += 0.37) {
    for (double y = -11.0; y < 11.0; y += 0.41) {
      const auto known = relief.At({x, y});
      ASSERT_TRUE(known) << x << ", " << y;
      worst = std::max(worst, std::abs(known->height + 0.25 - Hills(x, y)));
      EXPECT_NEAR(known->sigma, 0.05, 1e-7);
    }
  }
  // Of waves of 14 m, of 0.8 m, half a metre apart.
  EXPECT_LT(worst, 2e-3);
}

TEST(GivenTerrainTest, AHoleIsAHoleAndBesideItTheGroundHolds) {
  GivenTerrain terrain = Terrain([](double x, double) { return 0.1 * x; });
  const std::size_t hole = 24 * terrain.columns + 24;  // at (0, 0)
  terrain.z[hole] = kNobodyKnows;
  const GroundRelief relief = ReliefOf(terrain, 0.0, 0.05);
  EXPECT_FALSE(relief.At({0.0, 0.0}));
  ASSERT_TRUE(relief.At({0.6, 0.0}));
  EXPECT_NEAR(relief.At({0.6, 0.0})->height, 0.06, 2e-3);
}

TEST(GivenTerrainTest, BecomesTheGroundOfAMap) {
  MapData data = MapAt(0.0);
  // The map's own ground is level, and so is the terrain near it.
  const auto height = [](double x, double y) {
    return std::max(0.0, std::hypot(x, y) - 9.0);
  };
  const auto report = AlignMap(Request(Terrain(height)), data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_THAT(report->warnings, IsEmpty());
  EXPECT_EQ(data.ground_state, GroundState::kMeasured);
  ASSERT_TRUE(report->terrain);
  EXPECT_NEAR(report->terrain->offset, 0.0, 0.01);
  EXPECT_LT(report->terrain->scatter, 0.02);
  EXPECT_GT(report->terrain->num_ground, 250U);
  EXPECT_NEAR(data.given_relief.At({11.0, 0.0})->height, 2.0, 0.02);

  // It stays with the map through a file and back.
  const std::filesystem::path path =
      std::filesystem::path(::testing::TempDir()) / "given_terrain.glmap";
  ASSERT_TRUE(WriteMapFile(data, path).ok());
  const auto map = Map::Open(path);
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE((*map)->info().ground_relief_given);
  EXPECT_NEAR((*map)->ground_relief().At({11.0, 0.0})->height, 2.0, 0.02);
  EXPECT_EQ((*map)->ToData().given_relief.knots.size(),
            data.given_relief.knots.size());
}

TEST(GivenTerrainTest, GoesAlongUntilTheWorldIsTurned) {
  MapData data = MapAt(2.0);
  ASSERT_TRUE(
      AlignMap(Request(Terrain([](double x, double) { return 2.0 + 0.1 * x; })),
               data)
          .ok());
  // z = 0 is the terrain below the middle of the cameras.
  EXPECT_NEAR(data.given_relief.At({5.0, 0.0})->height, 0.5, 1e-3);
  EXPECT_NEAR(data.ground.d, 0.0, 1e-6);
  geometry::Similarity3 aside;
  aside.translation = {1.0, -2.0, 0.5};
  data.Transform(aside);
  EXPECT_NEAR(data.given_relief.At({6.0, -2.0})->height, 0.5, 1e-3);
  geometry::Similarity3 turn;
  turn.rotation = Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ());
  data.Transform(turn);
  EXPECT_TRUE(data.given_relief.empty());
}

TEST(GivenTerrainTest, SaysThatAnAlignmentEndsIt) {
  MapData data = MapAt(0.0);
  ASSERT_TRUE(AlignMap(Request(Terrain(Hills)), data).ok());
  AlignmentRequest request;
  request.method = KnownDistance{
      {Eigen::Vector3d::Zero(), {}}, {Eigen::Vector3d::UnitX(), {}}, 2.0};
  const auto report = AlignMap(request, data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_TRUE(data.given_relief.empty());
  ASSERT_FALSE(report->warnings.empty());
  EXPECT_THAT(report->warnings.back(), HasSubstr("give it again"));
}

TEST(GivenTerrainTest, AWrongDatumIsSaidAndMended) {
  // As a geoid for an ellipsoid: 30 m too low.
  const GivenTerrain low = Terrain([](double, double) { return -30.0; });
  MapData data = MapAt(0.0);
  auto report = AlignMap(Request(low), data);
  ASSERT_TRUE(report.ok()) << report.status();
  ASSERT_FALSE(report->warnings.empty());
  EXPECT_THAT(report->warnings.front(), HasSubstr("30.00 m above the terrain"));
  EXPECT_THAT(report->warnings.front(), HasSubstr("vertical datum"));

  // 30 m too high: nobody stands under the ground.
  data = MapAt(0.0);
  GivenTerrain high = Terrain([](double, double) { return 30.0; });
  const auto refused = AlignMap(Request(high), data);
  EXPECT_TRUE(absl::IsFailedPrecondition(refused.status())) << refused.status();
  EXPECT_THAT(std::string(refused.status().message()),
              HasSubstr("below the ground"));
  EXPECT_EQ(data.views[0].camera_from_world.translation,
            MapAt(0.0).views[0].camera_from_world.translation);

  high.fit_height = true;
  report = AlignMap(Request(high), data);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_NEAR(report->terrain->offset, -30.0, 0.01);
  EXPECT_NEAR(data.given_relief.At({0.0, 0.0})->height +
                  -data.ground.d / data.ground.normal.z(),
              0.0,
              0.02);
}

TEST(GivenTerrainTest, WallsAloneTellNothingOfTheHeight) {
  MapData data = MakeMapData({.num_ground = 0, .num_wall = 600});
  data.in_world = true;
  GivenTerrain terrain = Terrain([](double, double) { return 0.0; });
  EXPECT_FALSE(CompareWithLandmarks(terrain, data));
  const auto report = AlignMap(Request(terrain), data);
  ASSERT_TRUE(report.ok()) << report.status();
  ASSERT_FALSE(report->warnings.empty());
  EXPECT_THAT(report->warnings.front(), HasSubstr("too few landmarks"));
  terrain.fit_height = true;
  EXPECT_TRUE(
      absl::IsFailedPrecondition(AlignMap(Request(terrain), data).status()));
  // A few on the ground among them do.
  data = MakeMapData({.num_ground = 100, .num_wall = 600});
  data.in_world = true;
  EXPECT_TRUE(CompareWithLandmarks(terrain, data));
}

TEST(GivenTerrainTest, RefusesWhatHoldsNoGround) {
  const auto refusal = [](const GivenTerrain& terrain) {
    MapData data = MapAt(0.0);
    const auto report = AlignMap(Request(terrain), data);
    return report.ok() ? std::string() : std::string(report.status().message());
  };
  GivenTerrain terrain = Terrain(Hills);
  terrain.z.pop_back();
  EXPECT_THAT(refusal(terrain), HasSubstr("whole rows"));
  terrain = Terrain(Hills);
  terrain.step = 0.0;
  EXPECT_THAT(refusal(terrain), HasSubstr("step"));
  terrain = Terrain(Hills);
  terrain.z[3] = std::numeric_limits<float>::infinity();
  EXPECT_THAT(refusal(terrain), HasSubstr("infinite"));
  terrain = Terrain(Hills);
  terrain.z.assign(terrain.z.size(), kNobodyKnows);
  EXPECT_THAT(refusal(terrain), HasSubstr("none of its heights"));
  terrain = Terrain(Hills);
  terrain.first.x() += 1'000.0;
  EXPECT_THAT(refusal(terrain), HasSubstr("none of the map's cameras"));
  terrain = Terrain(Hills);
  terrain.sigma = -1.0;
  EXPECT_THAT(refusal(terrain), HasSubstr("sigma"));

  // A map without metres, and a method beside it.
  MapData data = MapAt(0.0);
  data.metric = false;
  EXPECT_THAT(
      std::string(AlignMap(Request(Terrain(Hills)), data).status().message()),
      HasSubstr("no metres"));
  data = MapAt(0.0);
  AlignmentRequest request = Request(Terrain(Hills));
  request.method = SimilarityFromWorld{};
  EXPECT_THAT(std::string(AlignMap(request, data).status().message()),
              HasSubstr("no method"));
}

}  // namespace
}  // namespace groundlock::map
