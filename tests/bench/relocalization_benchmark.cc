// SPDX-License-Identifier: Apache-2.0
// How surely, how fast and how well a camera is found in a map from one frame,
// without a prior: a fresh localiser for every stride-th frame of sequences;
// where that frame does not do, it gets the ones after it.
//   relocalization_benchmark [SEQUENCE…] [--stride N] [--frames N] [--covered]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "server/localization/localizer.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

using test_support::Quantiles;

// What a user takes for at once.
constexpr double kSlow_ms = 400.0;

struct Tally {
  int frames = 0;
  int localized = 0;
  int slow = 0;  // more than two frames, or more than kSlow_ms
  std::vector<double> wall_ms, cpu_ms, looks, inliers, center, angle_deg;

  void Print(const std::string& name, const char* unit) const {
    std::printf("%s: localised %d of %d (%.2f %%)\n",
                name.c_str(),
                localized,
                frames,
                100.0 * localized / std::max(1, frames));
    std::printf(
        "  more than two frames or %.0f ms of CPU: %d\n", kSlow_ms, slow);
    std::printf("  frames        %s\n", Quantiles(looks).c_str());
    std::printf("  time, ms      %s\n", Quantiles(wall_ms).c_str());
    std::printf("  CPU, ms       %s\n", Quantiles(cpu_ms).c_str());
    std::printf("  inliers       %s\n", Quantiles(inliers).c_str());
    std::printf("  centre, %-5s %s\n", unit, Quantiles(center).c_str());
    std::printf("  angle, deg    %s\n", Quantiles(angle_deg).c_str());
  }
};

struct Arguments {
  std::vector<std::string> sequences = {
      "srun", "scale", "outofview", "occlusion", "plaza"};
  int stride = 4;
  int frames = 1;
  bool covered = false;
  bool misses = false;
};

// Pictures of moving things, none of them in a map.
absl::StatusOr<std::vector<cv::Mat>> ReadTargets() {
  std::vector<std::filesystem::path> paths;
  const std::filesystem::path folder = test_support::DataFolder() / "sot";
  if (std::filesystem::is_directory(folder)) {
    for (const auto& entry :
         std::filesystem::recursive_directory_iterator(folder)) {
      if (entry.path().extension() == ".jpg") paths.push_back(entry.path());
    }
  }
  std::sort(paths.begin(), paths.end());
  std::vector<cv::Mat> targets;
  for (std::size_t i = 0; i < paths.size(); i += 50) {
    targets.push_back(cv::imread(paths[i].string()));
  }
  if (targets.empty()) return absl::NotFoundError(folder.string());
  return targets;
}

// Something large and near hides the middle third.
cv::Mat Covered(const cv::Mat& image, const cv::Mat& target) {
  cv::Mat covered = image.clone();
  const double side = std::sqrt(1.0 / 3.0);
  const cv::Size size(static_cast<int>(side * image.cols),
                      static_cast<int>(side * image.rows));
  const cv::Rect middle(
      {(image.cols - size.width) / 2, (image.rows - size.height) / 2}, size);
  cv::resize(target, covered(middle), size, 0.0, 0.0, cv::INTER_CUBIC);
  return covered;
}

// Looks at the frames from `first` on until there is a pose.
absl::Status Start(
    localization::Localizer& localizer,
    const std::map<int, cv::Mat>& images,
    const Arguments& arguments,
    const std::vector<cv::Mat>& targets,
    const geometry::CameraModel& camera,
    double frames_per_second,
    int first,
    Tally& tally,
    std::optional<std::pair<int, localization::LocalizationResult>>& found) {
  const auto start = std::chrono::steady_clock::now();
  double cpu_s = 0.0;
  int looks = 0;
  for (auto it = images.find(first);
       it != images.end() && looks < arguments.frames && !found;
       ++it) {
    image::Frame frame = image::Frame::FromBgr(
        targets.empty()
            ? it->second
            : Covered(
                  it->second,
                  targets[static_cast<std::size_t>(first) % targets.size()]));
    frame.sequence = static_cast<std::uint64_t>(it->first);
    frame.capture_time = std::chrono::nanoseconds(
        static_cast<std::int64_t>(1e9 * it->first / frames_per_second));
    const double cpu_start = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(auto result, localizer.Localize({&frame, camera, {}}));
    cpu_s += test_support::ThreadCpuSeconds() - cpu_start;
    ++looks;
    if (result.state == localization::CameraState::kTracked) {
      found.emplace(it->first, std::move(result));
    }
  }
  tally.wall_ms.push_back(std::chrono::duration<double, std::milli>(
                              std::chrono::steady_clock::now() - start)
                              .count());
  tally.cpu_ms.push_back(1e3 * cpu_s);
  tally.looks.push_back(looks);
  ++tally.frames;
  const bool is_slow = !found || looks > 2 || 1e3 * cpu_s > kSlow_ms;
  tally.slow += is_slow ? 1 : 0;
  if (is_slow && arguments.misses) {
    std::printf("  from frame %d: %s after %d frames, %.0f ms\n",
                first,
                found ? "found" : "missed",
                looks,
                1e3 * cpu_s);
  }
  return absl::OkStatus();
}

absl::Status Measure(const std::string& name, const Arguments& arguments) {
  ASSIGN_OR_RETURN(const auto sequence, test_support::FindSequence(name));
  ASSIGN_OR_RETURN(
      const auto map,
      test_support::ImportMap(sequence.reconstruction, sequence.align));
  ASSIGN_OR_RETURN(const auto camera,
                   test_support::ReadCamera(sequence.camera));
  ASSIGN_OR_RETURN(const auto truth,
                   test_support::ReadTrueFrames(sequence.truth));
  ASSIGN_OR_RETURN(
      const auto images,
      test_support::ReadFrames(sequence.video,
                               arguments.frames > 1 ? 1 : arguments.stride));
  std::vector<cv::Mat> targets;
  if (arguments.covered) {
    ASSIGN_OR_RETURN(targets, ReadTargets());
  }
  const bool metric = map->info().metric;
  Tally tally;
  for (const auto& [first, image] : images) {
    if (first % arguments.stride != 0) continue;
    ASSIGN_OR_RETURN(
        const auto localizer,
        localization::CreateLocalizer(
            "fast", map, {.is_single_frame = arguments.frames == 1}));
    std::optional<std::pair<int, localization::LocalizationResult>> found;
    RETURN_IF_ERROR(Start(*localizer,
                          images,
                          arguments,
                          targets,
                          camera,
                          sequence.frames_per_second,
                          first,
                          tally,
                          found));
    if (!found) continue;
    const auto& [index, result] = *found;
    ++tally.localized;
    tally.inliers.push_back(result.num_inliers);
    const auto known = truth.find(index);
    if (known == truth.end()) continue;
    geometry::Rigid3 expected = known->second.world_from_camera;
    if (sequence.align.empty()) {
      expected = test_support::WorldFromSourcePose(*map, expected);
    }
    tally.center.push_back(
        (metric ? 100.0 : 1.0) *
        (expected.translation - result.world_from_camera->translation).norm());
    tally.angle_deg.push_back(
        geometry::AngleBetween_rad(expected.rotation,
                                   result.world_from_camera->rotation) *
        180.0 / M_PI);
  }
  tally.Print(name, metric ? "cm" : "units");
  return absl::OkStatus();
}

absl::Status Run(const Arguments& arguments) {
  for (const std::string& name : arguments.sequences) {
    RETURN_IF_ERROR(Measure(name, arguments));
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) {
  groundlock::features::SetUpOpenCv();
  groundlock::bench::Arguments arguments;
  CLI::App app("Finds the camera from single frames, without a prior");
  app.add_option("sequences", arguments.sequences);
  app.add_option("--stride", arguments.stride)->check(CLI::PositiveNumber);
  app.add_option(
         "--frames", arguments.frames, "frames that a start may take [1]")
      ->check(CLI::PositiveNumber);
  app.add_flag("--covered",
               arguments.covered,
               "something that is not in the map hides a third of the image");
  app.add_flag(
      "--misses", arguments.misses, "name starts that fail or take long");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = groundlock::bench::Run(arguments);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
