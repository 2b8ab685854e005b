// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>

#include "map_store/base/status.h"
#include "map_store/terrain/elevation_model.h"

namespace groundlock::terrain {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

// As gdalinfo tells of a file.
json Info(const std::string& wkt) {
  return {{"size", {5, 4}},
          {"coordinateSystem", {{"wkt", wkt}}},
          {"bands", {{{"band", 1}, {"type", "Float32"}}}},
          {"wgs84Extent",
           {{"type", "Polygon"},
            {"coordinates",
             {{{15.0, 58.004},
               {15.0, 58.0},
               {15.005, 58.0},
               {15.005, 58.004},
               {15.0, 58.004}}}}}}};
}

std::string ErrorOf(const json& info) {
  const auto parsed = ParseElevationModelInfo(info.dump());
  return parsed.ok() ? "" : std::string(parsed.status().message());
}

TEST(ElevationModelInfoTest, ReadsSizeAndPlace) {
  const auto info = ParseElevationModelInfo(
      "Warning 1: of a library\n" + Info("GEOGCRS[\"WGS 84\"]").dump() + "\n");
  ASSERT_TRUE(info.ok()) << info.status();
  EXPECT_EQ(info->columns, 5U);
  EXPECT_EQ(info->rows, 4U);
  EXPECT_NEAR(info->window.west_deg, 15.0, 1e-12);
  EXPECT_NEAR(info->window.north_deg, 58.004, 1e-12);
  // A thousandth of a degree of longitude at 58 degrees north.
  EXPECT_NEAR(info->cell_m, 59.0, 1.0);
  EXPECT_FALSE(info->datum);
  EXPECT_TRUE(info->foreign_datum.empty());
}

TEST(ElevationModelInfoTest, ReadsTheVerticalDatum) {
  const auto datum = [](const std::string& wkt) {
    return ParseElevationModelInfo(Info(wkt).dump())->datum;
  };
  EXPECT_EQ(datum("COMPOUNDCRS[\"x\",GEOGCRS[\"WGS 84\"],VERTCRS[\"EGM96 "
                  "height\",LENGTHUNIT[\"metre\",1]]]")
                ->kind,
            VerticalDatum::Kind::kEgm96);
  EXPECT_EQ(datum("COMPOUNDCRS[\"x\",VERTCRS[\"EGM2008 height\"]]")->kind,
            VerticalDatum::Kind::kEgm2008);
  EXPECT_EQ(datum("GEOGCRS[\"WGS 84\",CS[ellipsoidal,3]]")->kind,
            VerticalDatum::Kind::kEllipsoid);
  const auto foreign = ParseElevationModelInfo(
      Info("COMPOUNDCRS[\"x\",VERTCRS[\"RH2000 height\"]]").dump());
  EXPECT_FALSE(foreign->datum);
  EXPECT_EQ(foreign->foreign_datum, "RH2000 height");
}

TEST(ElevationModelInfoTest, RefusesWhatIsNoElevationModel) {
  EXPECT_THAT(ErrorOf(Info("")), HasSubstr("no coordinate system"));
  json info = Info("GEOGCRS[\"WGS 84\"]");
  info.erase("wgs84Extent");
  EXPECT_THAT(ErrorOf(info), HasSubstr("no place on Earth"));
  info = Info("GEOGCRS[\"WGS 84\"]");
  info["bands"].push_back({{"band", 2}});
  EXPECT_THAT(ErrorOf(info), HasSubstr("2 bands"));
  info = Info("GEOGCRS[\"WGS 84\"]");
  info["bands"][0]["unit"] = "US survey foot";
  EXPECT_THAT(ErrorOf(info), HasSubstr("must be metres"));
  info = Info("VERTCRS[\"EGM96 height\",LENGTHUNIT[\"foot\",0.3048]]");
  EXPECT_THAT(ErrorOf(info), HasSubstr("must be metres"));
  info = Info("GEOGCRS[\"WGS 84\"]");
  info["size"] = {0, 1e30};
  EXPECT_THAT(ErrorOf(info), HasSubstr("absurd"));
  info = Info("GEOGCRS[\"WGS 84\"]");
  info["wgs84Extent"]["coordinates"][0][0] = {15.0, 158.0};
  EXPECT_THAT(ErrorOf(info), HasSubstr("no place on Earth"));
  info["wgs84Extent"] = 3;
  EXPECT_THAT(ErrorOf(info), HasSubstr("another kind"));
  EXPECT_THAT(std::string(ParseElevationModelInfo("}{").status().message()),
              HasSubstr("no JSON"));
}

}  // namespace
}  // namespace groundlock::terrain
