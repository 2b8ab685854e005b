// SPDX-License-Identifier: Apache-2.0
// Elevation models as GDAL writes them, read by GDAL's own programs.
#include "map_store/terrain/elevation_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/cage/child_process.h"

namespace groundlock::terrain {
namespace {

namespace fs = std::filesystem;
using Kind = VerticalDatum::Kind;
using ::testing::HasSubstr;

class ElevationModelTest : public ::testing::Test {
 protected:
  ElevationModelTest()
      : folder_(*base::TemporaryDirectory::Create(::testing::TempDir())) {
    // 0.001 degrees a cell; north is up, the second row's third is a hole.
    std::ofstream(Path("grid.asc"))
        << "ncols 5\nnrows 4\nxllcorner 15.0\nyllcorner 58.0\n"
           "cellsize 0.001\nNODATA_value -9999\n"
           "10 11 12 13 14\n10 11 -9999 13 14\n10 11 12 13 14\n"
           "10 11 12 13 14\n";
  }

  fs::path Path(const std::string& name) const { return folder_.path() / name; }

  // gdal_translate of the grid.
  fs::path Make(const std::string& name,
                const std::vector<std::string>& arguments) {
    cage::ChildProcessOptions options;
    options.arguments = {"gdal_translate", "-q"};
    options.arguments.insert(
        options.arguments.end(), arguments.begin(), arguments.end());
    options.arguments.push_back(Path("grid.asc").string());
    options.arguments.push_back(Path(name).string());
    options.log = Path("log");
    const absl::Status status = cage::RunChildProcess(options);
    EXPECT_TRUE(status.ok()) << status;
    return Path(name);
  }

  // Its middles lie on those of the grid's columns 1 and 2, rows 2 and 3.
  ElevationModelRequest Request(const fs::path& file) const {
    ElevationModelRequest request;
    request.file = file;
    request.window = {15.001, 58.0, 15.003, 58.002};
    request.columns = 2;
    request.rows = 2;
    return request;
  }

  const base::TemporaryDirectory folder_;
};

TEST_F(ElevationModelTest, ReadsAGeoTiffOverTheEllipsoid) {
  ElevationModelRequest request =
      Request(Make("a.tif", {"-of", "GTiff", "-a_srs", "EPSG:4326"}));
  request.datum = VerticalDatum{Kind::kEllipsoid, {}};
  const auto grid = ReadElevationModel(request);
  ASSERT_TRUE(grid.ok()) << grid.status();
  ASSERT_EQ(grid->heights_m.size(), 4U);
  EXPECT_NEAR(grid->heights_m[0], 11.0, 1e-4);
  EXPECT_NEAR(grid->heights_m[1], 12.0, 1e-4);
  EXPECT_NEAR(grid->heights_m[3], 12.0, 1e-4);
  // A hole stays one.
  request.window = {15.001, 58.001, 15.003, 58.003};
  const auto with_hole = ReadElevationModel(request);
  ASSERT_TRUE(with_hole.ok()) << with_hole.status();
  EXPECT_TRUE(std::isnan(with_hole->heights_m[1]));
  EXPECT_NEAR(with_hole->heights_m[0], 11.0, 1e-4);
}

// What a geoid is there is no number of ours: 31.1 m over the ellipsoid at 58
// north, 15 east, by NGA's own calculator for EGM96, to 0.1 m.
TEST_F(ElevationModelTest, CountsFromTheGeoidThatIsMeant) {
  const fs::path silent =
      Make("silent.tif", {"-of", "GTiff", "-a_srs", "EPSG:4326"});
  // EPSG:9707 is WGS84 with EGM96 heights.
  const fs::path says =
      Make("says.tif", {"-of", "GTiff", "-a_srs", "EPSG:9707"});
  ElevationModelRequest request = Request(silent);
  const auto nobody_knows = ReadElevationModel(request);
  EXPECT_TRUE(absl::IsFailedPrecondition(nobody_knows.status()))
      << nobody_knows.status();
  EXPECT_THAT(std::string(nobody_knows.status().message()),
              HasSubstr("does not say"));

  request.datum = VerticalDatum{Kind::kEgm96, {}};
  const auto told = ReadElevationModel(request);
  ASSERT_TRUE(told.ok()) << told.status();
  EXPECT_NEAR(told->heights_m[0], 11.0 + 31.1, 0.1);

  const auto by_itself = ReadElevationModel(Request(says));
  ASSERT_TRUE(by_itself.ok()) << by_itself.status();
  EXPECT_EQ(by_itself->heights_m, told->heights_m);

  ElevationModelRequest contradiction = Request(says);
  contradiction.datum = VerticalDatum{Kind::kEllipsoid, {}};
  const auto refused = ReadElevationModel(contradiction);
  EXPECT_TRUE(absl::IsInvalidArgument(refused.status())) << refused.status();
  EXPECT_THAT(std::string(refused.status().message()),
              HasSubstr("says that its heights are counted from egm96"));
}

TEST_F(ElevationModelTest, TakesAnyGeoidsGrid) {
  ElevationModelRequest request =
      Request(Make("a.tif", {"-of", "GTiff", "-a_srs", "EPSG:4326"}));
  // The same heights once more.
  request.datum = VerticalDatum{Kind::kGeoidFile, request.file};
  const auto grid = ReadElevationModel(request);
  ASSERT_TRUE(grid.ok()) << grid.status();
  EXPECT_NEAR(grid->heights_m[0], 22.0, 1e-4);
}

TEST_F(ElevationModelTest, AGeoidWhoseGridIsMissingIsAnErrorNotAGuess) {
  const fs::path file = Make("a.tif", {"-of", "GTiff", "-a_srs", "EPSG:4326"});
  ElevationModelRequest request = Request(file);
  request.datum = VerticalDatum{Kind::kEgm2008, {}};
  const auto grid = ReadElevationModel(request);
  if (grid.ok()) GTEST_SKIP() << "this machine has the grid of EGM2008";
  EXPECT_TRUE(absl::IsFailedPrecondition(grid.status())) << grid.status();
  EXPECT_THAT(std::string(grid.status().message()),
              HasSubstr("us_nga_egm08_25.tif"));
}

TEST_F(ElevationModelTest, ReadsOtherProjectionsAndFormats) {
  const fs::path warped = Path("utm.tif");
  cage::ChildProcessOptions options;
  options.arguments = {"gdalwarp",
                       "-q",
                       "-t_srs",
                       "EPSG:32633",
                       "-r",
                       "bilinear",
                       Make("a.tif", {"-a_srs", "EPSG:4326"}).string(),
                       warped.string()};
  options.log = Path("log");
  ASSERT_TRUE(cage::RunChildProcess(options).ok());
  ElevationModelRequest request = Request(warped);
  request.datum = VerticalDatum{Kind::kEllipsoid, {}};
  const auto grid = ReadElevationModel(request);
  ASSERT_TRUE(grid.ok()) << grid.status();
  // Resampled twice beside a hole: to half of what a cell aside would make.
  EXPECT_NEAR(grid->heights_m[2], 11.0, 0.5);
  EXPECT_NEAR(grid->heights_m[3], 12.0, 0.5);
}

TEST_F(ElevationModelTest, SaysWhereItKnowsNothing) {
  ElevationModelRequest request =
      Request(Make("a.tif", {"-of", "GTiff", "-a_srs", "EPSG:4326"}));
  request.datum = VerticalDatum{Kind::kEllipsoid, {}};
  request.window = {16.0, 57.0, 16.1, 57.1};
  const auto grid = ReadElevationModel(request);
  EXPECT_TRUE(absl::IsOutOfRange(grid.status())) << grid.status();
  EXPECT_THAT(std::string(grid.status().message()),
              HasSubstr("knows nothing of"));
}

// Whatever a file is, it ends in one error that names it, or in heights.
TEST_F(ElevationModelTest, SurvivesDamagedFiles) {
  const fs::path whole = Make("a.tif", {"-of", "GTiff", "-a_srs", "EPSG:4326"});
  const std::string bytes = *base::ReadFile(whole, 1 << 20);
  std::mt19937_64 generator(1);
  int refused = 0;
  for (int i = 0; i < 24; ++i) {
    std::string damaged = bytes;
    if (i % 3 == 0) damaged.resize(generator() % bytes.size());
    for (int k = 0; k < 6 && !damaged.empty(); ++k) {
      damaged[generator() % damaged.size()] = static_cast<char>(generator());
    }
    const fs::path path = Path("damaged.tif");
    std::ofstream(path, std::ios::binary) << damaged;
    ElevationModelRequest request = Request(path);
    request.datum = VerticalDatum{Kind::kEllipsoid, {}};
    const auto grid = ReadElevationModel(request);
    if (grid.ok()) {
      EXPECT_EQ(grid->heights_m.size(), 4U);
      continue;
    }
    ++refused;
    EXPECT_THAT(std::string(grid.status().message()), HasSubstr("damaged.tif"));
  }
  EXPECT_GT(refused, 8);
}

TEST_F(ElevationModelTest, RefusesWhatItIsNotAskedFor) {
  ElevationModelRequest request = Request(Path("nowhere.tif"));
  EXPECT_TRUE(absl::IsNotFound(ReadElevationModel(request).status()));
  request.columns = 1;
  EXPECT_TRUE(absl::IsInvalidArgument(ReadElevationModel(request).status()));
  request.columns = kMaxSide + 1;
  EXPECT_TRUE(absl::IsInvalidArgument(ReadElevationModel(request).status()));
  EXPECT_TRUE(ParseVerticalDatum("egm2008").ok());
  EXPECT_EQ(ParseVerticalDatum(Path("grid.asc").string())->kind,
            Kind::kGeoidFile);
  EXPECT_THAT(std::string(ParseVerticalDatum("sea").status().message()),
              HasSubstr("egm96"));
}

}  // namespace
}  // namespace groundlock::terrain
