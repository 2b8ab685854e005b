// SPDX-License-Identifier: Apache-2.0
// groundlock map build, extend and merge: the program, COLMAP and a real
// server, on rendered photos of a made-up place.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <thread>

#include "absl/strings/str_format.h"
#include "map_store/geometry/similarity3.h"
#include "tests/integration/command_line.h"
#include "tests/integration/test_server.h"
#include "tests/support/photo_xmp.h"
#include "tests/support/rendered_plane_map.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using ::testing::Not;

class MapBuild : public ::testing::Test {
 protected:
  // Along a bow in front of the place, looking at its middle.
  static geometry::Rigid3 ViewAt(int i) {
    const double x_m = 0.45 * (i - 5.5);
    return test_support::LookAlongY(
        {x_m, 0.25 * (i % 2) - 0.02 * x_m * x_m, 1.5 + 0.12 * (i % 3)},
        0.09 * x_m,
        -0.02);
  }

  // The same way as a hand would film it.
  static geometry::Rigid3 Filmed(int frame) {
    const double x_m = 0.09 * (frame - 24);
    return test_support::LookAlongY(
        {x_m,
         0.1 * std::sin(0.5 * frame) - 0.02 * x_m * x_m,
         1.6 + 0.1 * std::sin(0.3 * frame)},
        0.09 * x_m,
        -0.02);
  }

  // As a drone would have taken them: each says how it was held.
  fs::path PhotosWithAttitudes(const std::string& folder,
                               int begin,
                               int end) const {
    fs::path photos = Photos(folder, begin, end);
    for (int i = begin; i < end; ++i) {
      fs::path photo = photos / absl::StrFormat("photo%02d.png", i);
      std::vector<unsigned char> jpeg;
      cv::imencode(".jpg",
                   cv::imread(photo.string(), cv::IMREAD_COLOR),
                   jpeg,
                   {cv::IMWRITE_JPEG_QUALITY, 97});
      fs::remove(photo);
      const Eigen::Vector3d up_camera =
          ViewAt(i).rotation.conjugate() * Eigen::Vector3d::UnitZ();
      std::ofstream(photo.replace_extension(".jpg"), std::ios::binary)
          << test_support::WithSegment(
                 std::string(jpeg.begin(), jpeg.end()),
                 test_support::XmpSegment(test_support::DjiPacket(up_camera)));
    }
    return photos;
  }

  fs::path Photos(const std::string& folder, int begin, int end) const {
    const test_support::RenderedPlace place(21);
    fs::create_directories(path() / folder);
    for (int i = begin; i < end; ++i) {
      char name[32];
      std::snprintf(name, sizeof(name), "photo%02d.png", i);
      cv::imwrite((path() / folder / name).string(), place.Render(ViewAt(i)));
    }
    std::ofstream(path() / "camera.json")
        << geometry::CameraModelToJson(place.camera());
    return path() / folder;
  }

  pid_t Start(const std::vector<std::string>& arguments) const {
    return command_line_.Start(arguments);
  }
  static int Wait(pid_t pid) { return CommandLine::Wait(pid); }
  int Run(const std::vector<std::string>& arguments) const {
    return command_line_.Run(arguments);
  }
  std::string Read(const std::string& file) const {
    return command_line_.Read(file);
  }
  std::vector<std::string> BuildArguments(const fs::path& photos) const {
    return {"map",
            "build",
            "place",
            "--images",
            photos.string(),
            "--camera",
            (path() / "camera.json").string(),
            "--work",
            (path() / "work").string(),
            "--max-features",
            "2000",
            "--threads",
            "2",
            "--json"};
  }
  std::vector<std::string> OnServer(const fs::path& photos) const {
    return {"map",
            "build",
            "place",
            "--images",
            photos.string(),
            "--camera",
            (path() / "camera.json").string(),
            "--max-features",
            "2000",
            "--on-server",
            "--json"};
  }
  static sdk::BuildRequest Request(const fs::path& photos) {
    sdk::BuildRequest request;
    request.name = "place";
    request.max_features = 2'000;
    request.camera = test_support::RenderedPlace(21).camera();
    for (const auto& entry : fs::directory_iterator(photos)) {
      request.files.push_back({entry.path(), entry.path().filename().string()});
    }
    return request;
  }
  // Of this process, in which the server runs.
  static bool HasChildren() { return waitpid(-1, nullptr, WNOHANG) == 0; }
  const fs::path& path() const { return command_line_.path(); }

  TestServer server_;

 private:
  CommandLine command_line_ = CommandLine(server_.address());
};

TEST_F(MapBuild, PhotosBecomeAMapThatGrows) {
  ASSERT_EQ(Run(BuildArguments(PhotosWithAttitudes("photos", 0, 10))), 0)
      << Read("err");
  const json result = json::parse(Read("out"));
  EXPECT_THAT(result["report"]["up_basis"].get<std::string>(),
              HasSubstr("the attitudes of"));
  EXPECT_THAT(Read("work/report.html"), HasSubstr("the attitudes of"));
  EXPECT_GE(result["report"]["num_registered"], 9);
  EXPECT_LT(result["report"]["mean_reprojection_error_px"], 1.0);
  for (const char* file :
       {"report.html", "map_above.png", "map_side.png", "coverage.png"}) {
    EXPECT_TRUE(fs::exists(path() / "work" / file)) << file;
  }
  const auto client = server_.Connect();
  const auto map = client->GetMap("place");
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE(map->has_descriptors);
  EXPECT_GT(map->num_landmarks, 200U);

  // Its cameras stand where the photos were taken, up to a similarity.
  const auto cloud = client->GetPointCloud("place");
  ASSERT_TRUE(cloud.ok()) << cloud.status();
  std::vector<Eigen::Vector3d> built;
  std::vector<Eigen::Vector3d> truth;
  for (const sdk::MapCamera& camera : cloud->cameras) {
    built.push_back(camera.world_from_camera.translation);
    truth.push_back(ViewAt(std::stoi(camera.name.substr(5, 2))).translation);
  }
  const auto aligned = geometry::EstimateSimilarity(built, truth);
  ASSERT_TRUE(aligned.ok()) << aligned.status();
  for (std::size_t i = 0; i < built.size(); ++i) {
    // 4 m of way, 9 m in front of a wall: a hundredth of the way.
    EXPECT_LT((*aligned * built[i] - truth[i]).norm(), 0.04) << i;
  }

  // The same again finds everything there.
  ASSERT_EQ(Run(BuildArguments(path() / "photos")), 0) << Read("err");
  for (const json& stage : json::parse(Read("out"))["report"]["stages"]) {
    EXPECT_TRUE(stage["was_there"]) << stage;
  }

  const fs::path more = Photos("more", 10, 12);
  ASSERT_EQ(
      Run({"map", "extend", "place", "--images", more.string(), "--json"}), 0)
      << Read("err");
  EXPECT_EQ(json::parse(Read("out"))["registered"].size(), 2U);
  const auto extended = client->GetMap("place");
  ASSERT_TRUE(extended.ok());
  EXPECT_EQ(extended->num_views, map->num_views + 2);
  EXPECT_GT(extended->version, map->version);
}

TEST_F(MapBuild, AVideoBecomesAMap) {
  // The walk of the photos, filmed: far more frames than a map needs, of which
  // some are blurred.
  const test_support::RenderedPlace place(21);
  const fs::path video = path() / "walk.avi";
  std::ofstream(path() / "camera.json")
      << geometry::CameraModelToJson(place.camera());
  constexpr int kFrames = 48;
  {
    cv::VideoWriter writer(
        video.string(),
        cv::VideoWriter::fourcc('M', 'J', 'P', 'G'),
        24.0,
        {place.camera().width_px(), place.camera().height_px()});
    ASSERT_TRUE(writer.isOpened());
    for (int i = 0; i < kFrames; ++i) {
      cv::Mat frame = place.Render(Filmed(i));
      if (frame.channels() == 1) cv::cvtColor(frame, frame, cv::COLOR_GRAY2BGR);
      if (i % 8 == 5) cv::GaussianBlur(frame, frame, {}, 6.0);
      writer.write(frame);
    }
  }
  std::vector<std::string> arguments = BuildArguments(path());
  *std::find(arguments.begin(), arguments.end(), "--images") = "--video";
  *std::find(arguments.begin(), arguments.end(), path().string()) =
      video.string();
  ASSERT_EQ(Run(arguments), 0) << Read("err");
  const json report = json::parse(Read("out"))["report"];
  EXPECT_EQ(report["num_registered"], report["num_images"]);
  // Of 4 m, each some 6 % of the picture from the last.
  EXPECT_GE(report["num_images"], 6);
  EXPECT_LE(report["num_images"], kFrames / 2);
  for (const json& image : report["images"]) {
    // frame_000013.jpg
    const int frame = std::stoi(image["name"].get<std::string>().substr(6, 6));
    EXPECT_NE(frame % 8, 5) << image;
  }
  const auto cloud = server_.Connect()->GetPointCloud("place");
  ASSERT_TRUE(cloud.ok()) << cloud.status();
  std::vector<Eigen::Vector3d> built;
  std::vector<Eigen::Vector3d> truth;
  for (const sdk::MapCamera& camera : cloud->cameras) {
    built.push_back(camera.world_from_camera.translation);
    truth.push_back(Filmed(std::stoi(camera.name.substr(6, 6))).translation);
  }
  const auto aligned = geometry::EstimateSimilarity(built, truth);
  ASSERT_TRUE(aligned.ok()) << aligned.status();
  for (std::size_t i = 0; i < built.size(); ++i) {
    EXPECT_LT((*aligned * built[i] - truth[i]).norm(), 0.04) << i;
  }
  EXPECT_THAT(Read("err"), Not(HasSubstr("the lens that was given")));
  // The same with the lens of another camera.
  const geometry::CameraModel& lens = place.camera();
  std::vector<double> params(lens.params().begin(), lens.params().end());
  params[0] *= 0.4;
  const auto other = geometry::CameraModel::Create(
      lens.id(), lens.width_px(), lens.height_px(), params);
  ASSERT_TRUE(other.ok()) << other.status();
  std::ofstream(path() / "camera.json") << geometry::CameraModelToJson(*other);
  ASSERT_EQ(Run(arguments), 0) << Read("err");
  char given[64];
  std::snprintf(given, sizeof(given), "its focal length is %.0f px", params[0]);
  EXPECT_THAT(Read("err"), HasSubstr(given));
}

TEST_F(MapBuild, AnInterruptedBuildGoesOnWhereItWas) {
  const fs::path photos = Photos("photos", 0, 8);
  const pid_t pid = Start(BuildArguments(photos));
  ASSERT_TRUE(Eventually([&] {
    return Read("work/stages.json").find("\"features\"") != std::string::npos;
  })) << Read("err");
  kill(pid, SIGINT);
  ASSERT_EQ(Wait(pid), 130) << Read("err");
  EXPECT_THAT(Read("err"), HasSubstr("goes on"));
  ASSERT_EQ(Run(BuildArguments(photos)), 0) << Read("err");
  const json result = json::parse(Read("out"));
  EXPECT_EQ(result["report"]["stages"][0]["name"], "features");
  EXPECT_TRUE(result["report"]["stages"][0]["was_there"]);
  EXPECT_FALSE(result["report"]["stages"].back()["was_there"]);
  EXPECT_GE(result["report"]["num_registered"], 7);
}

TEST_F(MapBuild, TheServerBuilds) {
  const fs::path photos = Photos("photos", 0, 8);
  ASSERT_EQ(Run(OnServer(photos)), 0) << Read("err");
  const json result = json::parse(Read("out"));
  EXPECT_GE(result["report"]["num_registered"], 7);
  EXPECT_EQ(result["map"]["version"], 1);
  // Nothing was done here, and nothing is left over there.
  EXPECT_FALSE(fs::exists(path() / "place.build"));
  EXPECT_TRUE(Eventually([&] { return fs::is_empty(server_.scratch()); }));
  const auto map = server_.Connect()->GetMap("place");
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_TRUE(map->has_descriptors);
  EXPECT_GT(map->num_landmarks, 200U);
  EXPECT_EQ(map->num_views, result["report"]["num_registered"]);
}

TEST_F(MapBuild, TheServerTellsHowFarItIsAndStopsWhenAsked) {
  const sdk::BuildRequest request = Request(Photos("photos", 0, 8));
  const auto client = server_.Connect();
  std::vector<std::string> stages;
  const auto built = client->BuildMap(
      request, [&](std::string_view stage, double fraction, const auto&) {
        EXPECT_GE(fraction, 0.0);
        EXPECT_LE(fraction, 1.0);
        if (stages.empty() || stages.back() != stage) {
          stages.emplace_back(stage);
        }
        // COLMAP is a child of the server's now, or will be in a moment.
        return stage != "mapping" && stage != "refining";
      });
  EXPECT_EQ(built.status().code(), absl::StatusCode::kCancelled)
      << built.status();
  EXPECT_THAT(stages, IsSupersetOf({"uploading", "features"}));
  EXPECT_TRUE(Eventually([&] { return fs::is_empty(server_.scratch()); }));
  EXPECT_FALSE(HasChildren());
  EXPECT_EQ(client->GetMap("place").status().code(),
            absl::StatusCode::kNotFound);
}

TEST_F(MapBuild, AServerThatStopsEndsItsBuilds) {
  const sdk::BuildRequest request = Request(Photos("photos", 0, 8));
  const auto client = server_.Connect();
  std::thread stop;
  const auto built = client->BuildMap(
      request, [&](std::string_view stage, double, const auto&) {
        if (stage == "features" && !stop.joinable()) {
          stop = std::thread(
              [this] { server_.Stop(std::chrono::milliseconds(0)); });
        }
        return true;
      });
  ASSERT_TRUE(stop.joinable()) << built.status();
  stop.join();
  EXPECT_FALSE(built.ok());
  EXPECT_TRUE(Eventually([&] { return fs::is_empty(server_.scratch()); }));
  EXPECT_FALSE(HasChildren());
}

TEST_F(MapBuild, TheServerTakesOneBuildAtATimeAndSaysWhatIsWrong) {
  const sdk::BuildRequest request = Request(Photos("photos", 0, 3));
  const auto client = server_.Connect();
  absl::Status second;
  const auto first = client->BuildMap(
      request, [&](std::string_view stage, double, const auto&) {
        if (stage != "features") return true;
        second = client->BuildMap(request).status();
        return false;
      });
  EXPECT_EQ(first.status().code(), absl::StatusCode::kCancelled);
  EXPECT_EQ(second.code(), absl::StatusCode::kResourceExhausted) << second;
  // Its place is free when its call has ended there, too.
  const auto eventually = [&](const sdk::BuildRequest& wrong) {
    absl::Status status;
    EXPECT_TRUE(Eventually([&] {
      status = client->BuildMap(wrong).status();
      return status.code() != absl::StatusCode::kResourceExhausted;
    }));
    return status;
  };
  sdk::BuildRequest wrong = request;
  wrong.name = ".hidden";
  EXPECT_THAT(eventually(wrong).message(), HasSubstr("header.name"));
  wrong = request;
  wrong.video_path = "walk.mp4";
  EXPECT_THAT(eventually(wrong).message(), HasSubstr("header.video_path"));
  wrong.video_path = wrong.files.front().remote_path = "../walk.mp4";
  EXPECT_THAT(eventually(wrong).message(), HasSubstr("header.video_path"));
  wrong = request;
  std::ofstream(path() / "broken.png") << "no picture";
  wrong.files.front().path = path() / "broken.png";
  const absl::Status broken = eventually(wrong);
  EXPECT_EQ(broken.code(), absl::StatusCode::kInvalidArgument) << broken;
  EXPECT_THAT(broken.message(), HasSubstr(wrong.files.front().remote_path));
  EXPECT_THAT(broken.message(), Not(HasSubstr(server_.scratch().string())));
  EXPECT_TRUE(Eventually([&] { return fs::is_empty(server_.scratch()); }));
}

TEST_F(MapBuild, AServerMayBeToldToBuildNone) {
  service::ServerOptions options;
  options.maps.max_concurrent_builds = 0;
  const TestServer server(options);
  const auto client = server.Connect();
  const auto built = client->BuildMap(Request(Photos("photos", 0, 3)));
  EXPECT_EQ(built.status().code(), absl::StatusCode::kUnimplemented)
      << built.status();
}

TEST_F(MapBuild, ErrorsSayWhatToDo) {
  const fs::path photos = Photos("photos", 0, 3);
  std::vector<std::string> arguments = BuildArguments(photos);
  arguments.insert(arguments.end(), {"--colmap", "/no/such/colmap"});
  EXPECT_EQ(Run(arguments), 1);
  EXPECT_THAT(Read("err"), HasSubstr("install COLMAP"));
  // Images that have nothing to do with each other.
  const fs::path strange = path() / "strange";
  fs::create_directories(strange);
  for (int i = 0; i < 3; ++i) {
    cv::imwrite((strange / ("photo0" + std::to_string(i) + ".png")).string(),
                test_support::RenderedPlace(100 + static_cast<unsigned>(i))
                    .Render(ViewAt(5)));
  }
  EXPECT_EQ(Run(BuildArguments(strange)), 1);
  EXPECT_THAT(Read("err"), HasSubstr("of 3 images could be put together"));
  EXPECT_EQ(Run(BuildArguments(path() / "nowhere")), 1);
  EXPECT_THAT(Read("err"), HasSubstr("nowhere: no such folder"));
}

}  // namespace
}  // namespace groundlock::test
