// SPDX-License-Identifier: Apache-2.0
// The table of published figures beside ours.
#include <cmath>
#include <functional>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/cli/evaluate/evaluation.h"

namespace groundlock::cli {
namespace {

// A cell, and whether it falls short of what is published.
struct Cell {
  std::string text;
  bool worse = false;
};
using Measure = std::function<Cell(const RunScore&)>;

std::string Centimetres(double metres) {
  return std::isfinite(metres) ? absl::StrFormat("%.1f cm", 100.0 * metres)
                               : std::string("-");
}

class Table {
 public:
  void Add(const Experiment& experiment,
           const std::string& figure,
           const std::string& published,
           const Measure& measure) {
    ComparedFigure row{experiment.name, figure, published, {}, {}};
    for (const EvaluatedRun& run : experiment.runs) {
      const Cell cell = measure(run.score);
      row.ours.push_back(cell.text);
      row.worse.push_back(cell.worse);
    }
    rows_.push_back(std::move(row));
  }
  std::vector<ComparedFigure> Take() { return std::move(rows_); }

 private:
  std::vector<ComparedFigure> rows_;
};

// A run that localises no frame has no error, and is no better for it.
void AddCamera(const Experiment& experiment, Table& table) {
  table.Add(experiment,
            "camera position, median / 95 % / largest",
            "typically < 3 cm, one spike of 8 cm",
            [](const RunScore& score) -> Cell {
              const Spread& e = score.camera_error_m;
              return {absl::StrFormat("%.2f / %.2f / %.2f cm",
                                      100.0 * e.median,
                                      100.0 * e.p95,
                                      100.0 * e.max),
                      !(e.median < published::kCameraError_m &&
                        e.max <= published::kCameraSpike_m)};
            });
  table.Add(experiment,
            "camera rotation, median / 95 % / largest",
            "typically < 0.05\u00b0, one spike of 0.15\u20130.2\u00b0",
            [](const RunScore& score) -> Cell {
              const Spread& e = score.camera_error_deg;
              return {absl::StrFormat(
                          "%.3f / %.3f / %.3f\u00b0", e.median, e.p95, e.max),
                      !(e.median < published::kCameraError_deg &&
                        e.max <= published::kCameraSpike_deg)};
            });
  table.Add(experiment,
            "frames in which the camera is localised",
            "-",
            [](const RunScore& score) -> Cell {
              return {absl::StrFormat("%.1f %%", 100.0 * score.camera_tracked)};
            });
}

void AddScale(const Experiment& experiment, Table& table) {
  table.Add(experiment,
            "distance of the target within 25 cm, up to",
            "11.2 m (7.6\u00b0 under the horizon)",
            [](const RunScore& score) -> Cell {
              if (!score.good_up_to_m) {
                const bool any = score.abs_distance_error_seen_m.count > 0;
                return {any ? absl::StrFormat("the end, %.1f m",
                                              score.greatest_distance_m)
                            : std::string("-"),
                        !any};
              }
              return {absl::StrFormat("%.1f m (%.1f\u00b0)",
                                      *score.good_up_to_m,
                                      *score.good_down_to_deg),
                      *score.good_up_to_m < published::kGoodUpTo_m};
            });
  table.Add(experiment,
            "error of the distance in the farthest metre, median",
            "about 2.7 m at 20 m",
            [](const RunScore& score) -> Cell {
              const double error = score.abs_distance_error_far_m.median;
              if (!std::isfinite(error)) return {"-", true};
              return {absl::StrFormat(
                          "%.2f m at %.1f m", error, score.greatest_distance_m),
                      error > published::kFarError_m};
            });
}

void AddBias(const Experiment& experiment, Table& table) {
  table.Add(experiment,
            "error of the distance, mean (5\u201395 %)",
            "bias of about 20 cm (14\u201327 cm)",
            [](const RunScore& score) -> Cell {
              const Spread& e = score.abs_distance_error_seen_m;
              if (e.count == 0) return {"-", true};
              return {absl::StrFormat("%s (%.1f\u2013%.1f cm)",
                                      Centimetres(e.mean),
                                      100.0 * e.p05,
                                      100.0 * e.p95),
                      e.mean > published::kBias_m};
            });
  table.Add(
      experiment,
      "position on the ground, median / 95 %",
      "-",
      [](const RunScore& score) -> Cell {
        const Spread& e = score.target_error_seen_m;
        return {absl::StrCat(Centimetres(e.median), " / ", Centimetres(e.p95))};
      });
}

void AddAbsence(const Experiment& experiment,
                const std::string& published,
                Table& table) {
  table.Add(experiment,
            "the target after it was out of sight",
            published,
            [](const RunScore& score) -> Cell {
              std::vector<std::string> words;
              bool worse = false;
              for (const Absence& absence : score.absences) {
                if (!absence.first_seen) continue;
                if (!absence.locked_after) {
                  words.emplace_back("lost");
                  worse = true;
                } else {
                  words.push_back(
                      absl::StrFormat("kept: hidden or half seen in frames "
                                      "%d\u2013%d, locked %d frames after",
                                      absence.first_hidden,
                                      *absence.first_seen - 1,
                                      *absence.locked_after));
                }
              }
              if (words.empty()) return {"-"};
              return {absl::StrJoin(words, "; "), worse};
            });
  table.Add(
      experiment,
      "position on the ground while hidden, median / largest",
      "-",
      [](const RunScore& score) -> Cell {
        const Spread& e = score.target_error_hidden_m;
        return {absl::StrCat(Centimetres(e.median), " / ", Centimetres(e.max))};
      });
  table.Add(experiment,
            "locked in the last second in which it is seen",
            "yes",
            [](const RunScore& score) -> Cell {
              return {absl::StrFormat("%.0f %%", 100.0 * score.locked_at_end),
                      !(score.locked_at_end > 0.5)};
            });
}

void AddTime(const Experiment& experiment, Table& table) {
  table.Add(experiment,
            "time per frame, median / 95 %",
            "124.7 ms, features not included",
            [](const RunScore& score) -> Cell {
              return {absl::StrFormat("%.1f / %.1f ms",
                                      score.total_ms.median,
                                      score.total_ms.p95),
                      score.total_ms.median > published::kFrame_ms};
            });
}

}  // namespace

std::vector<ComparedFigure> CompareWithThesis(const Evaluation& evaluation) {
  Table table;
  for (const Experiment& experiment : evaluation.experiments) {
    if (experiment.name == "srun") {
      AddCamera(experiment, table);
      AddBias(experiment, table);
      AddTime(experiment, table);
    } else if (experiment.name == "scale") {
      AddCamera(experiment, table);
      AddScale(experiment, table);
      AddTime(experiment, table);
    } else if (experiment.name == "outofview") {
      AddAbsence(experiment,
                 "kept (TLD finds it again; Struck, EDFT and ACT lose it)",
                 table);
      AddTime(experiment, table);
    } else if (experiment.name == "occlusion") {
      AddAbsence(experiment,
                 "kept over 45 hidden frames (Struck, EDFT, TLD and ACT lose "
                 "it)",
                 table);
      AddTime(experiment, table);
    }
  }
  return table.Take();
}

std::string ReportText(const Evaluation& evaluation) {
  std::string text;
  for (const Experiment& experiment : evaluation.experiments) {
    for (const EvaluatedRun& run : experiment.runs) {
      const RunScore& s = run.score;
      absl::StrAppendFormat(
          &text,
          "%-12s %-14s camera %5.1f %%  %5.2f cm  %6.3f deg   target %6.1f cm "
          " overlap %.3f  locked at the end %3.0f %%   %6.1f ms\n",
          experiment.name,
          run.configuration.Name(),
          100.0 * s.camera_tracked,
          100.0 * s.camera_error_m.median,
          s.camera_error_deg.median,
          100.0 * s.target_error_seen_m.median,
          s.mean_overlap,
          100.0 * s.locked_at_end,
          s.total_ms.median);
    }
  }
  return text;
}

}  // namespace groundlock::cli
