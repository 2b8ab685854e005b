// SPDX-License-Identifier: Apache-2.0
// A tracking session on a rendered sequence whose camera poses are the true
// ones in place of a localizer's: the 2D tracker, the ground model and the
// control logic without the cost and the errors of localisation. Frames come as
// JPEG, as a client sends them; prints the processor time of their tracking.
//   usage: track_with_truth CAMERA.json VIDEO TRUTH.csv RESULTS.csv [TRACKER
//          [VIEWS]]
#include <cstdio>
#include <fstream>
#include <iostream>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <opencv2/videoio.hpp>
#include <utility>

#include "absl/strings/numbers.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/geometry/camera_model.h"
#include "server/tracking/tracking_session.h"
#include "tests/eval/sequence_csv.h"
#include "tests/support/recorded_data.h"

namespace groundlock::eval {
namespace {

class TruthLocalizer : public localization::Localizer {
 public:
  explicit TruthLocalizer(const std::vector<TruthRow>* truth) : truth_(truth) {}

  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest& request) override {
    localization::LocalizationResult result;
    for (const TruthRow& row : *truth_) {
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
  const std::vector<TruthRow>* truth_;
};

absl::Status Run(int argc, char** argv) {
  ASSIGN_OR_RETURN(const std::string json, base::ReadFile(argv[1], 1 << 20));
  ASSIGN_OR_RETURN(const geometry::CameraModel camera,
                   geometry::CameraModelFromJson(json));
  cv::VideoCapture video(argv[2]);
  if (!video.isOpened()) {
    return absl::NotFoundError(std::string(argv[2]) + ": cannot open");
  }
  ASSIGN_OR_RETURN(const std::vector<TruthRow> truth, ReadTruth(argv[3]));
  std::ofstream out(argv[4]);
  tracking::SessionOptions options;
  if (argc > 5) options.tracker.name = argv[5];
  if (argc > 6 && !absl::SimpleAtoi(argv[6], &options.max_views)) {
    return absl::InvalidArgumentError("VIEWS is no number");
  }
  const geometry::Plane ground_world;
  ASSIGN_OR_RETURN(auto session,
                   tracking::TrackingSession::Create(
                       std::make_unique<TruthLocalizer>(&truth),
                       ground_world,
                       camera,
                       options));
  WriteResultsHeader(out);
  bool started = false;
  cv::Mat image;
  std::vector<double> times_ms;
  for (const TruthRow& row : truth) {
    if (!video.read(image)) {
      return absl::DataLossError("the video ends before the truth does");
    }
    ASSIGN_OR_RETURN(
        image::Frame frame,
        image::DecodeImage({.bytes = test_support::EncodeJpeg(image)}, {}));
    frame.sequence = static_cast<std::uint64_t>(row.frame);
    frame.capture_time = row.time;
    if (!started && row.visible_box_px) {
      RETURN_IF_ERROR(session->SetTarget("1", *row.visible_box_px, {}));
      started = true;
    }
    std::vector<absl::Status> target_errors;
    const double start_s = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(
        const tracking::FrameResult result,
        session->ProcessFrame(frame, std::nullopt, &target_errors));
    times_ms.push_back(1e3 * (test_support::ThreadCpuSeconds() - start_s));
    for (const absl::Status& error : target_errors) std::cerr << error << '\n';
    WriteResults(out, result, ground_world);
  }
  std::printf("CPU ms per frame: %s\n",
              test_support::Quantiles(times_ms).c_str());
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::eval

int main(int argc, char** argv) {
  if (argc < 5 || argc > 7) {
    std::cerr << "usage: track_with_truth CAMERA.json VIDEO TRUTH.csv "
                 "RESULTS.csv [TRACKER [VIEWS]]\n";
    return 2;
  }
  cv::setNumThreads(1);
  const absl::Status status = groundlock::eval::Run(argc, argv);
  if (!status.ok()) std::cerr << status << '\n';
  return status.ok() ? 0 : 1;
}
