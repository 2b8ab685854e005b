// SPDX-License-Identifier: Apache-2.0
// What a build says about its map.
#include "map_store/build/report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::build {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

std::vector<std::string> Weaknesses(const map::MapData& data) {
  BuildReport report;
  for (const map::MapViewData& view : data.views) {
    report.images.push_back({.name = view.name});
  }
  DescribeMap(data, 0, &report);
  EXPECT_EQ(report.num_registered, static_cast<int>(data.views.size()));
  return FindWeaknesses(data, report);
}

TEST(FindWeaknesses, NamesAMapWhoseImagesFitBadly) {
  map::MapData data = map::testing_map::MakeMapData();
  EXPECT_THAT(Weaknesses(data), Not(Contains(HasSubstr("fit together only"))));
  // Each keypoint 1.4 px off.
  for (map::MapViewData& view : data.views) {
    for (std::size_t i = 0; i < view.keypoints_px.size(); ++i) {
      view.keypoints_px[i] +=
          i % 2 == 0 ? Eigen::Vector2f(1, 1) : Eigen::Vector2f(-1, 1);
    }
  }
  EXPECT_THAT(Weaknesses(data),
              Contains(HasSubstr("fit together only to 1.4 px")));
}

TEST(FindWeaknesses, NamesWhereTheCameraOnlyTurned) {
  map::MapData data = map::testing_map::MakeMapData();
  EXPECT_THAT(Weaknesses(data), Not(Contains(HasSubstr("only turned"))));
  const Eigen::Vector3d centre =
      data.views[0].camera_from_world.Inverse().translation;
  geometry::Rigid3 world_from_camera =
      data.views[1].camera_from_world.Inverse();
  world_from_camera.translation = centre;
  data.views[1].camera_from_world = world_from_camera.Inverse();
  EXPECT_THAT(Weaknesses(data),
              Contains(HasSubstr("only turned at 1 place (frame0.jpg to "
                                 "frame1.jpg)")));
}

}  // namespace
}  // namespace groundlock::build
