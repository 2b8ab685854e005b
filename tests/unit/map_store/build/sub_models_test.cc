// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/sub_models.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "map_store/build/internal/map_filter.h"

namespace groundlock::build::internal {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<std::string> Names(char first, char last) {
  std::vector<std::string> names;
  for (char c = first; c <= last; ++c) names.emplace_back(1, c);
  return names;
}

TEST(ChooseSubModel, TakesTheOneWithMostImagesThenLandmarks) {
  const std::vector<SubModel> models = {{"0", Names('a', 'c'), 900},
                                        {"1", Names('d', 'k'), 100},
                                        {"2", Names('l', 's'), 200},
                                        {"3", Names('l', 's'), 200}};
  EXPECT_EQ(ChooseSubModel(models), 2U);
}

TEST(DescribeGaps, SaysNothingWhenAllHangsTogether) {
  const std::vector<SubModel> models = {{"0", Names('a', 'f'), 10}};
  EXPECT_THAT(DescribeGaps(Names('a', 'f'), models, 0), IsEmpty());
}

TEST(DescribeGaps, NamesStretchesThatFellApartAndImagesWithoutAPlace) {
  const std::vector<SubModel> models = {{"0", Names('f', 'h'), 10},
                                        {"1", Names('a', 'd'), 10}};
  const auto gaps = DescribeGaps(Names('a', 'i'), models, 1);
  EXPECT_THAT(
      gaps,
      ElementsAre(HasSubstr("3 images (f to h)"),
                  HasSubstr("2 images found no place in the map (e, i)")));
}

TEST(DescribeGaps, AnImageInBothModelsIsInTheMap) {
  const std::vector<SubModel> models = {{"0", Names('a', 'd'), 10},
                                        {"1", Names('d', 'e'), 10}};
  const auto gaps = DescribeGaps(Names('a', 'e'), models, 0);
  EXPECT_THAT(gaps, ElementsAre(HasSubstr("1 images (e)")));
}

TEST(DropMisplacedViews, TakesOutTheViewThatItsPartnersDoNotShare) {
  // a, b and c see landmarks 0 to 99; x was verified with a and b, but sees
  // others.
  map::MapData data;
  data.cameras.emplace_back();
  data.landmarks.resize(200);
  for (const char* name : {"a", "b", "c", "x"}) {
    map::MapViewData view;
    view.name = name;
    for (std::uint32_t i = 0; i < 100; ++i) {
      view.landmarks.push_back(view.name == "x" ? 100 + i : i);
      view.keypoints_px.emplace_back(0.0F, 0.0F);
    }
    data.views.push_back(view);
  }
  const std::vector<VerifiedPair> pairs = {{"a", "b", 120},
                                           {"a", "c", 110},
                                           {"b", "c", 100},
                                           {"a", "x", 90},
                                           {"b", "x", 90},
                                           {"x", "gone", 500}};
  EXPECT_THAT(DropMisplacedViews(pairs, &data), ElementsAre("x"));
  EXPECT_EQ(data.views.size(), 3U);
  EXPECT_THAT(DropMisplacedViews(pairs, &data), IsEmpty());
}

}  // namespace
}  // namespace groundlock::build::internal
