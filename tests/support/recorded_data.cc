// SPDX-License-Identifier: Apache-2.0
#include "tests/support/recorded_data.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/formats.h"
#include "tests/support/perturbation.h"

namespace groundlock::test_support {
namespace {

constexpr std::size_t kMaxTextBytes = 1 << 20;

double Seconds(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * time.tv_nsec;
}

}  // namespace

std::filesystem::path DataFolder() {
  const char* folder = std::getenv("GROUNDLOCK_DATA");
  return folder != nullptr ? folder : "../shared/data";
}

absl::StatusOr<geometry::Similarity3> ReadAlignment(
    const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(path, kMaxTextBytes));
  const auto json = nlohmann::json::parse(text);
  const auto q = json.at("rotation_wxyz").get<std::array<double, 4>>();
  const auto t = json.at("translation").get<std::array<double, 3>>();
  return geometry::Similarity3{
      json.at("scale").get<double>(),
      Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized(),
      {t[0], t[1], t[2]}};
}

absl::StatusOr<map::MapData> ImportData(
    const std::filesystem::path& reconstruction,
    const std::filesystem::path& align) {
  std::vector<std::string> warnings;
  ASSIGN_OR_RETURN(map::MapData data,
                   formats::Import(reconstruction, {}, &warnings));
  if (align.empty()) {
    RETURN_IF_ERROR(map::AlignToEstimatedGround(1, data).status());
  } else {
    ASSIGN_OR_RETURN(const auto alignment, ReadAlignment(align));
    RETURN_IF_ERROR(map::AlignToWorld(alignment, data));
  }
  return data;
}

absl::StatusOr<std::shared_ptr<const map::Map>> WriteAndOpen(
    const map::MapData& data) {
  ASSIGN_OR_RETURN(
      const auto directory,
      base::TemporaryDirectory::Create(std::filesystem::temp_directory_path()));
  const std::filesystem::path path = directory.path() / "map";
  RETURN_IF_ERROR(map::WriteMapFile(data, path));
  return map::Map::Open(path);
}

absl::StatusOr<std::shared_ptr<const map::Map>> ImportMap(
    const std::filesystem::path& reconstruction,
    const std::filesystem::path& align) {
  ASSIGN_OR_RETURN(const map::MapData data, ImportData(reconstruction, align));
  return WriteAndOpen(data);
}

absl::StatusOr<geometry::CameraModel> ReadCamera(
    const std::filesystem::path& camera_json) {
  ASSIGN_OR_RETURN(const std::string json,
                   base::ReadFile(camera_json, kMaxTextBytes));
  return geometry::CameraModelFromJson(json);
}

absl::StatusOr<std::map<int, TrueFrame>> ReadTrueFrames(
    const std::filesystem::path& csv) {
  std::ifstream file(csv);
  if (!file) return absl::NotFoundError(csv.string() + ": cannot open");
  std::map<int, TrueFrame> frames;
  std::vector<std::string> names;
  for (std::string line; std::getline(file, line);) {
    std::vector<std::string> cells;
    std::istringstream stream(line);
    for (std::string cell; std::getline(stream, cell, ',');) {
      cells.push_back(cell);
    }
    if (names.empty()) {
      names = cells;
      continue;
    }
    std::map<std::string, double> row;
    for (std::size_t i = 0; i < std::min(cells.size(), names.size()); ++i) {
      if (!cells[i].empty()) {
        row[names[i]] = std::strtod(cells[i].c_str(), nullptr);
      }
    }
    if (!row.contains("frame") || !row.contains("cam_x") ||
        !row.contains("q_w")) {
      return absl::InvalidArgumentError(
          absl::StrCat(csv.string(), ": no frame, cam_* and q_* columns"));
    }
    TrueFrame& frame = frames[static_cast<int>(row["frame"])];
    frame.world_from_camera = {
        Eigen::Quaterniond(row["q_w"], row["q_x"], row["q_y"], row["q_z"])
            .normalized(),
        {row["cam_x"], row["cam_y"], row["cam_z"]}};
    if (row.contains("vis_x")) {
      frame.target_px = geometry::Box2::FromXywh(
          row["vis_x"], row["vis_y"], row["vis_w"], row["vis_h"]);
    }
  }
  return frames;
}

absl::StatusOr<Sequence> FindSequence(const std::string& name) {
  const std::filesystem::path data = DataFolder();
  Sequence sequence;
  sequence.name = name;
  if (name == "plaza") {
    const std::filesystem::path plaza = data / "plaza";
    sequence.video = plaza / "person12.mp4";
    sequence.camera = plaza / "camera.json";
    sequence.truth = plaza / "person12_reference.csv";
    sequence.reconstruction = plaza / "map";
    sequence.frames_per_second = 10.0;
  } else if (name == "srun" || name == "scale" || name == "outofview" ||
             name == "occlusion") {
    const std::filesystem::path lot = data / "sim" / "lot";
    sequence.video = lot / (name + ".mp4");
    sequence.camera = lot / "camera.json";
    sequence.truth = lot / (name + "_truth.csv");
    sequence.reconstruction = lot / "map";
    sequence.align = lot / "align.json";
  } else {
    return absl::NotFoundError(
        absl::StrCat("no sequence '",
                     name,
                     "'; there are srun, scale, outofview, occlusion, plaza"));
  }
  if (!std::filesystem::exists(sequence.video)) {
    return absl::NotFoundError(sequence.video.string() +
                               " is not there; set GROUNDLOCK_DATA");
  }
  return sequence;
}

absl::StatusOr<std::map<int, cv::Mat>> ReadFrames(
    const std::filesystem::path& video, int stride, int max_frames) {
  cv::VideoCapture capture(video.string());
  if (!capture.isOpened()) {
    return absl::NotFoundError(video.string() + ": cannot open");
  }
  std::map<int, cv::Mat> frames;
  for (int i = 0; static_cast<int>(frames.size()) < max_frames; ++i) {
    if (!capture.grab()) break;
    if (i % stride != 0) continue;
    cv::Mat bgr;
    capture.retrieve(bgr);
    frames[i] = Perturbed(bgr).clone();
  }
  return frames;
}

std::vector<std::uint8_t> EncodeJpeg(const cv::Mat& image, int quality) {
  std::vector<std::uint8_t> bytes;
  cv::imencode(".jpg", image, bytes, {cv::IMWRITE_JPEG_QUALITY, quality});
  return bytes;
}

geometry::Rigid3 WorldFromSourcePose(
    const map::Map& map, const geometry::Rigid3& source_from_camera) {
  return geometry::TransformCameraFromWorld(map.info().world_from_source,
                                            source_from_camera.Inverse())
      .Inverse();
}

double Quantile(std::vector<double> values, double q) {
  if (values.empty()) return std::nan("");
  const auto rank = static_cast<std::size_t>(
      std::lround(q * static_cast<double>(values.size() - 1)));
  std::nth_element(values.begin(), values.begin() + rank, values.end());
  return values[rank];
}

std::string Quantiles(const std::vector<double>& values) {
  return absl::StrFormat("median %8.3f  p95 %8.3f  p99 %8.3f  max %8.3f",
                         Quantile(values, 0.5),
                         Quantile(values, 0.95),
                         Quantile(values, 0.99),
                         Quantile(values, 1.0));
}

double ThreadCpuSeconds() { return Seconds(CLOCK_THREAD_CPUTIME_ID); }

}  // namespace groundlock::test_support
