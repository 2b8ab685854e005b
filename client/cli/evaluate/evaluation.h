// SPDX-License-Identifier: Apache-2.0
// What `groundlock evaluate` has measured, before it is a report.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_EVALUATION_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_EVALUATION_H_

#include <cstdint>
#include <string>
#include <vector>

#include "client/cli/evaluate/scores.h"

namespace groundlock::cli {

// How a session localises and tracks; empty = the server's default.
struct Configuration {
  std::string localizer;
  std::string tracker;
  // "defaults", or "baseline+act".
  std::string Name() const {
    if (localizer.empty() && tracker.empty()) return "defaults";
    return localizer + "+" + tracker;
  }
};

struct Still {
  std::uint64_t frame = 0;
  std::string what;  // "hidden", "seen again", …
  std::string jpeg;
};

struct EvaluatedRun {
  Configuration configuration;
  std::vector<FrameScore> frames;
  RunScore score;
  std::vector<Still> stills;
};

// A sequence, run in each configuration.
struct Experiment {
  std::string name;   // the video's, without folder and extension
  std::string video;  // its file name
  std::vector<EvaluatedRun> runs;
};

struct Evaluation {
  std::string version;  // of the program
  std::string machine;  // "AMD … (2 cores)"
  std::string data;     // name of the folder
  std::uint64_t map_landmarks = 0;
  std::vector<Experiment> experiments;
};

// The figures of A. Robinson, "Implementation and evaluation of a 3D tracker",
// LiTH-ISY-EX--14/4800--SE, 2014, chapter 4: a hand-held camera of 1280x720 at
// 24 frames/s, 1.6 m above the ground, and a car 0.5 m wide.
namespace published {
inline constexpr double kCameraError_m = 0.03;    // "typically below"
inline constexpr double kCameraError_deg = 0.05;  // likewise
inline constexpr double kCameraSpike_m = 0.08;    // one spike
inline constexpr double kCameraSpike_deg = 0.2;   // .15 to .2
inline constexpr double kGoodUpTo_m = 11.2;       // within 25 cm, scale
inline constexpr double kGoodDownTo_deg = 7.6;    // the angle there
inline constexpr double kFarDistance_m = 20.0;    // scale
inline constexpr double kFarError_m = 2.7;        // there
inline constexpr double kBias_m = 0.20;           // S-run, 3 to 4.5 m
inline constexpr double kBiasLeast_m = 0.14;
inline constexpr double kBiasMost_m = 0.27;
inline constexpr double kFrame_ms = 124.7;  // features not included
}  // namespace published

// One HTML page with everything in it: no script, no font, no address.
std::string ReportHtml(const Evaluation& evaluation);
// The same as one JSON object: figures per run, and per frame.
std::string ReportJson(const Evaluation& evaluation);
// The figures for a terminal.
std::string ReportText(const Evaluation& evaluation);

// A line of the table that stands at the report's head: a figure of the thesis
// beside ours.
struct ComparedFigure {
  std::string experiment, figure, published;
  std::vector<std::string> ours;  // in the order of the runs
  // Of ours, whether it falls short of what is published; in the same order.
  std::vector<bool> worse;
};
// Only of experiments that the thesis has: srun, scale, outofview, occlusion.
std::vector<ComparedFigure> CompareWithThesis(const Evaluation& evaluation);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_EVALUATION_H_
