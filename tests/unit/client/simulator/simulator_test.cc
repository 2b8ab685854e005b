// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/simulator.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <opencv2/videoio.hpp>
#include <set>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/cli/imu.h"
#include "map_store/base/file.h"
#include "map_store/formats/formats.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::simulator {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr std::uint64_t kMaxFile_bytes = 256U << 20U;

std::string Content(const fs::path& path) {
  auto content = base::ReadFile(path, kMaxFile_bytes);
  EXPECT_TRUE(content.ok()) << content.status();
  return content.ok() ? *content : "";
}

class SimulatorTest : public testing::Test {
 protected:
  SimulatorTest()
      : folder_(*base::TemporaryDirectory::Create(fs::temp_directory_path())) {}

  SimulationOptions Small(const std::string& sequence, int frames) const {
    SimulationOptions options;
    options.sequence = sequence;
    options.output = folder_.path() / "a";
    options.width_px = 320;
    options.height_px = 180;
    options.frames = frames;
    options.samples_per_pixel = 2;
    options.threads = 2;
    return options;
  }

  base::TemporaryDirectory folder_;
};

TEST_F(SimulatorTest, NamesEverySequenceAndRejectsOthers) {
  EXPECT_EQ(SceneNames(),
            (std::vector<std::string>{"yard", "hills", "aerial"}));
  EXPECT_EQ(SequenceNames("hills"), SequenceNames("yard"));
  EXPECT_THAT(SequenceNames("yard"),
              testing::ElementsAre("mapping",
                                   "occlusion",
                                   "srun",
                                   "scale",
                                   "outofview",
                                   "return",
                                   "around",
                                   "crossing",
                                   "quartet",
                                   "laps",
                                   "pan",
                                   "parked20",
                                   "parked65",
                                   "parked110",
                                   "parked155"));
  EXPECT_THAT(
      SequenceNames("aerial"),
      testing::ElementsAre("mapping", "bank", "overhead", "circle", "flyover"));
  EXPECT_TRUE(SequenceNames("moon").empty());
  SimulationOptions options = Small("flight", 1);
  EXPECT_THAT(std::string(options.Validate().message()),
              HasSubstr("mapping, occlusion, srun, scale, outofview, "
                        "return, around"));
  options = Small("srun", 1);
  options.scene = "moon";
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("yard"));
  options = Small("srun", 1);
  options.fps = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("fps"));
  options = Small("srun", 1);
  options.width_px = 321;
  EXPECT_FALSE(options.Validate().ok());
  EXPECT_EQ(Simulate(Small("srun", 100'000), nullptr).status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST_F(SimulatorTest, SameOptionsSameOutputWhateverTheThreads) {
  SimulationOptions options = Small("occlusion", 3);
  const auto report = Simulate(options, nullptr);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->frames, 3);
  EXPECT_EQ(report->init_frame, 0);
  options.output = folder_.path() / "b";
  options.threads = 1;
  ASSERT_TRUE(Simulate(options, nullptr).ok());
  for (const fs::path& file : report->files) {
    EXPECT_EQ(Content(file), Content(folder_.path() / "b" / file.filename()))
        << file;
  }
  options.seed = 2;
  ASSERT_TRUE(Simulate(options, nullptr).ok());
  EXPECT_NE(Content(folder_.path() / "a" / "occlusion.mp4"),
            Content(folder_.path() / "b" / "occlusion.mp4"));
}

TEST_F(SimulatorTest, VideoTruthAndLensBelongTogether) {
  const auto report = Simulate(Small("scale", 4), nullptr);
  ASSERT_TRUE(report.ok()) << report.status();
  const fs::path folder = folder_.path() / "a";
  cv::VideoCapture video((folder / "scale.mp4").string());
  ASSERT_TRUE(video.isOpened());
  EXPECT_NEAR(video.get(cv::CAP_PROP_FPS), 24.0, 1e-6);
  int frames = 0;
  for (cv::Mat frame; video.read(frame); ++frames) {
    EXPECT_EQ(frame.size(), cv::Size(320, 180));
  }
  EXPECT_EQ(frames, 4);
  std::istringstream truth(Content(folder / "scale_truth.csv"));
  std::string line;
  std::set<std::ptrdiff_t> commas;
  int lines = 0;
  for (; std::getline(truth, line); ++lines) {
    commas.insert(std::count(line.begin(), line.end(), ','));
  }
  EXPECT_EQ(lines, 5);
  // 32 columns in every line, header included.
  EXPECT_EQ(commas, std::set<std::ptrdiff_t>{31});
  const auto camera =
      geometry::CameraModelFromJson(Content(folder / "camera.json"));
  ASSERT_TRUE(camera.ok()) << camera.status();
  EXPECT_EQ(camera->width_px(), 320);
  EXPECT_NEAR(camera->mean_focal_px(), 262.5, 1e-9);  // 1050 / 4
}

// Each of the four has its truth and its box, for all are wholly seen in the
// first frame; later, near ones hide most of far ones.
TEST_F(SimulatorTest, CarsOfAQuartetHideEachOther) {
  SimulationOptions options = Small("quartet", 0);
  options.width_px = 160;
  options.height_px = 90;
  options.fps = 6.0;
  const auto report = Simulate(options, nullptr);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->hidden_frames, 0);
  EXPECT_EQ(report->unseen_frames, 0);
  const fs::path folder = folder_.path() / "a";
  int mostly_hidden = 0;  // cars
  std::set<std::string> boxes;
  std::set<std::string> truths;
  for (const char* car : {"", "_other", "_other2", "_other3"}) {
    const std::string name = absl::StrCat("quartet", car);
    boxes.insert(Content(folder / (name + "_init_box.txt")));
    const std::string truth = Content(folder / (name + "_truth.csv"));
    truths.insert(truth);
    std::istringstream table(truth);
    std::string line;
    std::getline(table, line);
    double least_seen = 1.0;
    int rows = 0;
    for (; std::getline(table, line); ++rows) {
      // ..., visible_fraction, inframe_fraction, seen_fraction, in_view
      const std::vector<std::string> cells = absl::StrSplit(line, ',');
      ASSERT_EQ(cells.size(), 32U);
      EXPECT_EQ(std::stod(cells[29]), 1.0) << "leaves the picture: " << line;
      least_seen = std::min(least_seen, std::stod(cells[28]));
    }
    EXPECT_EQ(rows, report->frames);
    EXPECT_GT(least_seen, 0.02) << name;
    mostly_hidden += least_seen < 0.5 ? 1 : 0;
  }
  EXPECT_EQ(boxes.size(), 4U);
  EXPECT_EQ(truths.size(), 4U);
  EXPECT_GE(mostly_hidden, 1);
}

// The unit's own axes, its noise and its bias: what is left of a turn that it
// integrated is what these explain.
TEST_F(SimulatorTest, TheInertialUnitTurnsAsTheCameraDoes) {
  ASSERT_TRUE(Simulate(Small("pan", 30), nullptr).ok());
  const fs::path folder = folder_.path() / "a";
  const auto imu = cli::ReadImu(folder / "imu.json");
  ASSERT_TRUE(imu.ok()) << imu.status();
  const auto samples = cli::ReadInertial(folder / "pan_imu.csv");
  ASSERT_TRUE(samples.ok()) << samples.status();
  std::vector<Eigen::Quaterniond> truth;
  std::istringstream table(Content(folder / "pan_truth.csv"));
  std::string line;
  std::getline(table, line);
  ASSERT_THAT(line, testing::StartsWith("frame,t_s,cam_x,cam_y,cam_z,q_w"));
  while (std::getline(table, line)) {
    std::istringstream cells(line);
    std::vector<double> values;
    for (std::string cell;
         values.size() < 9 && std::getline(cells, cell, ',');) {
      values.push_back(std::stod(cell));
    }
    truth.emplace_back(values[5], values[6], values[7], values[8]);
  }
  ASSERT_EQ(truth.size(), 30U);
  // From the first frame to the last, 29/24 s later: the bias, 0.05 rad/s about
  // each axis, is the largest of what is off.
  Eigen::Quaterniond turned = Eigen::Quaterniond::Identity();
  for (std::size_t i = 0; i + 1 < samples->size(); ++i) {
    const double end_s =
        std::min(1e-9 * samples->at(i + 1).time.count(), 29.0 / 24.0);
    const double dt_s = end_s - 1e-9 * samples->at(i).time.count();
    if (dt_s <= 0.0) break;
    const Eigen::Vector3d rate =
        imu->imu_from_camera.conjugate() *
        (0.5 * (samples->at(i).angular_rate_rad_s +
                samples->at(i + 1).angular_rate_rad_s));
    turned = turned * geometry::QuaternionFromRotationVector(dt_s * rate);
  }
  const double whole_rad =
      geometry::AngleBetween_rad(truth.front(), truth.back());
  const double off_rad = geometry::AngleBetween_rad(
      turned, truth.front().conjugate() * truth.back());
  EXPECT_GT(whole_rad, 0.5);
  EXPECT_LT(off_rad, 0.25);
  EXPECT_GT(off_rad, 0.005) << "no unit is as good as that";
  // Held upright, it feels gravity upwards.
  EXPECT_NEAR(samples->front().acceleration_m_s2.norm(), 9.8, 1.5);
  EXPECT_GT(samples->front().acceleration_m_s2.z(), 8.0);
}

TEST_F(SimulatorTest, CancelLeavesNoHalfVideo) {
  int calls = 0;
  const auto report =
      Simulate(Small("srun", 5), [&](const SimulationProgress& progress) {
        return progress.stage != "frames" || ++calls < 2;
      });
  EXPECT_EQ(report.status().code(), absl::StatusCode::kCancelled);
  for (const auto& entry : fs::directory_iterator(folder_.path() / "a")) {
    EXPECT_EQ(entry.path().filename(), "camera.json");
  }
}

TEST_F(SimulatorTest, MapIsAColmapModelThatImports) {
  SimulationOptions options = Small("mapping", 7);
  options.width_px = 640;
  options.height_px = 360;
  const auto report = Simulate(options, nullptr);
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_GT(report->num_landmarks, 200U);
  EXPECT_LT(report->mean_reprojection_error_px, 1.0);
  std::vector<std::string> warnings;
  auto data = formats::Import(folder_.path() / "a" / "map", {}, &warnings);
  ASSERT_TRUE(data.ok()) << data.status();
  EXPECT_EQ(data->views.size(), 7U);
  EXPECT_EQ(data->landmarks.size(), report->num_landmarks);
  EXPECT_TRUE(data->has_descriptors());
  const map::ReprojectionStatistics statistics =
      map::ComputeReprojection(*data);
  EXPECT_EQ(statistics.num_observations, report->num_observations);
  EXPECT_EQ(statistics.num_behind_camera, 0U);
  // The model is written in another frame and scale, in doubles.
  EXPECT_NEAR(
      statistics.mean_error_px, report->mean_reprojection_error_px, 0.01);
  std::ifstream table(folder_.path() / "a" / "mapping_truth.csv");
  std::string header;
  std::getline(table, header);
  EXPECT_EQ(header, "frame,t_s,cam_x,cam_y,cam_z,q_w,q_x,q_y,q_z");
}

}  // namespace
}  // namespace groundlock::simulator
