// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/tracker_report.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/evaluate/html.h"

namespace groundlock::cli {
namespace {

using nlohmann::json;

std::string FigureText(const std::optional<PublishedFigure>& figure) {
  return figure ? absl::StrFormat("%.3f / %.2f", figure->auc, figure->precision)
                : std::string("-");
}

json FigureJson(const std::optional<PublishedFigure>& figure) {
  if (!figure) return nullptr;
  return {{"auc", figure->auc}, {"precision_20px", figure->precision}};
}

OnePassScore MeanScore(const MeasuredTracker& tracker) {
  std::vector<OnePassScore> scores;
  for (const TrackerRun& run : tracker.runs) scores.push_back(run.score);
  return Mean(scores);
}

std::string MeansHtml() {
  std::string html =
      "<h2>Published: 41 standard sequences</h2>\n"
      "<p>Other sequences than those above: what the trackers that the thesis "
      "is measured against reach in the mean.</p>\n"
      "<table><tr><th>tracker</th><th class='n'>precision at 20 px</th>"
      "<th class='n'>AUC</th><th>source</th></tr>\n";
  for (const PublishedMean& mean : PublishedMeans()) {
    absl::StrAppendFormat(&html,
                          "<tr class='published'><td>%s</td><td "
                          "class='n'>%.3f</td><td class='n'>%.3f</td>"
                          "<td>%s</td></tr>\n",
                          mean.tracker,
                          mean.figure.precision,
                          mean.figure.auc,
                          EscapeMarkup(mean.source));
  }
  return html + "</table>\n";
}

std::string TableHtml(const TrackerComparison& comparison) {
  const TrackerTable table = CompareTrackers(comparison);
  std::string html =
      "<h2>Sequence by sequence</h2>\n"
      "<p>AUC / precision at 20 px. Grey: published, rated by the same rules "
      "from the boxes that were published; black: measured here.</p>\n"
      "<table><tr><th>tracker</th>";
  for (const std::string& sequence : comparison.sequences) {
    absl::StrAppend(&html, "<th class='n'>", EscapeMarkup(sequence), "</th>");
  }
  absl::StrAppend(&html,
                  "<th class='n'>mean of the ",
                  table.common,
                  "<br>that all have</th><th>source</th></tr>\n");
  bool measured = false;
  for (const TrackerLine& line : table.lines) {
    const bool is_first = line.source.empty() && !measured;
    measured = line.source.empty();
    absl::StrAppend(&html,
                    line.source.empty()
                        ? is_first ? "<tr class='first'>" : "<tr>"
                        : "<tr class='published'>",
                    "<td>",
                    EscapeMarkup(line.tracker),
                    "</td>");
    for (const auto& figure : line.figures) {
      absl::StrAppend(&html, "<td class='n'>", FigureText(figure), "</td>");
    }
    absl::StrAppend(
        &html,
        "<td class='n'>",
        FigureText(line.mean),
        "</td><td>",
        line.source.empty() ? "measured" : EscapeMarkup(line.source),
        "</td></tr>\n");
  }
  return html + "</table>\n";
}

std::string TimesHtml(const TrackerComparison& comparison) {
  std::string html = absl::StrCat(
      "<h2>Time</h2>\n<p>Of a frame's tracking, wall clock in ms as the server "
      "measured it (",
      EscapeMarkup(comparison.machine),
      "), median / 95 %; other work on the machine shows in it.</p>\n"
      "<table><tr><th>tracker</th>");
  for (const std::string& sequence : comparison.sequences) {
    absl::StrAppend(&html, "<th class='n'>", EscapeMarkup(sequence), "</th>");
  }
  html += "</tr>\n";
  for (const MeasuredTracker& tracker : comparison.trackers) {
    absl::StrAppend(&html, "<tr><td>", EscapeMarkup(tracker.name), "</td>");
    for (const TrackerRun& run : tracker.runs) {
      absl::StrAppend(&html,
                      "<td class='n'>",
                      NumberText(run.track_ms.median, 1),
                      " / ",
                      NumberText(run.track_ms.p95, 1),
                      "</td>");
    }
    html += "</tr>\n";
  }
  return html + "</table>\n";
}

constexpr const char* kTrackerDefinitions =
    "<h2>How it was measured</h2>\n<ul>\n"
    "<li>One pass: each tracker is given the true box of the first frame that "
    "shows the target, and nothing after it (Wu, Lim, Yang, CVPR 2013).</li>\n"
    "<li>Ours and those of OpenCV ran in sessions of the server, without a "
    "map, every frame in order: as users meet them, with the session's own "
    "search for a target that is lost.</li>\n"
    "<li>AUC: the mean, over overlap thresholds 0, 0.05, &hellip; 1, of the "
    "share of frames whose box overlaps the true one by more. Precision: the "
    "share of frames whose box's centre is within 20 px. Frames that do not "
    "show the target are not rated.</li>\n</ul>\n";

}  // namespace

TrackerTable CompareTrackers(const TrackerComparison& comparison) {
  TrackerTable table;
  for (const PublishedTracker& tracker : PublishedTrackers()) {
    TrackerLine line{tracker.tracker, tracker.source, {}, std::nullopt};
    for (const std::string& sequence : comparison.sequences) {
      line.figures.push_back(tracker.On(sequence));
    }
    const bool any = std::any_of(line.figures.begin(),
                                 line.figures.end(),
                                 [](const auto& f) { return f.has_value(); });
    if (any) table.lines.push_back(std::move(line));
  }
  for (const MeasuredTracker& tracker : comparison.trackers) {
    TrackerLine line{tracker.name, "", {}, std::nullopt};
    for (const TrackerRun& run : tracker.runs) {
      line.figures.push_back(
          PublishedFigure{run.score.Auc(), run.score.PrecisionAt20px()});
    }
    table.lines.push_back(std::move(line));
  }
  std::vector<std::size_t> common;
  for (std::size_t i = 0; i < comparison.sequences.size(); ++i) {
    if (std::all_of(table.lines.begin(),
                    table.lines.end(),
                    [&](const TrackerLine& line) {
                      return line.figures[i].has_value();
                    })) {
      common.push_back(i);
    }
  }
  table.common = common.size();
  if (common.empty()) return table;
  for (TrackerLine& line : table.lines) {
    line.mean.emplace();
    for (const std::size_t i : common) {
      const auto share = 1.0 / static_cast<double>(common.size());
      line.mean->auc += share * line.figures[i]->auc;
      line.mean->precision += share * line.figures[i]->precision;
    }
  }
  return table;
}

std::string TrackerReportHtml(const TrackerComparison& comparison) {
  std::vector<LabelledScore> scores;
  for (const MeasuredTracker& tracker : comparison.trackers) {
    scores.push_back({tracker.name, MeanScore(tracker)});
  }
  const OnePassPlots plots = PlotScores(scores);
  const std::string caption = absl::StrCat(
      "Mean over the ", comparison.sequences.size(), " sequences, measured");
  return HtmlPage("Groundlock: trackers",
                  absl::StrCat("<p class='meta'>groundlock ",
                               EscapeMarkup(comparison.version),
                               " &middot; data: ",
                               EscapeMarkup(comparison.data),
                               " &middot; ",
                               EscapeMarkup(comparison.machine),
                               "</p>\n",
                               TableHtml(comparison),
                               "<div class='grid'>\n",
                               HtmlFigure(plots.success, caption),
                               HtmlFigure(plots.precision, caption),
                               "</div>\n",
                               MeansHtml(),
                               TimesHtml(comparison),
                               kTrackerDefinitions));
}

std::string TrackerReportJson(const TrackerComparison& comparison) {
  json means = json::array();
  for (const PublishedMean& mean : PublishedMeans()) {
    json object = FigureJson(mean.figure);
    object["tracker"] = mean.tracker;
    object["source"] = mean.source;
    means.push_back(std::move(object));
  }
  const TrackerTable table = CompareTrackers(comparison);
  json lines = json::array();
  for (const TrackerLine& line : table.lines) {
    json figures = json::object();
    for (std::size_t i = 0; i < comparison.sequences.size(); ++i) {
      figures[comparison.sequences[i]] = FigureJson(line.figures[i]);
    }
    lines.push_back({{"tracker", line.tracker},
                     {"measured", line.source.empty()},
                     {"source", line.source},
                     {"sequences", figures},
                     {"mean", FigureJson(line.mean)}});
  }
  json runs = json::array();
  for (const MeasuredTracker& tracker : comparison.trackers) {
    for (const TrackerRun& run : tracker.runs) {
      runs.push_back({{"tracker", tracker.name},
                      {"sequence", run.sequence},
                      {"frames", run.frames},
                      {"rated_frames", run.rated},
                      {"auc", run.score.Auc()},
                      {"precision_20px", run.score.PrecisionAt20px()},
                      {"success", run.score.success},
                      {"precision", run.score.precision},
                      {"track_median_ms", run.track_ms.median},
                      {"track_p95_ms", run.track_ms.p95}});
    }
  }
  return json{{"version", comparison.version},
              {"machine", comparison.machine},
              {"data", comparison.data},
              {"published_means_of_41_sequences", means},
              {"sequences_in_mean", table.common},
              {"table", lines},
              {"runs", runs}}
      .dump();
}

std::string TrackerReportText(const TrackerComparison& comparison) {
  std::string text;
  for (const TrackerLine& line : CompareTrackers(comparison).lines) {
    absl::StrAppendFormat(&text,
                          "%-12s %-9s",
                          line.tracker,
                          line.source.empty() ? "measured" : "published");
    for (std::size_t i = 0; i < comparison.sequences.size(); ++i) {
      absl::StrAppendFormat(&text,
                            "  %s %s",
                            comparison.sequences[i],
                            FigureText(line.figures[i]));
    }
    absl::StrAppendFormat(&text, "  mean %s\n", FigureText(line.mean));
  }
  return text;
}

}  // namespace groundlock::cli
