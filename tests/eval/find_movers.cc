// SPDX-License-Identifier: Apache-2.0
// What moves by itself in a video, by a session of the server's own in this
// process: a map file (or a reconstruction), a video, nothing marked. Writes
// the columns of `groundlock track --movers`; prints the processor time that
// looking for movers adds to: compare with --without.
#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <opencv2/videoio.hpp>

#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "map_store/geometry/camera_model.h"
#include "server/tracking/tracking_session.h"
#include "tests/eval/sequence_csv.h"
#include "tests/support/recorded_data.h"

namespace groundlock::eval {
namespace {

struct Arguments {
  std::string map;
  std::string align;
  std::string camera;
  std::string video;
  std::string movers;
  double fps = 0.0;
  int max_frames = 1 << 30;
  bool without = false;
};

absl::Status Run(const Arguments& arguments) {
  std::shared_ptr<const map::Map> map;
  if (std::filesystem::is_directory(arguments.map)) {
    ASSIGN_OR_RETURN(map,
                     test_support::ImportMap(arguments.map, arguments.align));
  } else {
    ASSIGN_OR_RETURN(map, map::Map::Open(arguments.map));
  }
  cv::VideoCapture video(arguments.video);
  if (!video.isOpened()) {
    return absl::NotFoundError(arguments.video + ": cannot open");
  }
  std::optional<geometry::CameraModel> camera = map->info().lens;
  if (!arguments.camera.empty()) {
    ASSIGN_OR_RETURN(camera, test_support::ReadCamera(arguments.camera));
  }
  if (!camera) return absl::InvalidArgumentError("the map has no lens");
  camera = geometry::ScaledToFit(
      *camera,
      static_cast<int>(video.get(cv::CAP_PROP_FRAME_WIDTH)),
      static_cast<int>(video.get(cv::CAP_PROP_FRAME_HEIGHT)));
  if (!camera) return absl::InvalidArgumentError("the lens is of other frames");
  tracking::SessionOptions options;
  options.report_movers = !arguments.without;
  ASSIGN_OR_RETURN(auto session,
                   tracking::TrackingSession::Create(map, *camera, options));
  std::ofstream out(arguments.movers);
  WriteMoversHeader(out);
  const double fps =
      arguments.fps > 0.0 ? arguments.fps : video.get(cv::CAP_PROP_FPS);
  cv::Mat image;
  std::vector<double> times_ms;
  for (int i = 0; i < arguments.max_frames && video.read(image); ++i) {
    ASSIGN_OR_RETURN(
        image::Frame frame,
        image::DecodeImage({.bytes = test_support::EncodeJpeg(image)}, {}));
    frame.sequence = static_cast<std::uint64_t>(i);
    frame.capture_time = std::chrono::nanoseconds(std::llround(1e9 * i / fps));
    std::vector<absl::Status> target_errors;
    const double start_s = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(
        const tracking::FrameResult result,
        session->ProcessFrame(frame, std::nullopt, &target_errors));
    times_ms.push_back(1e3 * (test_support::ThreadCpuSeconds() - start_s));
    WriteMovers(out, result);
  }
  std::printf("CPU ms per frame: %s\n",
              test_support::Quantiles(times_ms).c_str());
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::eval

int main(int argc, char** argv) {
  groundlock::eval::Arguments arguments;
  CLI::App app("Finds what moves by itself in a video");
  app.add_option("map", arguments.map, "map file, or reconstruction")
      ->required();
  app.add_option("video", arguments.video)->required();
  app.add_option("movers", arguments.movers, "CSV to write")->required();
  app.add_option("--camera", arguments.camera, "camera.json [the map's lens]");
  app.add_option("--align", arguments.align, "the reconstruction's align.json");
  app.add_option("--fps", arguments.fps, "[the video's]");
  app.add_option("--frames", arguments.max_frames, "at most");
  app.add_flag("--without", arguments.without, "looks for none, to compare");
  CLI11_PARSE(app, argc, argv);
  groundlock::features::SetUpOpenCv();
  const absl::Status status = groundlock::eval::Run(arguments);
  if (!status.ok()) std::cerr << status << '\n';
  return status.ok() ? 0 : 1;
}
