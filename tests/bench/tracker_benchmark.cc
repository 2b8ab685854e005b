// SPDX-License-Identifier: Apache-2.0
// Runs 2D trackers over a folder of single-object sequences (one_pass.h says
// how it is laid out), once each from the first true box, and prints precision
// at 20 px, success AUC, the time of an update and what it takes of memory,
// side by side.
//   OUT/<tracker>/<name>.txt           x,y,w,h per frame, counted from 0
//   OUT/<tracker>/<name>.confidence    confidence and overlap per frame
//   OUT/precision.svg, OUT/success.svg the benchmark's plots
// One thread. Times are the thread's processor time of Detect and Learn, so
// that they mean one core also on a busy machine, of frames where the tracker
// had something to look at. It learns whenever its own gate lets it. Memory is
// what an update asks for after the first kWarmUpFrames frames of a sequence:
// allocations per update (mean of the worst sequence), and by how much the heap
// has grown by a sequence's end (of the worst sequence).
#include <CLI/CLI.hpp>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "map_store/base/status.h"
#include "server/target/dcf_tracker.h"
#include "server/target/target_tracker.h"
#include "server/tracking/tracking_session.h"
#include "tests/support/allocation_counter.h"
#include "tests/support/line_plot.h"
#include "tests/support/one_pass.h"

namespace groundlock {
namespace {

namespace fs = std::filesystem;
using geometry::Box2;
using target::TargetTracker;
using test_support::OnePassScore;
using test_support::OnePassSequence;

constexpr int kWarmUpFrames = 10;

// A tracker in the table: its name there, and how one is made.
struct Entry {
  std::string label;
  std::function<absl::StatusOr<std::unique_ptr<TargetTracker>>()> create;
};

struct Found {
  std::vector<Box2> boxes_px;
  std::vector<double> confidences;
  std::vector<double> times_ms;
  double allocations = 0.0;  // per update
  double grown_bytes = 0.0;
};

double ThreadTime_ms() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) +
         1e-6 * static_cast<double>(now.tv_nsec);
}

absl::StatusOr<Found> Follow(TargetTracker& tracker,
                             const OnePassSequence& sequence) {
  Found found;
  std::uint64_t heap = 0;
  std::uint64_t allocations = 0;
  int counted = 0;
  const std::size_t frames = sequence.images.size();
  found.boxes_px.reserve(frames);
  found.confidences.reserve(frames);
  found.times_ms.reserve(frames);
  for (std::size_t i = 0; i < frames; ++i) {
    const cv::Mat image =
        cv::imread(sequence.images[i].string(), cv::IMREAD_COLOR);
    if (i == 0) {
      RETURN_IF_ERROR(tracker.Initialize(image, sequence.truth_px[0]));
      found.boxes_px.push_back(sequence.truth_px[0]);
      found.confidences.push_back(1.0);
      continue;
    }
    const std::uint64_t heap_before = test_support::HeapBytesInUse();
    const std::uint64_t allocations_before = test_support::AllocationCount();
    const double start_ms = ThreadTime_ms();
    ASSIGN_OR_RETURN(const target::TargetObservation seen,
                     tracker.Detect(image, /*fixed_size=*/false));
    tracker.Learn(image);
    const double end_ms = ThreadTime_ms();
    if (i >= kWarmUpFrames) {
      allocations += test_support::AllocationCount() - allocations_before;
      heap += test_support::HeapBytesInUse() - heap_before;
      ++counted;
    }
    if (seen.confidence > 0.0) found.times_ms.push_back(end_ms - start_ms);
    found.boxes_px.push_back(seen.box_px);
    found.confidences.push_back(seen.confidence);
  }
  if (counted > 0) {
    found.allocations = static_cast<double>(allocations) / counted;
    // Differences of unsigned numbers: a heap that shrank counts negative.
    found.grown_bytes = static_cast<double>(static_cast<std::int64_t>(heap));
  }
  return found;
}

// The same through a tracking session without a map, as a server runs it.
absl::StatusOr<Found> FollowInSession(const std::string& tracker_name,
                                      const OnePassSequence& sequence) {
  Found found;
  std::unique_ptr<tracking::TrackingSession> session;
  for (std::size_t i = 0; i < sequence.images.size(); ++i) {
    image::Frame frame = image::Frame::FromBgr(
        cv::imread(sequence.images[i].string(), cv::IMREAD_COLOR));
    frame.sequence = i;
    frame.capture_time = std::chrono::milliseconds(40 * i);
    const cv::Size size = frame.size_px();
    if (i == 0) {
      const std::array<double, 3> lens = {
          1000.0, 0.5 * size.width, 0.5 * size.height};
      ASSIGN_OR_RETURN(
          const geometry::CameraModel camera,
          geometry::CameraModel::Create(geometry::CameraModelId::kSimplePinhole,
                                        size.width,
                                        size.height,
                                        lens));
      tracking::SessionOptions options;
      options.tracker.name = tracker_name;
      ASSIGN_OR_RETURN(session,
                       tracking::TrackingSession::Create(
                           nullptr, geometry::Plane{}, camera, options));
      RETURN_IF_ERROR(session->SetTarget("1", sequence.truth_px[0], {}));
    }
    const double start_ms = ThreadTime_ms();
    ASSIGN_OR_RETURN(const tracking::FrameResult result,
                     session->ProcessFrame(frame, std::nullopt, nullptr));
    found.times_ms.push_back(ThreadTime_ms() - start_ms);
    if (result.targets.empty() || !result.targets[0].box_px) {
      return absl::InternalError(
          absl::StrCat(sequence.name, ": frame ", i, " has no box"));
    }
    found.boxes_px.push_back(*result.targets[0].box_px);
    found.confidences.push_back(result.targets[0].confidence);
  }
  return found;
}

void WriteBoxes(const Found& found,
                const OnePassSequence& sequence,
                const fs::path& out) {
  std::ofstream boxes(out / (sequence.name + ".txt"));
  std::ofstream confidences(out / (sequence.name + ".confidence"));
  for (std::size_t i = 0; i < found.boxes_px.size(); ++i) {
    const Box2& box = found.boxes_px[i];
    boxes << absl::StrFormat(
        "%.3f,%.3f,%.3f,%.3f\n", box.x(), box.y(), box.width(), box.height());
    if (i >= sequence.truth_px.size()) continue;
    confidences << absl::StrFormat(
        "%.4f %.4f\n",
        found.confidences[i],
        geometry::IntersectionOverUnion(box, sequence.truth_px[i]));
  }
}

struct Row {
  std::string label;
  OnePassScore score;
  double median_ms = 0.0, p95_ms = 0.0, p99_ms = 0.0;
  double allocations = 0.0, grown_kb = 0.0;
};

double Percentile(const std::vector<double>& sorted, double share) {
  if (sorted.empty()) return 0.0;
  return sorted[static_cast<std::size_t>(
      share * static_cast<double>(sorted.size() - 1))];
}

absl::StatusOr<Row> RunEntry(
    const std::string& label,
    const std::vector<OnePassSequence>& sequences,
    const fs::path& out,
    const std::function<absl::StatusOr<Found>(const OnePassSequence&)>& run) {
  Row row;
  row.label = label;
  std::error_code error;
  fs::create_directories(out / label, error);
  std::vector<OnePassScore> scores;
  std::vector<double> times_ms;
  for (const OnePassSequence& sequence : sequences) {
    ASSIGN_OR_RETURN(const Found found, run(sequence));
    WriteBoxes(found, sequence, out / label);
    scores.push_back(test_support::Rate(found.boxes_px, sequence.truth_px));
    times_ms.insert(
        times_ms.end(), found.times_ms.begin(), found.times_ms.end());
    row.allocations = std::max(row.allocations, found.allocations);
    row.grown_kb = std::max(row.grown_kb, found.grown_bytes / 1024.0);
    std::cout << absl::StrFormat("%-24s %-24s precision %.3f AUC %.3f",
                                 label,
                                 sequence.name,
                                 scores.back().PrecisionAt20px(),
                                 scores.back().Auc())
              << std::endl;
  }
  row.score = test_support::Mean(scores);
  std::sort(times_ms.begin(), times_ms.end());
  row.median_ms = Percentile(times_ms, 0.5);
  row.p95_ms = Percentile(times_ms, 0.95);
  row.p99_ms = Percentile(times_ms, 0.99);
  return row;
}

void PrintTable(const std::vector<Row>& rows) {
  double csrt_ms = 0.0;
  for (const Row& row : rows) {
    if (row.label == "csrt") csrt_ms = row.median_ms;
  }
  std::cout << "\n| tracker | precision at 20 px | AUC | update, median, ms | "
               "95 % | 99 % | times as fast as csrt | allocations per update | "
               "heap growth, kB |\n|---|---|---|---|---|---|---|---|---|\n";
  for (const Row& row : rows) {
    std::cout << absl::StrFormat(
        "| `%s` | %.3f | %.3f | %.2f | %.2f | %.2f | %s | %.1f | %.0f |\n",
        row.label,
        row.score.PrecisionAt20px(),
        row.score.Auc(),
        row.median_ms,
        row.p95_ms,
        row.p99_ms,
        csrt_ms > 0.0 && row.median_ms > 0.0
            ? absl::StrFormat("%.1f", csrt_ms / row.median_ms)
            : "",
        row.allocations,
        row.grown_kb);
  }
}

absl::Status WritePlots(std::vector<Row> rows, const fs::path& out) {
  test_support::LinePlot success;
  success.title = "Success";
  success.x_label = "overlap threshold";
  success.y_label = "share of frames";
  test_support::LinePlot precision;
  precision.title = "Precision";
  precision.x_label = "centre error threshold, px";
  precision.y_label = "share of frames";
  precision.max = {test_support::kDistanceSteps, 1.0};
  precision.legend_at_left = true;
  std::stable_sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) {
    return a.score.Auc() > b.score.Auc();
  });
  for (const Row& row : rows) {
    test_support::PlotLine& s = success.lines.emplace_back();
    s.label = absl::StrFormat("%s (%.3f)", row.label, row.score.Auc());
    for (int t = 0; t <= test_support::kOverlapSteps; ++t) {
      s.points.emplace_back(
          t / static_cast<double>(test_support::kOverlapSteps),
          row.score.success[t]);
    }
    test_support::PlotLine& p = precision.lines.emplace_back();
    p.label =
        absl::StrFormat("%s (%.3f)", row.label, row.score.PrecisionAt20px());
    for (int t = 0; t <= test_support::kDistanceSteps; ++t) {
      p.points.emplace_back(t, row.score.precision[t]);
    }
  }
  RETURN_IF_ERROR(WriteSvg(success, out / "success.svg"));
  return WriteSvg(precision, out / "precision.svg");
}

// The default tracker with one thing changed at a time.
std::vector<Entry> Ablations() {
  std::vector<Entry> entries;
  const auto add = [&entries](const std::string& label, auto&& change) {
    target::DcfTrackerOptions options;
    change(options);
    entries.push_back(
        {label, [options]() -> absl::StatusOr<std::unique_ptr<TargetTracker>> {
           return std::make_unique<target::DcfTracker>(options);
         }});
  };
  using Options = target::DcfTrackerOptions;
  add("dcf", [](Options&) {});
  add("without colour names", [](Options& o) { o.colour_names = false; });
  add("with colour histogram", [](Options& o) { o.colour_histogram = 0.3; });
  add("without background", [](Options& o) { o.filter.crop = false; });
  add("without temporal term", [](Options& o) { o.filter.temporal = 0.0; });
  add("without scale", [](Options& o) { o.scale = false; });
  add("whole cells", [](Options& o) { o.sub_cell = false; });
  add("learns always", [](Options& o) { o.learning_gate = false; });
  add("never learns", [](Options& o) { o.learns = false; });
  return entries;
}

struct Arguments {
  fs::path sequences, out;
  std::vector<std::string> trackers;
  std::vector<std::string> only;  // sequences
  bool ablation = false;
  bool session = false;
};

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(std::vector<OnePassSequence> sequences,
                   test_support::ReadOnePassSequences(arguments.sequences));
  if (!arguments.only.empty()) {
    std::erase_if(sequences, [&](const OnePassSequence& sequence) {
      return std::find(arguments.only.begin(),
                       arguments.only.end(),
                       sequence.name) == arguments.only.end();
    });
  }
  std::vector<Entry> entries;
  if (arguments.ablation) entries = Ablations();
  for (const std::string& name : arguments.trackers) {
    entries.push_back({name, [name] {
                         return target::CreateTargetTracker({name, ""});
                       }});
  }
  std::vector<Row> rows;
  for (const Entry& entry : entries) {
    const auto run =
        [&](const OnePassSequence& sequence) -> absl::StatusOr<Found> {
      ASSIGN_OR_RETURN(const auto tracker, entry.create());
      return Follow(*tracker, sequence);
    };
    ASSIGN_OR_RETURN(Row row,
                     RunEntry(entry.label, sequences, arguments.out, run));
    rows.push_back(std::move(row));
  }
  if (arguments.session) {
    for (const std::string& name : arguments.trackers) {
      ASSIGN_OR_RETURN(Row row,
                       RunEntry(name + "-session",
                                sequences,
                                arguments.out,
                                [&](const OnePassSequence& sequence) {
                                  return FollowInSession(name, sequence);
                                }));
      rows.push_back(std::move(row));
    }
  }
  PrintTable(rows);
  return WritePlots(rows, arguments.out);
}

}  // namespace
}  // namespace groundlock

int main(int argc, char** argv) {
  CLI::App app("Scores 2D trackers on a folder of OTB-style sequences.");
  groundlock::Arguments arguments;
  app.add_option("sequences", arguments.sequences, "Folder of sequences")
      ->required();
  app.add_option("out", arguments.out, "Where boxes and plots go")->required();
  app.add_option("trackers", arguments.trackers, "Names; default: all");
  app.add_option("--only", arguments.only, "Only these sequences");
  app.add_flag("--ablation",
               arguments.ablation,
               "The default tracker with one thing changed at a time");
  app.add_flag("--session",
               arguments.session,
               "Also through a tracking session without a map");
  CLI11_PARSE(app, argc, argv);
  if (arguments.trackers.empty() && !arguments.ablation) {
    arguments.trackers = groundlock::target::TargetTrackerNames();
  }
  cv::setNumThreads(1);
  const absl::Status status = groundlock::Run(arguments);
  if (!status.ok()) {
    std::cerr << "tracker_benchmark: " << status.message() << "\n";
    return 1;
  }
  return 0;
}
