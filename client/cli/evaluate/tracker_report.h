// SPDX-License-Identifier: Apache-2.0
// What `groundlock evaluate --trackers` has measured, beside what is published.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_TRACKER_REPORT_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_TRACKER_REPORT_H_

#include <optional>
#include <string>
#include <vector>

#include "client/cli/evaluate/one_pass.h"
#include "client/cli/evaluate/scores.h"

namespace groundlock::cli {

struct TrackerRun {
  std::string sequence;
  std::size_t frames = 0;
  std::size_t rated = 0;  // of them show the target
  OnePassScore score;
  Spread track_ms;  // the server's wall clock of a frame's tracking
};

struct MeasuredTracker {
  std::string name;
  std::vector<TrackerRun> runs;  // in the order of the sequences
};

struct TrackerComparison {
  std::string version;  // of the program
  std::string machine;
  std::string data;  // name of the folder
  std::vector<std::string> sequences;
  std::vector<MeasuredTracker> trackers;
};

// A figure that others reach, area under the success curve and precision at 20
// px, each as a share.
struct PublishedFigure {
  double auc = 0.0;
  double precision = 0.0;
};

// Means over 41 standard sequences, as Robinson 2014 reports them
// (LiTH-ISY-EX--14/4800--SE).
struct PublishedMean {
  const char* tracker;
  const char* source;
  PublishedFigure figure;
};
const std::vector<PublishedMean>& PublishedMeans();

// On single sequences of UAV123 (10 frames/s) and UAVDT: the result files that
// were published with these trackers, rated by the rules of one_pass.h.
struct PublishedTracker {
  const char* tracker;
  const char* source;  // of the tracker
  // Unset: nothing published for it.
  std::optional<PublishedFigure> On(const std::string& sequence) const;
};
const std::vector<PublishedTracker>& PublishedTrackers();

// A line of the table: of a tracker as published, or as measured.
struct TrackerLine {
  std::string tracker;
  std::string source;  // of what is published; empty = measured
  // In the order of the sequences; unset: there is none.
  std::vector<std::optional<PublishedFigure>> figures;
  // Over those sequences for which every line has a figure; unset: there are
  // none.
  std::optional<PublishedFigure> mean;
};
struct TrackerTable {
  std::vector<TrackerLine> lines;  // the published first
  std::size_t common = 0;  // sequences for which every line has a figure
};
TrackerTable CompareTrackers(const TrackerComparison& comparison);

// One HTML page with everything in it, the same as JSON, and for a terminal.
std::string TrackerReportHtml(const TrackerComparison& comparison);
std::string TrackerReportJson(const TrackerComparison& comparison);
std::string TrackerReportText(const TrackerComparison& comparison);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_TRACKER_REPORT_H_
