// SPDX-License-Identifier: Apache-2.0
// groundlock map import, align, export and check: the program against a real
// server, on a made-up place of which everything is known.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <random>

#include "absl/strings/str_format.h"
#include "map_store/formats/formats.h"
#include "map_store/geometry/geodesy.h"
#include "map_store/map/map.h"
#include "tests/integration/command_line.h"
#include "tests/integration/test_server.h"
#include "tests/support/photo_xmp.h"
#include "tests/unit/map_store/map/synthetic_map.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using geometry::GeodeticPosition;
using geometry::Similarity3;
using map::MapData;
using nlohmann::json;
using ::testing::Contains;
using ::testing::HasSubstr;

constexpr GeodeticPosition kBerlin{52.519, 13.4, 80.0};

// Where a reconstruction has what is elsewhere in truth.
const Similarity3 kSourceFromTruth{
    0.37,
    Eigen::Quaterniond(
        Eigen::AngleAxisd(0.8, Eigen::Vector3d(0.2, -0.4, 1.0).normalized())),
    {3.0, -1.0, 2.0}};

Eigen::Vector3d CentreOf(const MapData& data, std::size_t view) {
  return data.views[view].camera_from_world.Inverse().translation;
}

class MapVerbs : public ::testing::Test {
 protected:
  // The truth: metres, z up, the ground at z = 0.
  MapVerbs() : truth_(map::testing_map::MakeMapData({.num_views = 12})) {
    truth_.landmarks.pop_back();  // which nobody sees
  }

  // Imports the place as a COLMAP model in coordinates of its own.
  void ImportPlace(const std::string& name) {
    MapData source = truth_;
    source.Transform(kSourceFromTruth);
    const absl::Status written = formats::Export(
        source, formats::ExportFormat::kColmapBinary, path() / "model");
    ASSERT_TRUE(written.ok()) << written;
    ASSERT_EQ(Run({"map", "import", name, (path() / "model").string()}), 0)
        << Read("err");
  }
  json Json(const std::vector<std::string>& arguments) {
    std::vector<std::string> with_json = arguments;
    with_json.emplace_back("--json");
    EXPECT_EQ(Run(with_json), 0) << Read("err");
    return json::parse(Read("out"), nullptr, false);
  }
  std::string Write(const std::string& file, const std::string& content) {
    std::ofstream(path() / file) << content;
    return (path() / file).string();
  }

  // Cameras and landmarks of the newest version, where they are in truth, less
  // `offset`.
  void ExpectTruth(const std::string& name,
                   double tolerance_m,
                   const Eigen::Vector3d& offset = Eigen::Vector3d::Zero()) {
    const auto cloud = server_.Connect()->GetPointCloud(name);
    ASSERT_TRUE(cloud.ok()) << cloud.status();
    ASSERT_EQ(cloud->cameras.size(), truth_.views.size());
    for (std::size_t i = 0; i < truth_.views.size(); ++i) {
      EXPECT_LT((cloud->cameras[i].world_from_camera.translation -
                 CentreOf(truth_, i) + offset)
                    .norm(),
                tolerance_m)
          << cloud->cameras[i].name;
    }
    ASSERT_EQ(cloud->xyz_world.size(), truth_.landmarks.size());
    for (std::size_t i = 0; i < truth_.landmarks.size(); ++i) {
      EXPECT_LT((cloud->xyz_world[i].cast<double>() -
                 truth_.landmarks[i].p_world + offset)
                    .norm(),
                tolerance_m)
          << i;
    }
  }

  int Run(const std::vector<std::string>& arguments) const {
    return command_line_.Run(arguments);
  }
  std::string Read(const std::string& file) const {
    return command_line_.Read(file);
  }
  const fs::path& path() const { return command_line_.path(); }

  TestServer server_;
  CommandLine command_line_ = CommandLine(server_.address());
  MapData truth_;
};

TEST_F(MapVerbs, AlignBySimilarity) {
  ImportPlace("place");
  const Similarity3 truth_from_source = kSourceFromTruth.Inverse();
  const Eigen::Quaterniond& q = truth_from_source.rotation;
  const Eigen::Vector3d& t = truth_from_source.translation;
  const std::string file =
      Write("align.json",
            json{{"scale", truth_from_source.scale},
                 {"rotation_wxyz", {q.w(), q.x(), q.y(), q.z()}},
                 {"translation", {t.x(), t.y(), t.z()}}}
                .dump());
  const json result = Json({"map", "align", "place", "--similarity", file});
  EXPECT_TRUE(result["metric"]);
  EXPECT_EQ(result["version"], 2);
  ExpectTruth("place", 1e-3);
  // The first version is what it was.
  EXPECT_FALSE(Json({"map", "show", "place", "--map-version", "1"})["metric"]);
}

TEST_F(MapVerbs, AlignByControlPoints) {
  ImportPlace("place");
  json points = json::array();
  for (const std::uint32_t landmark : {3U, 60U, 120U, 310U, 311U}) {
    json pixels = json::array();
    for (const map::MapViewData& view : truth_.views) {
      for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
        if (view.landmarks[i] != landmark) continue;
        pixels.push_back(
            {{"image", view.name},
             {"xy", {view.keypoints_px[i].x(), view.keypoints_px[i].y()}}});
      }
    }
    const GeodeticPosition place = geometry::GeodeticFromWorld(
        kBerlin, truth_.landmarks[landmark].p_world);
    points.push_back({{"name", "point " + std::to_string(landmark)},
                      {"pixels", pixels},
                      {"place",
                       {{"latitude_deg", place.latitude_deg},
                        {"longitude_deg", place.longitude_deg},
                        {"height_m", place.height_m}}}});
  }
  const std::string file =
      Write("points.json", json{{"points", points}}.dump());
  const std::vector<std::string> align = {"map",
                                          "align",
                                          "place",
                                          "--control-points",
                                          file,
                                          "--origin",
                                          "52.519,13.4,80"};
  const json result = Json(align);
  ASSERT_EQ(result["residuals"].size(), 5U);
  EXPECT_LT(result["max_error_m"], 0.01);
  EXPECT_NEAR(result["origin"]["latitude_deg"], kBerlin.latitude_deg, 1e-9);
  ExpectTruth("place", 0.01);

  // One that was mistyped is named, in metres.
  points[1]["place"]["height_m"] = 90.0;
  Write("points.json", json{{"points", points}}.dump());
  std::vector<std::string> report = align;
  report.emplace_back("--report-only");
  EXPECT_EQ(Json(report)["published"], false);
  EXPECT_THAT(Read("err"), HasSubstr("point 60"));
  EXPECT_EQ(Json({"map", "show", "place"})["version"], 2);

  Write("points.json", R"({"points":[{"name":"a","position":[1,2]}]})");
  EXPECT_EQ(Run(align), 1);
  EXPECT_THAT(Read("err"), HasSubstr("points.json: a: field \"position\""));
}

// Photos of a flat surface, straight on. Their maps are the same; whether it is
// a ground or a wall only the gimbal tells.
TEST_F(MapVerbs, PhotosTellWhichWayIsUp) {
  MapData source = truth_;
  std::erase_if(source.views, [](const auto&) { return true; });
  for (int v = 0; v < 12; ++v) {
    map::MapViewData& view = source.views.emplace_back();
    view.name = absl::StrFormat("DJI_%04d.JPG", v);
    // Looks along y at the wall y = 6.
    Eigen::Matrix3d world_from_camera;
    world_from_camera << 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0;
    view.camera_from_world =
        geometry::Rigid3{Eigen::Quaterniond(world_from_camera),
                         Eigen::Vector3d(0.4 * v - 2.0, 0.0, 1.6)}
            .Inverse();
    for (std::uint32_t i = 0; i < source.landmarks.size(); ++i) {
      const Eigen::Vector3d& p_world = source.landmarks[i].p_world;
      const auto pixel =
          source.cameras[0].ImageFromCamera(view.camera_from_world * p_world);
      if (!(p_world.y() > 5.5) || !pixel ||
          !source.cameras[0].IsInsideImage(*pixel)) {
        continue;
      }
      view.keypoints_px.emplace_back(pixel->cast<float>());
      view.landmarks.push_back(i);
      view.descriptors.emplace_back();
    }
  }
  source.Transform(kSourceFromTruth);
  const std::string model = (path() / "model").string();
  ASSERT_TRUE(
      formats::Export(source, formats::ExportFormat::kColmapBinary, model)
          .ok());
  const auto ground_of = [&](const std::string& name, double pitch_deg) {
    const fs::path photos = path() / name;
    fs::create_directories(photos);
    for (const map::MapViewData& view : source.views) {
      std::ofstream(photos / view.name, std::ios::binary)
          << test_support::WithSegment(
                 test_support::EmptyJpeg(),
                 test_support::XmpSegment(
                     test_support::DjiPacket(pitch_deg, 0.0)));
    }
    return Json({"map",
                 "import",
                 name,
                 model,
                 "--photos",
                 photos.string()})["map"]["ground"]["state"];
  };
  const json plain = Json({"map", "import", "plain", model});
  EXPECT_EQ(plain["map"]["ground"]["state"], "unknown");
  EXPECT_EQ(ground_of("flight", -90.0), "estimated");
  EXPECT_EQ(ground_of("walk", 0.0), "unknown");

  EXPECT_EQ(Run({"map", "import", "x", model, "--photos", model}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("no photo here that says how"));
  EXPECT_EQ(Run({"map", "import", "x", model, "--photos", model + "/none"}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("none: no such folder"));
}

TEST_F(MapVerbs, AlignByGps) {
  ImportPlace("place");
  std::mt19937_64 generator(4);
  std::normal_distribution<double> noise(0.0, 0.05);
  std::string lines = "# image, latitude, longitude, height\n";
  for (std::size_t i = 0; i < truth_.views.size(); ++i) {
    Eigen::Vector3d p =
        CentreOf(truth_, i) +
        Eigen::Vector3d{noise(generator), noise(generator), noise(generator)};
    if (i == 5) p += Eigen::Vector3d(20.0, -30.0, 5.0);
    const GeodeticPosition place = geometry::GeodeticFromWorld(kBerlin, p);
    char line[128];
    std::snprintf(line,
                  sizeof(line),
                  "%s,%.10f,%.10f,%.4f\n",
                  truth_.views[i].name.c_str(),
                  place.latitude_deg,
                  place.longitude_deg,
                  place.height_m);
    lines += line;
  }
  const std::string file = Write("positions.csv", lines);
  const json result = Json({"map",
                            "align",
                            "place",
                            "--gps",
                            file,
                            "--accuracy",
                            "0.1",
                            "--origin",
                            "52.519,13.4,80"});
  ASSERT_EQ(result["residuals"].size(), truth_.views.size());
  for (const json& residual : result["residuals"]) {
    EXPECT_EQ(residual["used"], residual["name"] != "frame5.jpg") << residual;
  }
  // 11 positions of 5 cm per axis.
  EXPECT_LT(result["rms_error_m"], 0.2);
  EXPECT_GT(result["rms_error_m"], 0.02);
  ExpectTruth("place", 0.2);

  EXPECT_EQ(Run({"map", "align", "place", "--gps", path().string()}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("no photo here whose EXIF data"));
  Write("positions.csv", lines + "frame7.jpg,north,13.4,80\n");
  EXPECT_EQ(Run({"map", "align", "place", "--gps", file}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("positions.csv:14"));
}

// An elevation model of a level field, in cells of 0.00005 degrees about
// Berlin.
std::string LevelField(double height_m) {
  std::string text = absl::StrFormat(
      "ncols 100\nnrows 100\nxllcorner %.6f\nyllcorner %.6f\n"
      "cellsize 0.00005\n",
      kBerlin.longitude_deg - 0.0025,
      kBerlin.latitude_deg - 0.0025);
  for (int row = 0; row < 100; ++row) {
    for (int column = 0; column < 100; ++column) {
      absl::StrAppendFormat(&text, "%.2f ", height_m);
    }
    text += '\n';
  }
  return text;
}

TEST_F(MapVerbs, AlignByTerrain) {
  ImportPlace("place");
  const std::string field = Write("field.asc", LevelField(kBerlin.height_m));
  Write("field.prj",
        "GEOGCS[\"GCS_WGS_1984\",DATUM[\"D_WGS_1984\",SPHEROID[\"WGS_1984\","
        "6378137.0,298.257223563]],PRIMEM[\"Greenwich\",0.0],"
        "UNIT[\"Degree\",0.0174532925199433]]");
  const std::vector<std::string> align = {
      "map", "align", "place", "--terrain", field};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.begin(), align.begin(), align.end());
    return more;
  };
  // It has no place on Earth yet.
  EXPECT_EQ(Run(with({"--vertical-datum", "ellipsoid"})), 1);
  EXPECT_THAT(Read("err"), HasSubstr("no place on Earth"));
  const Similarity3 truth_from_source = kSourceFromTruth.Inverse();
  const Eigen::Quaterniond& q = truth_from_source.rotation;
  const Eigen::Vector3d& t = truth_from_source.translation;
  const std::string similarity =
      Write("align.json",
            json{{"scale", truth_from_source.scale},
                 {"rotation_wxyz", {q.w(), q.x(), q.y(), q.z()}},
                 {"translation", {t.x(), t.y(), t.z()}}}
                .dump());
  Json({"map",
        "align",
        "place",
        "--similarity",
        similarity,
        "--origin",
        absl::StrFormat("%.9f,%.9f,%.3f",
                        kBerlin.latitude_deg,
                        kBerlin.longitude_deg,
                        kBerlin.height_m)});

  // Nothing says what its heights are counted from.
  EXPECT_EQ(Run(align), 1);
  EXPECT_THAT(Read("err"), HasSubstr("vertical datum"));
  // Over the geoid they would be 39 m higher than the cameras.
  EXPECT_EQ(Run(with({"--vertical-datum", "egm96"})), 1);
  EXPECT_THAT(Read("err"), HasSubstr("below the ground"));
  EXPECT_EQ(Json({"map", "show", "place"})["version"], 2);

  const json moved = Json(
      with({"--vertical-datum", "egm96", "--terrain-fit", "--report-only"}));
  EXPECT_NEAR(moved["terrain"]["offset_m"], -39.5, 1.0);
  const json result = Json(with({"--vertical-datum", "ellipsoid"}));
  EXPECT_EQ(result["version"], 3);
  EXPECT_NEAR(result["terrain"]["offset_m"], 0.0, 0.02);
  ExpectTruth("place", 0.02);
  const json ground = Json({"map", "show", "place"})["ground"];
  EXPECT_EQ(ground["state"], "measured");
  EXPECT_TRUE(ground["relief_given"]);

  // What is no elevation model, and what is not there.
  EXPECT_EQ(Run({"map", "align", "place", "--terrain", similarity}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("no elevation model"));
  EXPECT_EQ(Run({"map", "align", "place", "--terrain", "nowhere.tif"}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("no such file"));
  EXPECT_EQ(Run(with({"--vertical-datum", "sea"})), 1);
  EXPECT_THAT(Read("err"), HasSubstr("--vertical-datum"));
}

TEST_F(MapVerbs, AnExportedFileIsTheSameMapElsewhere) {
  ImportPlace("place");
  const json place = Json({"map", "show", "place"});
  const fs::path file = path() / "place.glmap";
  ASSERT_EQ(
      Run({"map", "export", "place", file.string(), "--format", "groundlock"}),
      0)
      << Read("err");
  ASSERT_EQ(Run({"map", "check", file.string()}), 0) << Read("err");
  EXPECT_THAT(Read("out"), HasSubstr("sound"));
  ASSERT_EQ(Run({"map", "import", "copy", file.string()}), 0) << Read("err");
  const json copy = Json({"map", "show", "copy"});
  EXPECT_EQ(copy["content_hash"], place["content_hash"]);
  EXPECT_EQ(copy["num_observations"], place["num_observations"]);
  EXPECT_EQ(Json({"map", "check", "copy"})["sound"], true);
  // There is something: it stays, and that is said.
  EXPECT_EQ(
      Run({"map", "export", "place", file.string(), "--format", "groundlock"}),
      1);
  EXPECT_THAT(Read("err"), HasSubstr("place.glmap: exists"));

  // Damage is found, here and by the server that is to take it.
  {
    std::fstream stream(file, std::ios::in | std::ios::out | std::ios::binary);
    // Amid the descriptors, most of the file.
    stream.seekp(static_cast<std::streamoff>(fs::file_size(file) / 2));
    stream.write("\x5a\x11\xff\x80", 4);
  }
  EXPECT_EQ(Run({"map", "check", file.string()}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("section"));
  EXPECT_EQ(Run({"map", "import", "damaged", file.string()}), 1);
  EXPECT_THAT(Read("err"), HasSubstr("section"));
  EXPECT_EQ(Run({"map", "show", "damaged"}), 1);
}

TEST_F(MapVerbs, AnInterruptedExportLeavesNothing) {
  ImportPlace("place");
  const fs::path folder = path() / "exports";
  fs::create_directories(folder);
  // At various moments; some exports are done by then, and whole.
  for (int wait_ms : {0, 5, 10, 20, 40}) {
    const fs::path file = folder / ("place" + std::to_string(wait_ms));
    const pid_t pid =
        command_line_.Start({"map", "export", "place", file.string()});
    std::this_thread::sleep_for(std::chrono::milliseconds(wait_ms));
    kill(pid, SIGINT);
    const int code = CommandLine::Wait(pid);
    if (code == 0) {
      EXPECT_TRUE(fs::exists(file / "database.db"));
    } else {
      EXPECT_FALSE(fs::exists(file)) << code << Read("err");
    }
    fs::remove_all(file);
    EXPECT_TRUE(fs::is_empty(folder));
  }
  EXPECT_TRUE(Eventually([this] { return fs::is_empty(server_.scratch()); }));
}

}  // namespace
}  // namespace groundlock::test
