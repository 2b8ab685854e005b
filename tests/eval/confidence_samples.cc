// SPDX-License-Identifier: Apache-2.0
// What dcf's signals were, frame by frame, and how well its box overlapped the
// truth: what its confidence is fitted to, and measured on.
//   usage: confidence_samples SAMPLES.csv [--sequences FOLDER]
//            [--drive CAMERA.json,VIDEO,TRUTH.csv]...
// Sequences are run as tracker_benchmark does. Drives are rendered sequences:
// the target is predicted on the ground by the true camera and a motion model,
// as a session does it, and its box is compared with the visible part.
#include <CLI/CLI.hpp>
#include <fstream>
#include <iostream>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "client/cli/evaluate/truth_csv.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "map_store/geometry/camera_model.h"
#include "server/target/dcf_tracker.h"
#include "server/tracking/ground_target.h"
#include "tests/support/one_pass_reader.h"

namespace groundlock::eval {
namespace {

using geometry::Box2;
using target::DcfTracker;

constexpr double kGate = 13.8;  // as target_track.cc

void WriteHeader(std::ostream& out) {
  out << "sequence,frame,peak,usual,sharpness,sidelobe,colour,expected,around,"
         "usual_excess,confidence,overlap,seen\n";
}

void WriteSample(std::ostream& out,
                 const std::string& sequence,
                 std::size_t frame,
                 const DcfTracker& tracker,
                 double confidence,
                 double overlap,
                 double seen) {
  const target::DcfSignals& s = tracker.signals();
  out << sequence << ','
      << absl::StrFormat(
             "%d,%.5f,%.5f,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f\n",
             frame,
             s.peak,
             s.usual_peak,
             s.sharpness,
             s.sidelobe,
             s.colour,
             s.expected_colour,
             s.around_colour,
             s.usual_excess,
             confidence,
             overlap,
             seen);
}

absl::Status RunSequence(const cli::OnePassSequence& sequence,
                         std::ostream& out) {
  DcfTracker tracker;
  ASSIGN_OR_RETURN(auto reader, test_support::OnePassReader::Open(sequence));
  const std::size_t frames =
      std::min(reader.frames(), sequence.truth_px.size());
  for (std::size_t i = 0; i < frames; ++i) {
    ASSIGN_OR_RETURN(const cv::Mat image, reader.Next());
    if (i == 0) {
      RETURN_IF_ERROR(tracker.Initialize(image, sequence.truth_px[0]));
      continue;
    }
    ASSIGN_OR_RETURN(const auto seen, tracker.Detect(image, false));
    WriteSample(
        out,
        sequence.name,
        i,
        tracker,
        seen.confidence,
        geometry::IntersectionOverUnion(seen.box_px, sequence.truth_px[i]),
        1.0);
    tracker.Learn(image);
  }
  return absl::OkStatus();
}

absl::Status RunDrive(const std::string& files, std::ostream& out) {
  const std::vector<std::string> parts = absl::StrSplit(files, ',');
  if (parts.size() != 3) {
    return absl::InvalidArgumentError(files +
                                      ": expected CAMERA.json,VIDEO,TRUTH.csv");
  }
  ASSIGN_OR_RETURN(const std::string json, base::ReadFile(parts[0], 1 << 20));
  ASSIGN_OR_RETURN(const geometry::CameraModel camera,
                   geometry::CameraModelFromJson(json));
  ASSIGN_OR_RETURN(const std::vector<cli::TruthRow> truth,
                   cli::ReadTruth(parts[2]));
  cv::VideoCapture video(parts[1]);
  DcfTracker tracker;
  std::optional<tracking::GroundTarget> ground;
  cv::Mat image;
  for (const cli::TruthRow& row : truth) {
    if (!video.read(image)) {
      return absl::DataLossError(parts[1] + " ends before the truth does");
    }
    const tracking::CameraView view{{&camera, row.world_from_camera, {}}};
    if (!ground) {
      if (!row.visible_box_px) continue;
      RETURN_IF_ERROR(tracker.Initialize(image, *row.visible_box_px));
      ASSIGN_OR_RETURN(
          ground,
          tracking::GroundTarget::Create(view,
                                         *row.visible_box_px,
                                         row.time,
                                         tracking::BoxCenter::kTexture,
                                         motion::MotionOptions{}));
      continue;
    }
    ground->Predict(row.time);
    const auto place = ground->ProjectForTracker(view);
    if (!place) continue;
    tracker.Place(*place);
    ASSIGN_OR_RETURN(const auto seen, tracker.Detect(image, true));
    const auto sighting = ground->Lift(view, seen.box_px);
    const bool believed = seen.confidence >= 0.5 && sighting &&
                          sighting->innovation.surprise <= kGate;
    if (believed) ground->Update(view, *sighting);
    const auto outline = ground->Project(view);
    WriteSample(
        out,
        parts[1],
        static_cast<std::size_t>(row.frame),
        tracker,
        seen.confidence,
        row.visible_box_px && outline
            ? geometry::IntersectionOverUnion(*outline, *row.visible_box_px)
            : 0.0,
        row.seen_fraction);
    if (believed) tracker.Learn(image);
  }
  return absl::OkStatus();
}

absl::Status Run(const std::string& samples,
                 const std::string& sequences,
                 const std::vector<std::string>& drives) {
  std::ofstream out(samples);
  WriteHeader(out);
  if (!sequences.empty()) {
    ASSIGN_OR_RETURN(const auto read, cli::ReadOnePassSequences(sequences));
    for (const auto& sequence : read) {
      RETURN_IF_ERROR(RunSequence(sequence, out));
    }
  }
  for (const std::string& drive : drives) RETURN_IF_ERROR(RunDrive(drive, out));
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::eval

int main(int argc, char** argv) {
  CLI::App app("Signals and overlaps of the default tracker.");
  std::string samples;
  std::string sequences;
  std::vector<std::string> drives;
  app.add_option("samples", samples, "Where they go (CSV)")->required();
  app.add_option("--sequences", sequences, "Folder of OTB-style sequences");
  app.add_option("--drive", drives, "CAMERA.json,VIDEO,TRUTH.csv");
  CLI11_PARSE(app, argc, argv);
  groundlock::features::SetUpOpenCv();
  const absl::Status status = groundlock::eval::Run(samples, sequences, drives);
  if (!status.ok()) std::cerr << "confidence_samples: " << status << '\n';
  return status.ok() ? 0 : 1;
}
