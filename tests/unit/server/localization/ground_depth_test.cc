// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/ground_depth.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "map_store/map/map_data.h"
#include "tests/support/rendered_place_test.h"

namespace groundlock::localization {
namespace {

class GroundDepthTest : public test_support::RenderedPlaceTest {
 protected:
  // The place's map, were its ground as `change` makes it.
  template <typename Change>
  static std::shared_ptr<const map::Map> MapWith(Change change) {
    map::MapData data = map_->ToData();
    change(data);
    return test_support::OpenTemporaryMap(data);
  }
  // Of the pixel `below_px` under the image's middle.
  std::optional<GroundDepth> Depth(const map::Map& map, double below_px) const {
    return DepthOfGround(map,
                         place_->camera(),
                         test_support::LookAlongY({0.0, 0.0, 1.6}, 0.0, 0.0),
                         {320.0, 180.0 + below_px});
  }
};

TEST_F(GroundDepthTest, IsWhereTheRayMeetsThePlane) {
  const auto map = MapWith([](map::MapData& data) {
    data.ground = geometry::Plane();
    data.ground_state = map::GroundState::kMeasured;
  });
  ASSERT_TRUE(map->ground_relief().empty());
  // f = 520 px: 1.6 m below is seen 104 px under the middle at 8 m.
  const auto near = Depth(*map, 104.0);
  ASSERT_TRUE(near);
  EXPECT_NEAR(near->depth, 8.0, 1e-6);
  EXPECT_GT(near->relative_sigma, 0.03);
  EXPECT_LT(near->relative_sigma, 0.1);
  // The flatter the ray, the more a tilt changes.
  const auto far = Depth(*map, 10.4);
  ASSERT_TRUE(far);
  EXPECT_NEAR(far->depth, 80.0, 1e-6);
  EXPECT_GT(far->relative_sigma, 0.4);
  EXPECT_FALSE(Depth(*map, -20.0));
}

TEST_F(GroundDepthTest, IsNotToldWhereNobodyKnows) {
  const auto unknown = MapWith([](map::MapData& data) {
    data.ground = geometry::Plane();
    data.ground_state = map::GroundState::kUnknown;
  });
  EXPECT_FALSE(Depth(*unknown, 104.0));
  // A camera below the ground.
  const auto above = MapWith([](map::MapData& data) {
    data.ground = {Eigen::Vector3d::UnitZ(), -2.0};
    data.ground_state = map::GroundState::kMeasured;
  });
  EXPECT_FALSE(Depth(*above, 104.0));
  EXPECT_FALSE(Depth(*above, -104.0));
}

TEST_F(GroundDepthTest, FollowsTheRelief) {
  // Flat, half a metre above the plane, as far as 12 m around.
  const auto map = MapWith([](map::MapData& data) {
    data.ground = geometry::Plane();
    data.ground_state = map::GroundState::kMeasured;
    data.given_relief.origin_plane = {-12.0, -12.0};
    data.given_relief.step = 4.0;
    data.given_relief.columns = 7;
    data.given_relief.knots.assign(7 * 7, {0.5F, 0.01F});
  });
  ASSERT_NE(map, nullptr);
  ASSERT_FALSE(map->ground_relief().empty());
  const auto known = Depth(*map, 104.0);
  ASSERT_TRUE(known);
  EXPECT_NEAR(known->depth, 5.5, 0.01);
  EXPECT_LT(known->relative_sigma, 0.1);
  // Beyond it a plane is all that is known.
  const auto beyond = Depth(*map, 30.0);
  ASSERT_TRUE(beyond);
  EXPECT_NEAR(beyond->depth, 27.7, 0.1);
  EXPECT_EQ(beyond->relative_sigma, 0.5);
}

}  // namespace
}  // namespace groundlock::localization
