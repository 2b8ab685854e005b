// SPDX-License-Identifier: Apache-2.0
// Runs 2D trackers over folders of single-object sequences or flights
// (client/cli/evaluate/one_pass.h says how they are laid out), once each from
// the first true box, and prints precision at 20 px, success AUC, the time of
// an update and what it takes of memory, side by side; through sessions, as a
// server runs them, also the share of frames with the target that are reported
// TRACKED, and that of frames without it that are not. Each frame is read once,
// for all trackers. With --starts each sequence is run from as many frames,
// evenly spread, to its end, and its score is their mean (temporal robustness
// evaluation, Wu et al., CVPR 2013): whether a single run slips or not is often
// chance.
//   OUT/<tracker>/<name>.txt           x,y,w,h per frame, counted from 0
//   OUT/<tracker>/<name>.confidence    confidence and overlap per frame
//   OUT/precision.svg, OUT/success.svg the benchmark's plots
// One thread. Times are the thread's processor time of Detect and Learn, so
// that they mean one core also on a busy machine, of frames where the tracker
// had something to look at. It learns whenever its own gate lets it. Memory is
// what an update asks for after the first ten frames of a sequence:
// allocations per update (mean of the worst sequence), and by how much the heap
// has grown by a sequence's end (of the worst sequence).
#include <CLI/CLI.hpp>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "client/cli/evaluate/line_plot.h"
#include "client/cli/evaluate/one_pass.h"
#include "map_store/base/status.h"
#include "server/target/dcf_tracker.h"
#include "server/target/target_tracker.h"
#include "tests/bench/follower.h"
#include "tests/support/one_pass_reader.h"

namespace groundlock {
namespace {

namespace fs = std::filesystem;
using bench::Follower;
using bench::Found;
using cli::OnePassScore;
using cli::OnePassSequence;
using geometry::Box2;
using target::TargetTracker;

// A tracker in the table: its name there, and how one is made.
struct Entry {
  std::string label;
  std::function<absl::StatusOr<std::unique_ptr<TargetTracker>>()> create;
};

// A window half as wide and tall as the image that keeps the target in its
// middle and looks away from it again and again: absences with a truth.
class AbsenceWindow {
 public:
  // Every kPeriod_s the window goes to the corner farthest from the target,
  // stays there and comes back.
  cv::Rect At(double time_s, const Box2& truth_px, const cv::Size& image) {
    const Eigen::Vector2d size(image.width / 2, image.height / 2);
    const Eigen::Vector2d room(image.width - size.x(), image.height - size.y());
    if (truth_px.IsFinite()) center_px_ = truth_px.center_px();
    const Eigen::Vector2d at =
        (center_px_ - 0.5 * size).cwiseMax(0.0).cwiseMin(room);
    const Eigen::Vector2d corner(at.x() > 0.5 * room.x() ? 0.0 : room.x(),
                                 at.y() > 0.5 * room.y() ? 0.0 : room.y());
    const double phase_s = std::fmod(time_s, kPeriod_s) - kPresent_s;
    const double away = std::clamp(
        std::min(phase_s, kPeriod_s - kPresent_s - phase_s) / kMove_s,
        0.0,
        1.0);
    const Eigen::Vector2d place = at + away * (corner - at);
    return {static_cast<int>(std::lround(place.x())),
            static_cast<int>(std::lround(place.y())),
            static_cast<int>(size.x()),
            static_cast<int>(size.y())};
  }

 private:
  static constexpr double kPeriod_s = 8.0;
  static constexpr double kPresent_s = 4.5;
  static constexpr double kMove_s = 0.6;
  Eigen::Vector2d center_px_ = Eigen::Vector2d::Zero();
};

// A sequence's truth as a tracker is shown it.
struct ShownTruth {
  std::vector<Box2> truth_px;  // not finite: less than half of it is in view
  std::vector<bool> absent;    // nothing of it is
};

void WriteBoxes(const Found& found,
                const std::string& name,
                const ShownTruth& shown,
                const fs::path& out) {
  std::ofstream boxes(out / (name + ".txt"));
  std::ofstream confidences(out / (name + ".confidence"));
  for (std::size_t i = 0; i < found.boxes_px.size(); ++i) {
    const Box2& box = found.boxes_px[i];
    boxes << absl::StrFormat(
        "%.3f,%.3f,%.3f,%.3f\n", box.x(), box.y(), box.width(), box.height());
    if (i >= shown.truth_px.size()) continue;
    confidences << absl::StrFormat(
        "%.4f %.4f %d\n",
        found.confidences[i],
        shown.truth_px[i].IsFinite()
            ? geometry::IntersectionOverUnion(box, shown.truth_px[i])
            : 0.0,
        static_cast<int>(found.tracked[i]));
  }
}

struct Row {
  std::string label;
  OnePassScore score;
  double median_ms = 0.0, p95_ms = 0.0, p99_ms = 0.0;
  double allocations = 0.0, grown_kb = 0.0;
  // Shares: of frames that show the target reported TRACKED, of frames that do
  // not show it not reported so. NaN without such frames.
  double true_positive = 0.0, true_negative = 0.0;
};

double Percentile(const std::vector<double>& sorted, double share) {
  if (sorted.empty()) return 0.0;
  return sorted[static_cast<std::size_t>(
      share * static_cast<double>(sorted.size() - 1))];
}

// What an entry has done so far.
struct Tally {
  std::vector<OnePassScore> scores;  // of the sequences
  std::vector<double> times_ms;
  double allocations = 0.0, grown_bytes = 0.0;
  int shown = 0, shown_tracked = 0, absent = 0, absent_untracked = 0;

  OnePassScore Add(const Found& found, const ShownTruth& shown_truth) {
    times_ms.insert(
        times_ms.end(), found.times_ms.begin(), found.times_ms.end());
    allocations = std::max(allocations, found.allocations);
    grown_bytes = std::max(grown_bytes, found.grown_bytes);
    for (std::size_t i = 0; i < shown_truth.truth_px.size(); ++i) {
      if (shown_truth.truth_px[i].IsFinite()) {
        ++shown;
        shown_tracked += found.tracked[i] ? 1 : 0;
      } else if (shown_truth.absent[i]) {
        ++absent;
        absent_untracked += found.tracked[i] ? 0 : 1;
      }
    }
    return cli::Rate(found.boxes_px, shown_truth.truth_px);
  }

  Row ToRow(const std::string& label) {
    Row row;
    row.label = label;
    row.score = cli::Mean(scores);
    std::sort(times_ms.begin(), times_ms.end());
    row.median_ms = Percentile(times_ms, 0.5);
    row.p95_ms = Percentile(times_ms, 0.95);
    row.p99_ms = Percentile(times_ms, 0.99);
    row.allocations = allocations;
    row.grown_kb = grown_bytes / 1024.0;
    row.true_positive = static_cast<double>(shown_tracked) / shown;
    row.true_negative = static_cast<double>(absent_untracked) / absent;
    return row;
  }
};

void PrintTable(const std::vector<Row>& rows) {
  double csrt_ms = 0.0;
  for (const Row& row : rows) {
    if (row.label == "csrt") csrt_ms = row.median_ms;
  }
  std::cout << "\n| tracker | precision at 20 px | AUC | update, median, ms | "
               "95 % | 99 % | times as fast as csrt | allocations per update | "
               "heap growth, kB | true positives | true negatives |\n"
               "|---|---|---|---|---|---|---|---|---|---|---|\n";
  for (const Row& row : rows) {
    std::cout << absl::StrFormat(
        "| `%s` | %.3f | %.3f | %.2f | %.2f | %.2f | %s | %.1f | %.0f | %.3f | "
        "%.3f |\n",
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
        row.grown_kb,
        row.true_positive,
        row.true_negative);
  }
}

absl::Status WritePlots(const std::vector<Row>& rows, const fs::path& out) {
  std::vector<cli::LabelledScore> scores;
  for (const Row& row : rows) scores.push_back({row.label, row.score});
  const cli::OnePassPlots plots = cli::PlotScores(scores);
  RETURN_IF_ERROR(WriteSvg(plots.success, out / "success.svg"));
  return WriteSvg(plots.precision, out / "precision.svg");
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
  add("without outline", [](Options& o) { o.colour_outline = false; });
  add("whole cells", [](Options& o) { o.sub_cell = false; });
  add("learns always", [](Options& o) { o.learning_gate = false; });
  add("never learns", [](Options& o) { o.learns = false; });
  return entries;
}

struct Arguments {
  std::string sequences;
  fs::path out;
  std::vector<std::string> trackers;
  std::vector<std::string> only;  // sequences
  bool ablation = false;
  bool session = false;
  bool absences = false;
  int starts = 1;
};

// How entries are made for a sequence.
struct Contestant {
  std::string label;
  std::function<absl::StatusOr<std::unique_ptr<Follower>>(
      const Box2& box_px, double frames_per_second)>
      start;
};

std::vector<Contestant> Contestants(const Arguments& arguments) {
  std::vector<Entry> entries;
  if (arguments.ablation) entries = Ablations();
  for (const std::string& name : arguments.trackers) {
    entries.push_back({name, [name] {
                         return target::CreateTargetTracker({name, ""});
                       }});
  }
  std::vector<Contestant> contestants;
  for (const Entry& entry : entries) {
    contestants.push_back(
        {entry.label,
         [entry](const Box2& box_px,
                 double) -> absl::StatusOr<std::unique_ptr<Follower>> {
           ASSIGN_OR_RETURN(auto tracker, entry.create());
           return bench::FollowBare(std::move(tracker), box_px);
         }});
  }
  if (!arguments.session) return contestants;
  for (const std::string& name : arguments.trackers) {
    contestants.push_back({name + "-session",
                           [name](const Box2& box_px, double frames_per_second)
                               -> absl::StatusOr<std::unique_ptr<Follower>> {
                             return bench::FollowInSession(
                                 name, box_px, frames_per_second);
                           }});
  }
  return contestants;
}

// A contestant's run of a sequence from one of its frames on.
struct SequenceRun {
  std::size_t contestant = 0;
  std::size_t start = 0;  // frame
  std::unique_ptr<Follower> follower;
};

// Frames that show the target from which runs start, in order.
std::vector<std::size_t> Starts(const OnePassSequence& sequence, int count) {
  const std::vector<Box2>& truth_px = sequence.truth_px;
  std::vector<std::size_t> starts;
  for (int k = 0; k < count; ++k) {
    std::size_t start = k * truth_px.size() / count;
    while (start < truth_px.size() && !truth_px[start].IsFinite()) ++start;
    if (start == truth_px.size()) break;
    if (starts.empty() || start > starts.back()) starts.push_back(start);
  }
  return starts;
}

absl::StatusOr<ShownTruth> RunSequence(
    const OnePassSequence& sequence,
    const Arguments& arguments,
    const std::vector<Contestant>& contestants,
    std::vector<SequenceRun>& runs) {
  ASSIGN_OR_RETURN(auto reader, test_support::OnePassReader::Open(sequence));
  const std::vector<std::size_t> starts = Starts(sequence, arguments.starts);
  ShownTruth shown;
  AbsenceWindow window;
  Box2 truth_px = sequence.truth_px.front();
  for (std::size_t i = 0; i < reader.frames(); ++i) {
    ASSIGN_OR_RETURN(cv::Mat image, reader.Next());
    const bool known = i < sequence.truth_px.size();
    if (known) truth_px = sequence.truth_px[i];
    bool absent = !truth_px.IsFinite();
    if (arguments.absences) {
      const cv::Rect view =
          window.At(static_cast<double>(i) / reader.frames_per_second(),
                    truth_px,
                    image.size());
      image = image(view);
      const Eigen::Vector2d origin(view.x, view.y);
      truth_px = {truth_px.min_px - origin, truth_px.max_px - origin};
      const double share =
          geometry::Intersection(
              truth_px, Box2::FromXywh(0.0, 0.0, view.width, view.height))
              .Area() /
          truth_px.Area();
      absent = absent || share <= 0.0;
      if (share < 0.5) truth_px.min_px.setConstant(std::nan(""));
    }
    const bool starts_here =
        std::binary_search(starts.begin(), starts.end(), i) &&
        truth_px.IsFinite();
    for (std::size_t k = 0; starts_here && k < contestants.size(); ++k) {
      ASSIGN_OR_RETURN(
          auto follower,
          contestants[k].start(truth_px, reader.frames_per_second()));
      runs.push_back({k, i, std::move(follower)});
    }
    if (known) {
      shown.truth_px.push_back(truth_px);
      shown.absent.push_back(absent);
    }
    for (const SequenceRun& run : runs) {
      RETURN_IF_ERROR(
          base::Annotate(run.follower->Follow(image), sequence.name));
    }
  }
  return shown;
}

// What a run that starts at a frame is shown.
ShownTruth From(const ShownTruth& shown, std::size_t start) {
  const auto at = static_cast<std::ptrdiff_t>(start);
  return {{shown.truth_px.begin() + at, shown.truth_px.end()},
          {shown.absent.begin() + at, shown.absent.end()}};
}

absl::StatusOr<std::vector<OnePassSequence>> ReadSequences(
    const Arguments& arguments) {
  std::vector<OnePassSequence> sequences;
  for (const std::string& folder :
       std::vector<std::string>(absl::StrSplit(arguments.sequences, ','))) {
    ASSIGN_OR_RETURN(auto read, cli::ReadOnePassSequences(folder));
    sequences.insert(sequences.end(), read.begin(), read.end());
  }
  if (arguments.only.empty()) return sequences;
  std::erase_if(sequences, [&](const OnePassSequence& sequence) {
    return std::find(arguments.only.begin(),
                     arguments.only.end(),
                     sequence.name) == arguments.only.end();
  });
  return sequences;
}

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(const std::vector<OnePassSequence> sequences,
                   ReadSequences(arguments));
  const std::vector<Contestant> contestants = Contestants(arguments);
  for (const Contestant& contestant : contestants) {
    std::error_code error;
    fs::create_directories(arguments.out / contestant.label, error);
  }
  std::vector<Tally> tallies(contestants.size());
  for (const OnePassSequence& sequence : sequences) {
    std::vector<SequenceRun> runs;
    ASSIGN_OR_RETURN(const ShownTruth shown,
                     RunSequence(sequence, arguments, contestants, runs));
    for (std::size_t k = 0; k < contestants.size(); ++k) {
      std::vector<OnePassScore> scores;
      for (const SequenceRun& run : runs) {
        if (run.contestant != k) continue;
        const ShownTruth of_run = From(shown, run.start);
        const std::string name =
            arguments.starts > 1
                ? absl::StrCat(sequence.name, "_from_", run.start)
                : sequence.name;
        WriteBoxes(run.follower->found(),
                   name,
                   of_run,
                   arguments.out / contestants[k].label);
        scores.push_back(tallies[k].Add(run.follower->found(), of_run));
      }
      const OnePassScore score = cli::Mean(scores);
      tallies[k].scores.push_back(score);
      std::cout << absl::StrFormat("%-24s %-24s precision %.3f AUC %.3f",
                                   contestants[k].label,
                                   sequence.name,
                                   score.PrecisionAt20px(),
                                   score.Auc())
                << std::endl;
    }
  }
  std::vector<Row> rows;
  for (std::size_t k = 0; k < contestants.size(); ++k) {
    rows.push_back(tallies[k].ToRow(contestants[k].label));
  }
  PrintTable(rows);
  return WritePlots(rows, arguments.out);
}

}  // namespace
}  // namespace groundlock

int main(int argc, char** argv) {
  CLI::App app("Scores 2D trackers on a folder of OTB-style sequences.");
  groundlock::Arguments arguments;
  app.add_option("sequences", arguments.sequences, "Folders, by commas")
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
  app.add_flag("--absences",
               arguments.absences,
               "Through a window that looks away from the target again and "
               "again");
  app.add_option(
         "--starts", arguments.starts, "Frames from which each sequence is run")
      ->check(CLI::Range(1, 1'000));
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
