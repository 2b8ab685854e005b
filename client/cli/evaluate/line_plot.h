// SPDX-License-Identifier: Apache-2.0
// Line charts as SVG, without fonts or scripts of their own.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_LINE_PLOT_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_LINE_PLOT_H_

#include <Eigen/Core>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/status.h"

namespace groundlock::cli {

struct PlotLine {
  std::string label = {};  // in the legend; empty = not there
  // A point that is not finite interrupts the line.
  std::vector<Eigen::Vector2d> points = {};
  bool markers = false;  // a dot at every point
  bool line = true;      // false: the dots alone
  bool dashed = false;
  std::string colour =
      {};  // "#rrggbb"; empty = the palette's, by the line's index
};

// A span of x that stands out: what happened then.
struct PlotBand {
  double from = 0.0, to = 0.0;
  std::string label;
};

struct LinePlot {
  std::string title, x_label, y_label;
  Eigen::Vector2d min = Eigen::Vector2d::Zero();  // of the axes
  Eigen::Vector2d max = Eigen::Vector2d::Ones();
  std::vector<PlotLine> lines;  // cut off at the axes' ends
  std::vector<PlotBand> bands;
  int width_px = 640, height_px = 440;
  // One unit is as long along x as along y: the axes are widened for it.
  bool same_scale = false;
  bool diagonal = false;  // a thin line from min to max
  enum class Legend { kRight, kLeft, kAbove } legend = Legend::kRight;
};

// The palette's i-th colour (Okabe and Ito's, which people with any colour
// vision tell apart).
const char* PlotColour(std::size_t i);

std::string ToSvg(const LinePlot& plot);
absl::Status WriteSvg(const LinePlot& plot, const std::filesystem::path& path);

// Text for HTML and SVG.
std::string EscapeMarkup(const std::string& text);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_LINE_PLOT_H_
