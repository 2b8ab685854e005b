// SPDX-License-Identifier: Apache-2.0
// How surely, how fast and how well a camera is found in a map from one frame,
// without a prior: a fresh localiser for every stride-th frame of sequences.
//   relocalization_benchmark [SEQUENCE…] [--stride N] [--misses]
#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "server/localization/localizer.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

using test_support::Quantiles;

struct Tally {
  int frames = 0;
  int localized = 0;
  std::vector<double> wall_ms, cpu_ms, inliers, center, angle_deg;

  void Print(const std::string& name, const char* unit) const {
    std::printf("%s: localised %d of %d (%.2f %%)\n",
                name.c_str(),
                localized,
                frames,
                100.0 * localized / std::max(1, frames));
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
  bool misses = false;
};

absl::Status Measure(const std::string& name, const Arguments& arguments) {
  ASSIGN_OR_RETURN(const auto sequence, test_support::FindSequence(name));
  ASSIGN_OR_RETURN(
      const auto map,
      test_support::ImportMap(sequence.reconstruction, sequence.align));
  ASSIGN_OR_RETURN(const auto camera,
                   test_support::ReadCamera(sequence.camera));
  ASSIGN_OR_RETURN(const auto truth,
                   test_support::ReadTrueFrames(sequence.truth));
  ASSIGN_OR_RETURN(const auto images,
                   test_support::ReadFrames(sequence.video, arguments.stride));
  const bool metric = map->info().metric;
  Tally tally;
  for (const auto& [index, image] : images) {
    image::Frame frame = image::Frame::FromBgr(image);
    frame.sequence = static_cast<std::uint64_t>(index);
    ASSIGN_OR_RETURN(const auto localizer,
                     localization::CreateLocalizer("fast", map, {}));
    const auto start = std::chrono::steady_clock::now();
    const double cpu_start = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(const auto result,
                     localizer->Localize({&frame, camera, {}}));
    tally.wall_ms.push_back(std::chrono::duration<double, std::milli>(
                                std::chrono::steady_clock::now() - start)
                                .count());
    tally.cpu_ms.push_back(1e3 *
                           (test_support::ThreadCpuSeconds() - cpu_start));
    ++tally.frames;
    if (result.state != localization::CameraState::kTracked) {
      if (arguments.misses) std::printf("  missed frame %d\n", index);
      continue;
    }
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
  app.add_flag("--misses", arguments.misses, "name frames that are not found");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = groundlock::bench::Run(arguments);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
