// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/exif.h"

#include <gtest/gtest.h>

#include "tests/unit/map_store/formats/synthetic_map.h"

namespace groundlock::formats {
namespace {

TEST(PhotoPositions, OfADroneFlight) {
  const auto folder = DataFolder() / "caliterra/images";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder;
  const auto photos = ReadPhotoPositions(folder);
  ASSERT_TRUE(photos.ok()) << photos.status();
  ASSERT_EQ(photos->size(), 40U);
  // One flight over one field: all within some hundred metres.
  for (const PhotoPosition& photo : *photos) {
    const Eigen::Vector3d p =
        geometry::WorldFromGeodetic((*photos)[0].position, photo.position);
    EXPECT_LT(p.norm(), 1'000.0) << photo.image;
  }
}

TEST(PhotoPositions, FromText) {
  const auto photos = ParsePhotoPositions(
      "# image,latitude,longitude,height\na, b.jpg,52.5,-13.25,80\n", "g.csv");
  ASSERT_TRUE(photos.ok()) << photos.status();
  ASSERT_EQ(photos->size(), 1U);
  EXPECT_EQ((*photos)[0].image, "a, b.jpg");
  EXPECT_EQ((*photos)[0].position,
            (geometry::GeodeticPosition{52.5, -13.25, 80.0}));
  const auto wrong = ParsePhotoPositions("\na.jpg,95,0,0\n", "g.csv");
  EXPECT_EQ(wrong.status().message(),
            "g.csv:2: latitude_deg: 95 is out of range");
  EXPECT_FALSE(GpsFromExif("\xFF\xD8\xFF\xE1 no").has_value());
}

}  // namespace
}  // namespace groundlock::formats
