// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/view_coverage.h"

#include <gtest/gtest.h>

#include <set>
#include <vector>

#include "tests/support/rendered_plane_map.h"

namespace groundlock::localization {
namespace {

class ViewCoverageTest : public testing::Test {
 protected:
  // Every landmark where the map's pose projects it.
  std::vector<LandmarkMatch> AllMatches() const {
    std::vector<LandmarkMatch> matches;
    for (std::uint32_t i = 0; i < map_->landmarks().size(); ++i) {
      const auto pixel = place_.camera().ImageFromCamera(
          pose_.Inverse() * map_->landmarks()[i].Position());
      if (pixel && place_.camera().IsInsideImage(*pixel)) {
        matches.push_back({i, *pixel});
      }
    }
    return matches;
  }
  double Coverage(const std::vector<LandmarkMatch>& matches,
                  const std::vector<geometry::Box2>& masks_px = {}) const {
    return ViewCoverage(*map_, place_.camera(), pose_, masks_px, matches, 2);
  }

  test_support::RenderedPlace place_{1};
  std::shared_ptr<const map::Map> map_ = test_support::OpenTemporaryMap(
      MapFromViews(place_, test_support::MappingViews()));
  geometry::Rigid3 pose_ = test_support::LookAlongY({0.3, 0.2, 1.6}, 0.0, 0.0);
};

TEST_F(ViewCoverageTest, EverythingFoundIsOneNothingIsZero) {
  EXPECT_EQ(Coverage(AllMatches()), 1.0);
  EXPECT_EQ(Coverage({}), 0.0);
}

TEST_F(ViewCoverageTest, APartCountsByItsCells) {
  std::vector<LandmarkMatch> left = AllMatches();
  std::erase_if(left, [&](const LandmarkMatch& match) {
    return match.pixel_px.x() > place_.camera().width_px() / 2;
  });
  EXPECT_NEAR(Coverage(left), 0.5, 0.15);  // cells are not all in use
  // One match in each cell is found, but not firmly.
  std::set<std::pair<int, int>> cells;
  std::vector<LandmarkMatch> single;
  for (const LandmarkMatch& match : AllMatches()) {
    if (cells
            .emplace(static_cast<int>(match.pixel_px.x() / 80.0),
                     static_cast<int>(match.pixel_px.y() / 60.0))
            .second) {
      single.push_back(match);
    }
  }
  EXPECT_GE(Coverage(single), 0.5);
  EXPECT_LT(Coverage(single), 1.0);
}

TEST_F(ViewCoverageTest, NothingIsExpectedBehindAMask) {
  std::vector<LandmarkMatch> left = AllMatches();
  std::erase_if(left, [&](const LandmarkMatch& match) {
    return match.pixel_px.x() > 320.0;
  });
  EXPECT_EQ(Coverage(left, {geometry::Box2::FromXywh(320.0, 0.0, 400, 400)}),
            1.0);
  EXPECT_EQ(Coverage(left, {geometry::Box2::FromXywh(-1, -1, 700, 400)}), 0.0);
}

}  // namespace
}  // namespace groundlock::localization
