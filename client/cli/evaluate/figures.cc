// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/figures.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_format.h"

namespace groundlock::cli {
namespace {

using Eigen::Vector2d;

constexpr const char* kTruthColour = "#000000";
constexpr const char* kThesisColour = "#888888";
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
// From this ratio of greatest and least distance on, the distance is what a
// sequence is about.
constexpr double kDistanceRatio = 2.5;

// The defaults are blue in every report, whatever stands beside them.
const char* RunColour(const Experiment& experiment, std::size_t run) {
  constexpr std::size_t kBlue = 1;
  if (experiment.runs[run].configuration.Name() == "defaults") {
    return PlotColour(kBlue);
  }
  std::size_t others = 0;
  for (std::size_t i = 0; i < run; ++i) {
    if (experiment.runs[i].configuration.Name() != "defaults") ++others;
  }
  return PlotColour(others < kBlue ? others : others + 1);
}

// What `value` finds in a frame (nullopt: nothing) over `at`, a line per run.
template <typename At, typename Value>
std::vector<PlotLine> Lines(const Experiment& experiment,
                            const At& at,
                            const Value& value) {
  std::vector<PlotLine> lines;
  for (std::size_t i = 0; i < experiment.runs.size(); ++i) {
    PlotLine& line = lines.emplace_back();
    line.label = experiment.runs[i].configuration.Name();
    line.colour = RunColour(experiment, i);
    for (const FrameScore& frame : experiment.runs[i].frames) {
      const std::optional<double> x = at(frame);
      const std::optional<double> y = value(frame);
      line.points.emplace_back(x.value_or(kNone), y.value_or(kNone));
    }
  }
  return lines;
}

std::optional<double> Time(const FrameScore& frame) { return frame.time_s; }

std::optional<double> Times(const std::optional<double>& value, double factor) {
  if (!value) return std::nullopt;
  return *value * factor;
}

PlotLine Level(const std::string& label, double y) {
  return {.label = label,
          .points = {{-1e6, y}, {1e6, y}},
          .markers = false,
          .line = true,
          .dashed = true,
          .colour = kThesisColour};
}

// Axes around the points: x as wide as they are, y from 0 to a little above
// them and above `least`.
void FitAxes(double least, LinePlot& plot) {
  double from = std::numeric_limits<double>::max();
  double to = std::numeric_limits<double>::lowest();
  double top = least;
  for (const PlotLine& line : plot.lines) {
    for (const Vector2d& p : line.points) {
      if (!p.allFinite() || std::abs(p.x()) > 1e5) continue;
      from = std::min(from, p.x());
      to = std::max(to, p.x());
      top = std::max(top, p.y());
    }
  }
  if (from > to) from = 0.0, to = 1.0;
  plot.min = {from, 0.0};
  plot.max = {to, 1.08 * top};
}

// When the target was hidden, by the truth.
std::vector<PlotBand> HiddenBands(const Experiment& experiment) {
  std::vector<PlotBand> bands;
  bool open = false;
  for (const FrameScore& frame : experiment.runs.front().frames) {
    if (frame.hidden() && !open && frame.true_target_world) {
      bands.push_back({frame.time_s, frame.time_s, "out of sight"});
    }
    open = frame.hidden() && frame.true_target_world.has_value();
    if (open) bands.back().to = frame.time_s;
  }
  return bands;
}

LinePlot OverTime(const std::string& title, const std::string& y_label) {
  LinePlot plot;
  plot.title = title;
  plot.x_label = "time, s";
  plot.y_label = y_label;
  plot.height_px = 280;
  plot.legend = LinePlot::Legend::kAbove;
  return plot;
}

// Axes around the first two lines, which are true: what is far off must not
// shrink the rest. The plot lies along the way's longer side.
void FitView(LinePlot& plot) {
  Vector2d min = Vector2d::Constant(1e9);
  Vector2d max = Vector2d::Constant(-1e9);
  for (std::size_t i = 0; i < 2; ++i) {
    for (const Vector2d& p : plot.lines[i].points) {
      if (!p.allFinite()) continue;
      min = min.cwiseMin(p);
      max = max.cwiseMax(p);
    }
  }
  plot.min = min - Vector2d::Constant(0.5);
  plot.max = max + Vector2d::Constant(0.5);
  plot.x_label = "x, m";
  plot.y_label = "y, m";
  if ((max - min).y() <= (max - min).x()) return;
  for (PlotLine& line : plot.lines) {
    for (Vector2d& p : line.points) p = Vector2d(p.y(), -p.x());
  }
  plot.x_label = "y, m";
  plot.y_label = "-x, m";
  const Vector2d low = plot.min;
  plot.min = {low.y(), -plot.max.x()};
  plot.max = {plot.max.y(), -low.x()};
}

Figure FromAbove(const Experiment& experiment) {
  Figure figure;
  LinePlot& plot = figure.plot;
  plot.title = "From above";
  plot.height_px = 280;
  plot.same_scale = true;
  plot.legend = LinePlot::Legend::kAbove;
  PlotLine truth{.label = "target, true", .colour = kTruthColour};
  PlotLine camera{
      .label = "camera, true", .dashed = true, .colour = kThesisColour};
  for (const FrameScore& frame : experiment.runs.front().frames) {
    camera.points.push_back(frame.true_camera_world.head<2>());
    truth.points.push_back(frame.true_target_world
                               ? Vector2d(frame.true_target_world->head<2>())
                               : Vector2d(kNone, kNone));
  }
  plot.lines = {camera, truth};
  std::string bias;
  for (std::size_t i = 0; i < experiment.runs.size(); ++i) {
    const EvaluatedRun& run = experiment.runs[i];
    PlotLine line{.label = run.configuration.Name(),
                  .colour = RunColour(experiment, i)};
    for (const FrameScore& frame : run.frames) {
      line.points.push_back(frame.target_world
                                ? Vector2d(frame.target_world->head<2>())
                                : Vector2d(kNone, kNone));
    }
    plot.lines.push_back(std::move(line));
    if (run.score.along_error_seen_m.count == 0) continue;
    bias += absl::StrFormat("%s%s %+.1f cm",
                            bias.empty() ? "" : ", ",
                            run.configuration.Name(),
                            100.0 * run.score.along_error_seen_m.mean);
  }
  FitView(plot);
  figure.caption =
      "The way of the target on the ground, seen from above, and the camera's. "
      "Bias away from the camera, mean while the target is seen: " +
      (bias.empty() ? std::string("none measured") : bias) + ".";
  return figure;
}

void AddDistanceFigures(const Experiment& experiment,
                        std::vector<Figure>& figures) {
  const auto error = [](const FrameScore& frame) -> std::optional<double> {
    if (!frame.seen() || !frame.distance_error_m) return std::nullopt;
    return 100.0 * std::abs(*frame.distance_error_m);
  };
  const bool is_scale = experiment.name == "scale";
  const auto finish = [&](LinePlot plot,
                          double good_at,
                          double far_at,
                          const std::string& caption) {
    plot.lines.push_back(Level("25 cm", 100.0 * kGoodDistanceError_m));
    if (is_scale) {
      plot.lines.push_back(
          {.label = "published (25 cm at 11.2 m, 2.7 m at 20 m)",
           .points = {{good_at, 100.0 * kGoodDistanceError_m},
                      {far_at, 100.0 * published::kFarError_m}},
           .markers = true,
           .line = false,
           .dashed = false,
           .colour = kTruthColour});
    }
    FitAxes(30.0, plot);
    // The published dots stand at the ends.
    const double margin = 0.02 * (plot.max.x() - plot.min.x());
    plot.min.x() -= margin;
    plot.max.x() += margin;
    figures.push_back({std::move(plot), caption});
  };
  LinePlot over = OverTime("Error of the target's distance over the distance",
                           "|error|, cm");
  over.x_label = "true distance, m";
  over.lines = Lines(
      experiment, [](const FrameScore& f) { return f.true_distance_m; }, error);
  finish(std::move(over),
         published::kGoodUpTo_m,
         published::kFarDistance_m,
         "How far the distance from camera to target is off, while the target "
         "is seen.");
  LinePlot under = OverTime(
      "Error of the target's distance over the angle under the horizon",
      "|error|, cm");
  under.x_label = "angle of the line of sight under the horizon, degrees";
  under.lines = Lines(
      experiment,
      [](const FrameScore& f) { return f.below_horizon_deg; },
      error);
  // The thesis' camera stood 1.6 m above the ground.
  constexpr double kDegrees = 57.29577951308232;
  finish(std::move(under),
         published::kGoodDownTo_deg,
         kDegrees * std::asin(1.6 / published::kFarDistance_m),
         "The same over the angle at which the ground is seen: the flatter, "
         "the more a pixel is on the ground.");
}

}  // namespace

std::vector<Figure> CameraFigures(const Experiment& experiment) {
  std::vector<Figure> figures;
  const bool in_thesis =
      experiment.name == "srun" || experiment.name == "scale";
  LinePlot position = OverTime("Camera: error of the position", "error, cm");
  position.lines = Lines(experiment, Time, [](const FrameScore& f) {
    return Times(f.camera_error_m, 100.0);
  });
  if (in_thesis) {
    position.lines.push_back(
        Level("published: typically below", 100.0 * published::kCameraError_m));
  }
  FitAxes(in_thesis ? 100.0 * published::kCameraError_m : 1.0, position);
  figures.push_back({std::move(position),
                     "Distance between the camera's centre as found and as it "
                     "was, in frames whose pose is TRACKED."});
  LinePlot rotation =
      OverTime("Camera: error of the rotation", "error, degrees");
  rotation.lines = Lines(
      experiment, Time, [](const FrameScore& f) { return f.camera_error_deg; });
  if (in_thesis) {
    rotation.lines.push_back(
        Level("published: typically below", published::kCameraError_deg));
  }
  FitAxes(in_thesis ? published::kCameraError_deg : 0.02, rotation);
  figures.push_back(
      {std::move(rotation), "Angle between the two orientations."});
  LinePlot inliers = OverTime("Landmarks that the pose rests on", "inliers");
  inliers.lines =
      Lines(experiment, Time, [](const FrameScore& f) -> std::optional<double> {
        if (!f.camera_error_m) return std::nullopt;
        return f.num_inliers;
      });
  FitAxes(10.0, inliers);
  figures.push_back(
      {std::move(inliers),
       "The baseline counts matched descriptors within 2 px of where they "
       "should be, the defaults landmarks that are followed from frame to "
       "frame."});
  return figures;
}

std::vector<Figure> TargetFigures(const Experiment& experiment) {
  std::vector<Figure> figures;
  double nearest = std::numeric_limits<double>::max();
  double farthest = 0.0;
  for (const FrameScore& frame : experiment.runs.front().frames) {
    if (!frame.true_distance_m || !frame.seen()) continue;
    nearest = std::min(nearest, *frame.true_distance_m);
    farthest = std::max(farthest, *frame.true_distance_m);
  }
  if (!(farthest > 0.0)) return figures;
  figures.push_back(FromAbove(experiment));
  LinePlot error = OverTime("Target: error on the ground", "error, cm");
  error.lines = Lines(experiment, Time, [](const FrameScore& f) {
    return Times(f.target_error_m, 100.0);
  });
  error.bands = HiddenBands(experiment);
  if (experiment.name == "srun") {
    error.lines.push_back(
        Level("published: bias of about", 100.0 * published::kBias_m));
  }
  FitAxes(10.0, error);
  figures.push_back(
      {std::move(error),
       "Horizontal distance between the target's place as found (or, out of "
       "sight, as predicted) and as it was."});
  if (farthest > kDistanceRatio * nearest) {
    AddDistanceFigures(experiment, figures);
  }
  LinePlot overlap = OverTime("Target: overlap of the 2D box with what is seen",
                              "intersection over union");
  overlap.lines = Lines(experiment, Time, [](const FrameScore& f) {
    return f.seen() ? f.overlap : std::optional<double>();
  });
  overlap.bands = HiddenBands(experiment);
  FitAxes(0.9, overlap);
  overlap.max.y() = 1.0;
  figures.push_back(
      {std::move(overlap), "While more than half of the target can be seen."});
  return figures;
}

std::vector<Figure> TimeFigures(const Experiment& experiment) {
  std::vector<Figure> figures;
  for (const EvaluatedRun& run : experiment.runs) {
    LinePlot plot = OverTime("Time per frame: " + run.configuration.Name(),
                             "wall clock, ms");
    const auto line = [&](const char* label, double sdk::StageTimes::*stage) {
      PlotLine& added = plot.lines.emplace_back();
      added.label = label;
      for (const FrameScore& frame : run.frames) {
        added.points.emplace_back(frame.time_s, frame.times.*stage);
      }
    };
    line("total", &sdk::StageTimes::total_ms);
    line("localize", &sdk::StageTimes::localize_ms);
    line("track", &sdk::StageTimes::track_ms);
    line("decode", &sdk::StageTimes::decode_ms);
    FitAxes(1.0, plot);
    figures.push_back(
        {std::move(plot),
         "As the server measured it on this machine, features included."});
  }
  return figures;
}

}  // namespace groundlock::cli
