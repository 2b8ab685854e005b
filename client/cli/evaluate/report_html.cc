// SPDX-License-Identifier: Apache-2.0
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "client/cli/evaluate/evaluation.h"
#include "client/cli/evaluate/figures.h"
#include "client/cli/evaluate/html.h"

namespace groundlock::cli {
namespace {

struct Heading {
  const char* name;
  const char* title;
  const char* text;
};
constexpr Heading kHeadings[] = {
    {"srun",
     "S-run",
     "The car drives an S towards the camera, which backs away (thesis, "
     "sections 4.2 and 4.3)."},
    {"scale",
     "Scale",
     "The camera stays; the car drives away, until the ground is seen at a "
     "flat angle."},
    {"outofview",
     "Out of view",
     "The camera turns away from the standing car and comes back to it from "
     "another side."},
    {"occlusion",
     "Occlusion",
     "The car passes behind an obstacle that hides it completely."}};

std::string Escaped(const std::string& text) { return EscapeMarkup(text); }

std::string ComparisonTable(const Evaluation& evaluation) {
  const std::vector<ComparedFigure> rows = CompareWithThesis(evaluation);
  if (rows.empty()) return "";
  std::string html =
      "<h2>Published and measured</h2>\n"
      "<p>Left what the thesis reports of a real car park, right what was "
      "measured here. The places differ, so the figures tell whether the "
      "method "
      "does what it did, not by how much one is better.</p>\n"
      "<table><tr><th>experiment</th><th>figure</th><th>thesis "
      "(published)</th>";
  for (const EvaluatedRun& run : evaluation.experiments.front().runs) {
    absl::StrAppend(&html, "<th>", Escaped(run.configuration.Name()), "</th>");
  }
  html += "</tr>\n";
  std::string last;
  for (const ComparedFigure& row : rows) {
    const bool is_first = row.experiment != last;
    last = row.experiment;
    absl::StrAppend(&html,
                    is_first ? "<tr class='first'><td>" : "<tr><td>",
                    is_first ? Escaped(row.experiment) : "",
                    "</td><td>",
                    Escaped(row.figure),
                    "</td><td>",
                    Escaped(row.published),
                    "</td>");
    for (std::size_t i = 0; i < row.ours.size(); ++i) {
      absl::StrAppend(&html,
                      row.worse[i] ? "<td class='worse'>" : "<td>",
                      Escaped(row.ours[i]),
                      "</td>");
    }
    html += "</tr>\n";
  }
  return html + "</table>\n";
}

std::string RunTable(const Experiment& experiment) {
  std::string html =
      "<table><tr><th>configuration</th><th class='n'>frames</th>"
      "<th class='n'>localised</th><th class='n'>camera, cm<br>median / 95 "
      "%</th>"
      "<th class='n'>camera, degrees<br>median / 95 %</th>"
      "<th class='n'>inliers<br>median</th>"
      "<th class='n'>target seen, cm<br>median / 95 %</th>"
      "<th class='n'>target hidden, cm<br>median / largest</th>"
      "<th class='n'>overlap<br>mean</th>"
      "<th class='n'>locked at<br>the end</th></tr>\n";
  for (const EvaluatedRun& run : experiment.runs) {
    const RunScore& s = run.score;
    const auto cell = [&](const std::string& text) {
      absl::StrAppend(&html, "<td class='n'>", text, "</td>");
    };
    absl::StrAppend(
        &html, "<tr><td>", Escaped(run.configuration.Name()), "</td>");
    cell(absl::StrCat(s.frames));
    cell(NumberText(100.0 * s.camera_tracked, 1) + " %");
    cell(NumberText(100.0 * s.camera_error_m.median, 2) + " / " +
         NumberText(100.0 * s.camera_error_m.p95, 2));
    cell(NumberText(s.camera_error_deg.median, 3) + " / " +
         NumberText(s.camera_error_deg.p95, 3));
    cell(NumberText(s.inliers.median, 0));
    cell(NumberText(100.0 * s.target_error_seen_m.median, 1) + " / " +
         NumberText(100.0 * s.target_error_seen_m.p95, 1));
    cell(NumberText(100.0 * s.target_error_hidden_m.median, 1) + " / " +
         NumberText(100.0 * s.target_error_hidden_m.max, 1));
    cell(NumberText(s.mean_overlap, 3));
    cell(NumberText(100.0 * s.locked_at_end, 0) + " %");
    html += "</tr>\n";
  }
  return html + "</table>\n";
}

std::string StillsHtml(const EvaluatedRun& run) {
  if (run.stills.empty()) return "";
  std::string html = absl::StrCat("<h3>Seen by the camera: ",
                                  Escaped(run.configuration.Name()),
                                  "</h3>\n<div class='grid'>\n");
  for (const Still& still : run.stills) {
    const std::string caption =
        absl::StrCat("Frame ", still.frame, ", ", still.what);
    absl::StrAppend(&html,
                    "<figure><img alt='",
                    Escaped(caption),
                    "' src='data:image/jpeg;base64,",
                    absl::Base64Escape(still.jpeg),
                    "'><figcaption>",
                    Escaped(caption),
                    "</figcaption></figure>\n");
  }
  return html + "</div>\n";
}

std::string ExperimentHtml(const Experiment& experiment) {
  std::string title = experiment.name;
  std::string text;
  for (const Heading& heading : kHeadings) {
    if (experiment.name != heading.name) continue;
    title = heading.title;
    text = heading.text;
  }
  std::string html = absl::StrCat("<h2>",
                                  Escaped(title),
                                  "</h2>\n<p>",
                                  Escaped(text),
                                  " <span class='meta'>",
                                  Escaped(experiment.video),
                                  "</span></p>\n",
                                  RunTable(experiment),
                                  "<div class='grid'>\n");
  for (const Figure& figure : CameraFigures(experiment)) {
    html += HtmlFigure(figure.plot, figure.caption);
  }
  for (const Figure& figure : TargetFigures(experiment)) {
    html += HtmlFigure(figure.plot, figure.caption);
  }
  html += "</div>\n";
  for (const EvaluatedRun& run : experiment.runs) html += StillsHtml(run);
  return html;
}

std::string TimingHtml(const Evaluation& evaluation) {
  std::string html = absl::StrCat(
      "<h2>Time</h2>\n<p>Wall clock per frame in ms, as the server measured it "
      "(",
      Escaped(evaluation.machine),
      "), median / 95 %; other work on the machine shows in it. The thesis "
      "reports 124.7 ms on four cores of a Xeon W3520 with a GTX 760, without "
      "the extraction of features; here it is included.</p>\n"
      "<table><tr><th>experiment</th><th>configuration</th><th class='n'>decode"
      "</th><th class='n'>localise</th><th class='n'>track</th>"
      "<th class='n'>total</th></tr>\n");
  for (const Experiment& experiment : evaluation.experiments) {
    for (const EvaluatedRun& run : experiment.runs) {
      absl::StrAppend(&html,
                      "<tr><td>",
                      Escaped(experiment.name),
                      "</td><td>",
                      Escaped(run.configuration.Name()),
                      "</td>");
      for (const Spread* times : {&run.score.decode_ms,
                                  &run.score.localize_ms,
                                  &run.score.track_ms,
                                  &run.score.total_ms}) {
        absl::StrAppend(&html,
                        "<td class='n'>",
                        NumberText(times->median, 1),
                        " / ",
                        NumberText(times->p95, 1),
                        "</td>");
      }
      html += "</tr>\n";
    }
  }
  html += "</table>\n<div class='grid'>\n";
  for (const Figure& figure : TimeFigures(evaluation.experiments.front())) {
    html += HtmlFigure(figure.plot, figure.caption);
  }
  return html + "</div>\n";
}

constexpr const char* kDefinitions =
    "<h2>How it was measured</h2>\n<ul>\n"
    "<li>Every frame went through a session of the server, in order, none "
    "dropped; the target was marked once, by its true box in the first frame "
    "in "
    "which it can be seen.</li>\n"
    "<li>Camera: centre and orientation against the truth, in frames whose "
    "pose "
    "is TRACKED; a pose that is held or extrapolated is not counted as "
    "measured.</li>\n"
    "<li>Target: the centre of its base on the ground, horizontally. Seen: "
    "more "
    "than half of its side towards the camera; hidden: less than 2 %. Its "
    "distance: from the camera's centre as found to the target as found, "
    "against the true one.</li>\n"
    "<li>Overlap: intersection over union of the 2D box and the box around "
    "what "
    "can be seen. Locked: above 0.3; at the end: in the last 24 frames in "
    "which "
    "it is seen.</li>\n"
    "<li>Pictures: purple the landmarks that fit, white the 2D box (orange and "
    "dashed where it is predicted), yellow the 3D box with its front face "
    "green, blue the confidence; in the corner the place where a small "
    "target truly is, enlarged.</li>\n</ul>\n";

}  // namespace

std::string ReportHtml(const Evaluation& evaluation) {
  std::string html = absl::StrCat(
      "<p class='meta'>groundlock ",
      Escaped(evaluation.version),
      " &middot; data: ",
      Escaped(evaluation.data),
      " &middot; map of ",
      evaluation.map_landmarks,
      " landmarks &middot; ",
      Escaped(evaluation.machine),
      "</p>\n<p>The experiments of A. Robinson, <em>Implementation and "
      "evaluation of a 3D tracker</em> (Link&ouml;ping University, "
      "LiTH-ISY-EX--14/4800--SE, 2014), chapter 4, run again. "
      "<strong>baseline+act</strong> is the way of the thesis: every frame is "
      "matched to the map's views, and the target is followed by the adaptive "
      "colour tracker; <strong>defaults</strong> is what sessions use unless "
      "told otherwise.</p>\n",
      ComparisonTable(evaluation));
  for (const Experiment& experiment : evaluation.experiments) {
    html += ExperimentHtml(experiment);
  }
  return HtmlPage("Groundlock: evaluation",
                  absl::StrCat(html, TimingHtml(evaluation), kDefinitions));
}

}  // namespace groundlock::cli
