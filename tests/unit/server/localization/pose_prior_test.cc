// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/pose_prior.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "tests/support/rendered_plane_map.h"

namespace groundlock::localization {
namespace {

TEST(PosePrior, ValidatesEveryField) {
  EXPECT_TRUE(PosePrior().Validate().ok());
  PosePrior prior;
  prior.position_world = Eigen::Vector3d(1.0, 2.0, 3.0);
  EXPECT_EQ(prior.Validate().code(), absl::StatusCode::kInvalidArgument);
  prior.position_sigma = 0.5;
  EXPECT_TRUE(prior.Validate().ok());
  EXPECT_FALSE(prior.world_from_camera());
  prior.rotation = Eigen::Quaterniond::Identity();
  EXPECT_EQ(prior.Validate().code(), absl::StatusCode::kInvalidArgument);
  prior.rotation_sigma_rad = 0.1;
  EXPECT_TRUE(prior.Validate().ok());
  ASSERT_TRUE(prior.world_from_camera());
  EXPECT_EQ(prior.world_from_camera()->translation, *prior.position_world);

  PosePrior wrong = prior;
  wrong.geodetic_position = geometry::GeodeticPosition{47.0, 8.0, 400.0};
  EXPECT_FALSE(wrong.Validate().ok());
  wrong = prior;
  wrong.position_world->y() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(wrong.Validate().ok());
  wrong = prior;
  wrong.rotation->w() = 2.0;
  EXPECT_FALSE(wrong.Validate().ok());
  wrong = PosePrior();
  wrong.geodetic_position = geometry::GeodeticPosition{91.0, 8.0, 400.0};
  wrong.position_sigma = 1.0;
  EXPECT_FALSE(wrong.Validate().ok());
}

TEST(PosePrior, ChoosesViewsThatCouldShowTheSame) {
  const test_support::RenderedPlace place(1);
  const auto map = test_support::OpenTemporaryMap(
      MapFromViews(place, test_support::MappingViews()));
  ASSERT_NE(map, nullptr);
  const auto count = [&](const PosePrior& prior) {
    const std::vector<bool> near = ViewsNearPrior(*map, prior);
    EXPECT_EQ(near.size(), map->num_views());
    return std::count(near.begin(), near.end(), true);
  };
  const auto all = static_cast<std::ptrdiff_t>(map->num_views());
  EXPECT_EQ(count({}), all);
  PosePrior prior;
  prior.position_world = map->view(0).center_world;
  prior.position_sigma = 0.01;
  // A handful of views: the nearest eight are all of them.
  EXPECT_EQ(count(prior), std::min<std::ptrdiff_t>(8, all));
  prior.rotation = map->view(0).camera_from_world.rotation.conjugate();
  prior.rotation_sigma_rad = 0.1;
  EXPECT_EQ(count(prior), std::min<std::ptrdiff_t>(8, all));
  // The views look the other way.
  prior.rotation =
      *prior.rotation * geometry::QuaternionFromRotationVector({0.0, 3.0, 0.0});
  EXPECT_EQ(count(prior), 0);
}

TEST(PosePrior, PlacesOnTheEarthNeedAnOrigin) {
  const test_support::RenderedPlace place(1);
  const auto views = test_support::MappingViews();
  map::MapData data = MapFromViews(place, std::span(views).first(2));
  PosePrior prior;
  prior.geodetic_position = geometry::GeodeticPosition{58.0, 15.0, 110.0};
  prior.position_sigma = 2.0;
  const auto without = test_support::OpenTemporaryMap(data);
  EXPECT_EQ(PlaceInWorld(*without, prior).status().code(),
            absl::StatusCode::kFailedPrecondition);

  // A thousandth of a degree to the north, ten metres up: on the ellipsoid
  // there, a meridian's degree is 111.38 km.
  data.origin = geometry::GeodeticPosition{57.999, 15.0, 100.0};
  const auto with = test_support::OpenTemporaryMap(data);
  const auto placed = PlaceInWorld(*with, prior);
  ASSERT_TRUE(placed.ok()) << placed.status();
  ASSERT_TRUE(placed->position_world);
  EXPECT_NEAR(placed->position_world->x(), 0.0, 1e-3);
  EXPECT_NEAR(placed->position_world->y(), 111.38, 0.02);
  EXPECT_NEAR(placed->position_world->z(), 10.0, 2e-3);
}

}  // namespace
}  // namespace groundlock::localization
