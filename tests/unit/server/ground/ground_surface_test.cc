// SPDX-License-Identifier: Apache-2.0
#include "server/ground/ground_surface.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>

namespace groundlock::ground {
namespace {

geometry::Plane TiltedPlane() {
  const Eigen::Vector3d normal = Eigen::Vector3d(0.1, -0.2, 1.0).normalized();
  return {normal, -normal.dot(Eigen::Vector3d(1.0, 2.0, 3.0))};
}

TEST(PlaneSurface, GivesThePlaneEverywhere) {
  const geometry::Plane plane = TiltedPlane();
  const auto surface = MakePlaneSurface(plane);
  for (const Eigen::Vector3d& p :
       {Eigen::Vector3d(0.0, 0.0, 0.0), Eigen::Vector3d(-40.0, 7.0, 90.0)}) {
    const auto patch = surface->At(p);
    ASSERT_TRUE(patch);
    EXPECT_EQ(patch->tangent_world.normal, plane.normal);
    EXPECT_EQ(patch->height_sigma_m, 0.0);
    ASSERT_TRUE(surface->HeightOf(p));
    EXPECT_NEAR(*surface->HeightOf(p), plane.SignedDistance(p), 1e-12);
  }
}

TEST(PlaneSurface, MeetsRaysFromAboveWithinTheRange) {
  const geometry::Plane plane = TiltedPlane();
  const auto surface = MakePlaneSurface(plane);
  const Eigen::Vector3d origin(1.0, 2.0, 13.0);
  const Eigen::Vector3d down(0.3, 0.1, -2.0);
  const auto p = surface->IntersectRay(origin, down, 100.0);
  ASSERT_TRUE(p);
  EXPECT_NEAR(plane.SignedDistance(*p), 0.0, 1e-12);
  EXPECT_NEAR((*p - origin).cross(down).norm(), 0.0, 1e-9);
  EXPECT_FALSE(surface->IntersectRay(origin, down, 5.0));
  EXPECT_FALSE(surface->IntersectRay(origin, -down, 100.0));
  EXPECT_FALSE(
      surface->IntersectRay(Eigen::Vector3d(1.0, 2.0, -13.0), -down, 100.0));
}

// A plane that is turned about a pivot rises in proportion to the way.
TEST(PlaneSurface, HeightIsLessSureFarFromThePivot) {
  PlaneUncertainty uncertainty;
  uncertainty.height_sigma_m = 0.03;
  uncertainty.slope_sigma_rad = 0.002;
  uncertainty.pivot_world = {5.0, 0.0, 0.0};
  const auto surface = MakePlaneSurface({}, uncertainty);
  EXPECT_DOUBLE_EQ(surface->At({5.0, 0.0, 8.0})->height_sigma_m, 0.03);
  EXPECT_DOUBLE_EQ(surface->At({5.0, 20.0, 0.0})->height_sigma_m,
                   std::hypot(0.03, 0.04));
}

// A ridge along y over a tilted plane, known for 0 < x, y < 20 but for a hole.
map::GroundRelief Ridge() {
  map::GroundRelief relief;
  relief.columns = 24;
  relief.origin_plane = {-1.5, -1.5};
  for (int row = 0; row < 24; ++row) {
    for (int column = 0; column < 24; ++column) {
      const double x = column - 1.5;
      const bool hole = column < 6 && row > 17;
      relief.knots.push_back(
          {static_cast<float>(1.2 * std::exp(-0.05 * (x - 10.0) * (x - 10.0))),
           hole ? std::numeric_limits<float>::infinity() : 0.04F});
    }
  }
  return relief;
}

TEST(ReliefSurface, HasTheHeightsOfTheReliefAlongThePlanesNormal) {
  const geometry::Plane plane = TiltedPlane();
  const geometry::PlaneAxes axes(plane);
  const map::GroundRelief relief = Ridge();
  const auto surface = MakeReliefSurface(plane, relief);
  EXPECT_FALSE(surface->IsPlane());
  for (const Eigen::Vector2d& place :
       {Eigen::Vector2d(8.3, 4.0), Eigen::Vector2d(12.0, 15.2)}) {
    const auto known = relief.At(place);
    const Eigen::Vector3d p =
        axes.ToWorld(place) + known->height * plane.normal;
    EXPECT_NEAR(*surface->HeightOf(p), 0.0, 1e-9);
    EXPECT_NEAR(*surface->HeightOf(p + 3.0 * plane.normal), 3.0, 1e-9);
    const auto patch = surface->At(p + 3.0 * plane.normal);
    EXPECT_NEAR(patch->tangent_world.SignedDistance(p), 0.0, 1e-9);
    EXPECT_NEAR(patch->height_sigma_m, 0.04, 1e-7);
    // The tangent is the limit of what joins neighbours.
    constexpr double kStep = 1e-5;
    for (const Eigen::Vector2d& step :
         {Eigen::Vector2d(kStep, 0.0), Eigen::Vector2d(0.0, kStep)}) {
      const Eigen::Vector3d next =
          axes.ToWorld(place + step) +
          relief.At(place + step)->height * plane.normal;
      EXPECT_NEAR(patch->tangent_world.SignedDistance(next) / kStep, 0.0, 1e-4);
    }
  }
}

TEST(ReliefSurface, RaysMeetTheSideThatIsSeen) {
  const geometry::Plane plane = TiltedPlane();
  const geometry::PlaneAxes axes(plane);
  const auto surface = MakeReliefSurface(plane, Ridge());
  const Eigen::Vector3d eye = axes.ToWorld({2.0, 8.0}) + 1.6 * plane.normal;
  // Towards a place behind the ridge: the ridge is before it.
  const Eigen::Vector3d behind = axes.ToWorld({15.0, 8.0});
  const auto met = surface->IntersectRay(eye, behind - eye, 100.0);
  ASSERT_TRUE(met);
  EXPECT_LT(axes.FromWorld(*met).x(), 10.0);
  EXPECT_NEAR(*surface->HeightOf(*met), 0.0, 0.002);
  EXPECT_NEAR(
      (*met - eye).cross((behind - eye).normalized()).norm(), 0.0, 1e-9);
  EXPECT_FALSE(surface->IntersectRay(eye, eye - behind, 100.0));
  EXPECT_FALSE(surface->IntersectRay(eye, behind - eye, 2.0));
  EXPECT_FALSE(surface->IntersectRay(
      axes.ToWorld({2.0, 8.0}) - plane.normal, behind - eye, 100.0));
  // Straight down.
  const auto below = surface->IntersectRay(eye, -plane.normal, 100.0);
  ASSERT_TRUE(below);
  EXPECT_NEAR((eye - *below).norm(), *surface->HeightOf(eye), 0.01);
}

TEST(ReliefSurface, KnowsItsHoles) {
  const geometry::PlaneAxes axes{geometry::Plane()};
  const auto surface = MakeReliefSurface({}, Ridge());
  const Eigen::Vector3d hole = axes.ToWorld({1.0, 19.0});
  EXPECT_FALSE(surface->At(hole));
  EXPECT_FALSE(surface->HeightOf(hole));
  EXPECT_FALSE(surface->IntersectRay(
      hole + 5.0 * Eigen::Vector3d::UnitZ(), -Eigen::Vector3d::UnitZ(), 100.0));
  // Over the hole to the ground beyond it.
  const Eigen::Vector3d eye =
      axes.ToWorld({1.0, 21.0}) + 3.0 * Eigen::Vector3d::UnitZ();
  EXPECT_TRUE(
      surface->IntersectRay(eye, axes.ToWorld({3.0, 8.0}) - eye, 100.0));
}

// Whatever a map file says of its grid, a ray ends: this would be 1e30 steps.
TEST(ReliefSurface, ARayOverATinyOrAFarGridEnds) {
  map::GroundRelief relief = Ridge();
  relief.step = 1e-30;
  const Eigen::Vector3d eye(0.0, 0.0, 5.0);
  EXPECT_FALSE(MakeReliefSurface({}, relief)
                   ->IntersectRay(eye, {1.0, 0.3, -0.01}, 10'000.0));
  relief = Ridge();
  relief.origin_plane = {5'000.0, 0.0};
  const auto met = MakeReliefSurface({}, relief)
                       ->IntersectRay(eye, {5'010.0, 4.0, -4.9}, 10'000.0);
  ASSERT_TRUE(met);
  EXPECT_NEAR(met->x(), 5'010.0, 8.0);
}

}  // namespace
}  // namespace groundlock::ground
