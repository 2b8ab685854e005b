// SPDX-License-Identifier: Apache-2.0
#include "server/ground/ground_surface.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

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

}  // namespace
}  // namespace groundlock::ground
