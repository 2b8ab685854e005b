// SPDX-License-Identifier: Apache-2.0
// Line charts as SVG.
#ifndef GROUNDLOCK_TESTS_SUPPORT_LINE_PLOT_H_
#define GROUNDLOCK_TESTS_SUPPORT_LINE_PLOT_H_

#include <Eigen/Core>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace groundlock::test_support {

struct PlotLine {
  std::string label;  // in the legend
  std::vector<Eigen::Vector2d> points;
  bool markers = false;  // a dot at every point
};

struct LinePlot {
  std::string title, x_label, y_label;
  Eigen::Vector2d min = Eigen::Vector2d::Zero();  // of the axes
  Eigen::Vector2d max = Eigen::Vector2d::Ones();
  std::vector<PlotLine> lines;
  bool diagonal = false;        // a thin line from min to max
  bool legend_at_left = false;  // else at the right, below if lines fall
  bool legend_at_top = true;
};

// The chart, 640 x 440, without fonts or scripts of its own.
std::string ToSvg(const LinePlot& plot);
absl::Status WriteSvg(const LinePlot& plot, const std::filesystem::path& path);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_LINE_PLOT_H_
