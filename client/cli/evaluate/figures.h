// SPDX-License-Identifier: Apache-2.0
// The report's figures, as the thesis shows them.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_FIGURES_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_FIGURES_H_

#include <string>
#include <vector>

#include "client/cli/evaluate/evaluation.h"
#include "client/cli/evaluate/line_plot.h"

namespace groundlock::cli {

struct Figure {
  LinePlot plot;
  std::string caption;
};

// Of the camera's pose: position and rotation over time, inliers.
std::vector<Figure> CameraFigures(const Experiment& experiment);
// Of the target: from above, error over time, overlap; and where the distance
// changes much, the distance's error over it and over the angle under the
// horizon. None if the truth has no target.
std::vector<Figure> TargetFigures(const Experiment& experiment);
// Time per frame, one figure per run.
std::vector<Figure> TimeFigures(const Experiment& experiment);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_FIGURES_H_
