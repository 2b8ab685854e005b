// SPDX-License-Identifier: Apache-2.0
// A tracking session on a rendered sequence whose camera poses are the true
// ones in place of a localizer's: the 2D tracker, the ground model and the
// control logic without the cost and the errors of localisation. Frames come as
// JPEG, as a client sends them; prints the processor time of their tracking.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <opencv2/videoio.hpp>
#include <utility>

#include "client/cli/evaluate/truth_csv.h"
#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "map_store/geometry/camera_model.h"
#include "server/tracking/tracking_session.h"
#include "tests/eval/sequence_csv.h"
#include "tests/support/recorded_data.h"

namespace groundlock::eval {
namespace {

class TruthLocalizer : public localization::Localizer {
 public:
  explicit TruthLocalizer(const std::vector<cli::TruthRow>* truth)
      : truth_(truth) {}

  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest& request) override {
    localization::LocalizationResult result;
    for (const cli::TruthRow& row : *truth_) {
      if (static_cast<std::uint64_t>(row.frame) != request.frame->sequence) {
        continue;
      }
      result.state = localization::CameraState::kTracked;
      result.world_from_camera = row.world_from_camera;
    }
    return result;
  }
  void Reset() override {}

 private:
  const std::vector<cli::TruthRow>* truth_;
};

struct Arguments {
  std::string camera;
  std::string video;
  std::vector<std::string> truths;
  std::string results;
  std::string map;
  std::string align;
  std::string movers;
  bool without_targets = false;
  tracking::SessionOptions options;
  bool hurried = false;
};

absl::Status Run(const Arguments& arguments) {
  const tracking::SessionOptions& options = arguments.options;
  ASSIGN_OR_RETURN(const geometry::CameraModel camera,
                   test_support::ReadCamera(arguments.camera));
  cv::VideoCapture video(arguments.video);
  if (!video.isOpened()) {
    return absl::NotFoundError(arguments.video + ": cannot open");
  }
  std::vector<std::vector<cli::TruthRow>> truths;
  for (const std::string& path : arguments.truths) {
    ASSIGN_OR_RETURN(truths.emplace_back(), cli::ReadTruth(path));
    if (truths.back().size() != truths.front().size()) {
      return absl::InvalidArgumentError(path + ": of another length");
    }
  }
  const std::vector<cli::TruthRow>& truth = truths.front();
  std::ofstream out(arguments.results);
  std::shared_ptr<const map::Map> map;
  if (!arguments.map.empty()) {
    ASSIGN_OR_RETURN(map,
                     test_support::ImportMap(arguments.map, arguments.align));
  }
  // Level ground where the map says nothing else.
  auto ground = map != nullptr && !map->ground_relief().empty()
                    ? ground::SurfaceOf(*map)
                    : ground::MakePlaneSurface({});
  ASSIGN_OR_RETURN(auto session,
                   tracking::TrackingSession::Create(
                       std::make_unique<TruthLocalizer>(&truth),
                       std::move(ground),
                       camera,
                       options,
                       std::move(map)));
  session->SetHurried(arguments.hurried);
  WriteResultsHeader(out);
  std::ofstream movers;
  if (!arguments.movers.empty()) {
    movers.open(arguments.movers);
    WriteMoversHeader(movers);
  }
  std::vector<bool> started(truths.size(), false);
  cv::Mat image;
  std::vector<double> times_ms;
  std::vector<double> movers_ms;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const cli::TruthRow& row = truth[i];
    if (!video.read(image)) {
      return absl::DataLossError("the video ends before the truth does");
    }
    ASSIGN_OR_RETURN(
        image::Frame frame,
        image::DecodeImage({.bytes = test_support::EncodeJpeg(image)}, {}));
    frame.sequence = static_cast<std::uint64_t>(row.frame);
    frame.capture_time = row.time;
    for (std::size_t target = 0; target < truths.size(); ++target) {
      const auto& box_px = truths[target][i].visible_box_px;
      if (started[target] || !box_px || arguments.without_targets) continue;
      RETURN_IF_ERROR(
          session->SetTarget(std::to_string(target + 1), *box_px, {}));
      started[target] = true;
    }
    std::vector<absl::Status> target_errors;
    const double start_s = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(
        const tracking::FrameResult result,
        session->ProcessFrame(frame, std::nullopt, &target_errors));
    times_ms.push_back(1e3 * (test_support::ThreadCpuSeconds() - start_s));
    for (const absl::Status& error : target_errors) std::cerr << error << '\n';
    WriteResults(out, result);
    if (movers.is_open()) WriteMovers(movers, result);
    movers_ms.push_back(
        std::chrono::duration<double, std::milli>(result.times.movers).count());
  }
  std::printf("CPU ms per frame: %s\n",
              test_support::Quantiles(times_ms).c_str());
  if (movers.is_open()) {
    std::printf("of it, wall, looking for movers: %s\n",
                test_support::Quantiles(movers_ms).c_str());
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::eval

int main(int argc, char** argv) {
  groundlock::eval::Arguments arguments;
  CLI::App app("Tracks targets through a rendered sequence, the camera known");
  std::string first;
  app.add_option("camera", arguments.camera, "camera.json")->required();
  app.add_option("video", arguments.video)->required();
  app.add_option("truth", first, "CSV, target 1")->required();
  app.add_option("results", arguments.results, "CSV to write")->required();
  arguments.options.tracker.name = "dcf";  // as the server's default
  app.add_option("--tracker", arguments.options.tracker.name);
  app.add_option("--views", arguments.options.max_views);
  app.add_option("--map", arguments.map, "reconstruction: what hides targets");
  app.add_option("--align", arguments.align, "the map's align.json");
  std::string second;
  app.add_option("--second", second, "truth of target 2, CSV");
  bool without = false;
  app.add_flag("--without-occlusion", without, "no reasoning about it");
  bool without_bodies = false;
  app.add_flag(
      "--without-bodies", without_bodies, "no points of bodies at rest");
  app.add_flag("--hurried", arguments.hurried, "as if frames waited");
  app.add_option("--movers", arguments.movers, "what else moves, CSV to write");
  app.add_flag("--without-targets",
               arguments.without_targets,
               "nothing is marked: what the truth names moves by itself, too");
  CLI11_PARSE(app, argc, argv);
  arguments.truths.push_back(first);
  if (!second.empty()) arguments.truths.push_back(second);
  arguments.options.reason_about_occlusion = !without;
  arguments.options.report_movers = !arguments.movers.empty();
  arguments.options.follow_bodies = !without_bodies;
  groundlock::features::SetUpOpenCv();
  const absl::Status status = groundlock::eval::Run(arguments);
  if (!status.ok()) std::cerr << status << '\n';
  return status.ok() ? 0 : 1;
}
