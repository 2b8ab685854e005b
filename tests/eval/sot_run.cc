// SPDX-License-Identifier: Apache-2.0
// Runs 2D trackers over a folder of single-object sequences in the layout of
// the online tracking benchmark (OTB: Wu, Lim, Yang, CVPR 2013), once each from
// the first true box, and prints success AUC, precision at 20 px and speed.
//   SEQUENCES/<name>/img/*.jpg         frames in the order of their names; img
//                                      may be a text file with the folder's
//                                      path
//   SEQUENCES/<name>/groundtruth.txt   x,y,w,h per frame, pixels counted from 1
//   OUT/<tracker>/<name>.txt           x,y,w,h per frame, counted from 0
//   OUT/<tracker>/<name>.confidence    confidence and overlap per frame
// One OpenCV thread. Times are processor time of Detect and Learn, so that they
// mean one core also on a busy machine, of the frames where the tracker had
// something to look at. It learns whenever the tracker's own gate lets it.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "server/target/target_tracker.h"

namespace groundlock {
namespace {

namespace fs = std::filesystem;
using geometry::Box2;

struct Sequence {
  std::string name;
  std::vector<fs::path> images;
  std::vector<Box2> truth_px;
};

absl::StatusOr<std::vector<Box2>> ReadBoxes(const fs::path& path) {
  std::ifstream file(path);
  std::vector<Box2> boxes;
  for (std::string line; std::getline(file, line);) {
    std::replace_if(
        line.begin(),
        line.end(),
        [](char c) { return c == ',' || c == '\t'; },
        ' ');
    if (line.find_first_not_of(" \r") == std::string::npos) continue;
    std::istringstream fields(line);
    double x, y, w, h;
    if (!(fields >> x >> y >> w >> h)) {
      return absl::InvalidArgumentError(absl::StrCat(
          path.string(), ":", boxes.size() + 1, ": expected x,y,w,h"));
    }
    boxes.push_back(Box2::FromXywh(x - 1.0, y - 1.0, w, h));
  }
  if (boxes.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": no boxes"));
  }
  return boxes;
}

absl::StatusOr<Sequence> ReadSequence(const fs::path& folder) {
  Sequence sequence;
  sequence.name = folder.filename().string();
  ASSIGN_OR_RETURN(sequence.truth_px, ReadBoxes(folder / "groundtruth.txt"));
  fs::path images = folder / "img";
  if (fs::is_regular_file(images)) {
    // A symbolic link as a system without them checks it out.
    std::string target;
    std::getline(std::ifstream(images), target);
    images = folder / target;
  }
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(images, error)) {
    sequence.images.push_back(entry.path());
  }
  if (sequence.images.empty()) {
    return absl::NotFoundError(
        absl::StrCat(images.string(), ": no images ", error.message()));
  }
  std::sort(sequence.images.begin(), sequence.images.end());
  return sequence;
}

struct Score {
  double auc = 0.0;
  double precision = 0.0;
  double median_ms = 0.0;
  double frames_per_s = 0.0;
};

// Mean of the success rates over 21 overlap thresholds; share of frames with
// the centre within 20 px.
void Rate(const std::vector<Box2>& found_px,
          const std::vector<Box2>& truth_px,
          Score& score) {
  const std::size_t frames = std::min(found_px.size(), truth_px.size());
  for (std::size_t i = 0; i < frames; ++i) {
    const double overlap =
        geometry::IntersectionOverUnion(found_px[i], truth_px[i]);
    int passed = 0;
    for (int t = 0; t <= 20; ++t) passed += overlap > 0.05 * t ? 1 : 0;
    score.auc += passed / 21.0;
    const double error_px =
        (found_px[i].center_px() - truth_px[i].center_px()).norm();
    score.precision += error_px <= 20.0 ? 1.0 : 0.0;
  }
  score.auc /= static_cast<double>(frames);
  score.precision /= static_cast<double>(frames);
}

absl::StatusOr<Score> RunSequence(const std::string& tracker_name,
                                  const Sequence& sequence,
                                  const fs::path& out) {
  ASSIGN_OR_RETURN(auto tracker,
                   target::CreateTargetTracker({.name = tracker_name}));
  std::ofstream boxes(out / (sequence.name + ".txt"));
  std::ofstream confidences(out / (sequence.name + ".confidence"));
  std::vector<Box2> found_px;
  std::vector<double> times_ms;
  for (const fs::path& path : sequence.images) {
    const cv::Mat image = cv::imread(path.string(), cv::IMREAD_COLOR);
    const std::clock_t start = std::clock();
    if (found_px.empty()) {
      RETURN_IF_ERROR(tracker->Initialize(image, sequence.truth_px[0]));
      found_px.push_back(sequence.truth_px[0]);
    } else {
      ASSIGN_OR_RETURN(const target::TargetObservation seen,
                       tracker->Detect(image, /*fixed_size=*/false));
      tracker->Learn(image);
      if (seen.confidence > 0.0) {
        times_ms.push_back(1e3 * static_cast<double>(std::clock() - start) /
                           CLOCKS_PER_SEC);
      }
      found_px.push_back(seen.box_px);
      const std::size_t i = found_px.size() - 1;
      if (i < sequence.truth_px.size()) {
        confidences << absl::StrFormat(
            "%.4f %.4f\n",
            seen.confidence,
            geometry::IntersectionOverUnion(seen.box_px, sequence.truth_px[i]));
      }
    }
    const Box2& box = found_px.back();
    boxes << absl::StrFormat(
        "%.3f,%.3f,%.3f,%.3f\n", box.x(), box.y(), box.width(), box.height());
  }
  Score score;
  Rate(found_px, sequence.truth_px, score);
  if (!times_ms.empty()) {
    std::sort(times_ms.begin(), times_ms.end());
    score.median_ms = times_ms[times_ms.size() / 2];
    score.frames_per_s = 1e3 / std::max(1e-6, score.median_ms);
  }
  return score;
}

void Print(const std::string& tracker,
           const std::string& what,
           const Score& score) {
  std::cout << absl::StrFormat(
                   "%-8s %-24s AUC %.3f P20 %.3f median %.2f ms, %.0f "
                   "frames/s",
                   tracker,
                   what,
                   score.auc,
                   score.precision,
                   score.median_ms,
                   score.frames_per_s)
            << std::endl;
}

absl::Status Run(const fs::path& root,
                 const fs::path& out,
                 const std::vector<std::string>& trackers) {
  std::vector<Sequence> sequences;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(root, error)) {
    if (!fs::exists(entry.path() / "groundtruth.txt")) continue;
    ASSIGN_OR_RETURN(Sequence sequence, ReadSequence(entry.path()));
    sequences.push_back(std::move(sequence));
  }
  if (sequences.empty()) {
    return absl::NotFoundError(
        absl::StrCat(root.string(), ": no sequences ", error.message()));
  }
  std::sort(sequences.begin(),
            sequences.end(),
            [](const auto& a, const auto& b) { return a.name < b.name; });
  for (const std::string& tracker : trackers) {
    fs::create_directories(out / tracker, error);
    Score mean;
    const auto count = static_cast<double>(sequences.size());
    for (const Sequence& sequence : sequences) {
      ASSIGN_OR_RETURN(const Score score,
                       RunSequence(tracker, sequence, out / tracker));
      Print(tracker, sequence.name, score);
      mean.auc += score.auc / count;
      mean.precision += score.precision / count;
      mean.median_ms += score.median_ms / count;
    }
    mean.frames_per_s = 1e3 / std::max(1e-6, mean.median_ms);
    Print(tracker, absl::StrCat("MEAN of ", sequences.size()), mean);
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock

int main(int argc, char** argv) {
  CLI::App app("Scores 2D trackers on a folder of OTB-style sequences.");
  std::string root;
  std::string out;
  std::vector<std::string> trackers;
  app.add_option("sequences", root, "Folder of sequences")->required();
  app.add_option("out", out, "Where the boxes go")->required();
  app.add_option("trackers", trackers, "Names; default: all");
  CLI11_PARSE(app, argc, argv);
  if (trackers.empty()) trackers = groundlock::target::TargetTrackerNames();
  cv::setNumThreads(1);
  const absl::Status status = groundlock::Run(root, out, trackers);
  if (!status.ok()) {
    std::cerr << "sot_run: " << status.message() << "\n";
    return 1;
  }
  return 0;
}
