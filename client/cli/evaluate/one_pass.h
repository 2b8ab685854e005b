// SPDX-License-Identifier: Apache-2.0
// One-pass evaluation of single-object tracking as the online tracking
// benchmark does it (OTB: Y. Wu, J. Lim, M.-H. Yang, CVPR 2013): sequences with
// a box per frame, and how well boxes agree with them.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_ONE_PASS_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_ONE_PASS_H_

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cli/evaluate/line_plot.h"
#include "map_store/geometry/box.h"

namespace groundlock::cli {

struct OnePassSequence {
  std::string name;
  std::vector<std::filesystem::path> images;  // in the order of their names
  std::filesystem::path video;                // in place of images
  int first_frame = 0;                        // of the video
  double frames_per_second = 25.0;            // of images, which do not say
  // Of the first frames or all; not finite where the target cannot be seen. One
  // of them is finite.
  std::vector<geometry::Box2> truth_px;
};

// Sequences of images: FOLDER/<name>/groundtruth.txt (x,y,w,h per frame, pixels
// counted from 1) and FOLDER/<name>/img/*; img may be a text file with the
// images' folder, which is how a symbolic link is checked out where there are
// none. Flights: FOLDER/<name>.txt beside <name>.mp4, or, of one <name>.mp4,
// <name>_1.txt, <name>_2.txt and so on, each from the frame on with which the
// one before ends. Sorted by name. Errors name the file and the line.
absl::StatusOr<std::vector<OnePassSequence>> ReadOnePassSequences(
    const std::filesystem::path& folder);

// A box per line that is not empty: x,y,w,h, separated by commas, tabs or
// spaces, pixels counted from 1 (the boxes returned count from 0). NaN, or a
// box without an area: the target cannot be seen. Errors name the line.
absl::StatusOr<std::vector<geometry::Box2>> BoxesFromText(
    std::string_view text);

inline constexpr int kOverlapSteps = 20;   // thresholds 0, 0.05, ... 1
inline constexpr int kDistanceSteps = 50;  // thresholds 0, 1, ... 50 px

// Shares of frames, of one sequence or the mean over several.
struct OnePassScore {
  std::array<double, kOverlapSteps + 1> success{};     // overlap above it
  std::array<double, kDistanceSteps + 1> precision{};  // centre within it
  double Auc() const;  // mean success over the thresholds
  double PrecisionAt20px() const { return precision[20]; }
};

// Compares frame by frame, as far as both go, where the truth is finite. A box
// that is not finite is none.
OnePassScore Rate(const std::vector<geometry::Box2>& found_px,
                  const std::vector<geometry::Box2>& truth_px);
OnePassScore Mean(const std::vector<OnePassScore>& scores);

// The benchmark's two plots, the best line first.
struct OnePassPlots {
  LinePlot precision, success;
};
struct LabelledScore {
  std::string label;
  OnePassScore score;
};
OnePassPlots PlotScores(std::vector<LabelledScore> scores);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_ONE_PASS_H_
