// SPDX-License-Identifier: Apache-2.0
// What `groundlock evaluate` reckons and draws, on runs made up for it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "client/cli/evaluate/evaluation.h"
#include "client/cli/evaluate/line_plot.h"
#include "client/cli/evaluate/scores.h"

namespace groundlock::cli {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr double kHeight_m = 1.6;

// A camera at the origin, and a target straight ahead along x.
TruthRow Truth(std::uint64_t frame, double distance_m, double seen) {
  TruthRow row;
  row.frame = frame;
  row.world_from_camera.translation = {0.0, 0.0, kHeight_m};
  row.target_world = Eigen::Vector3d(distance_m, 0.0, 0.0);
  if (seen > 0.0) {
    row.visible_box_px = geometry::Box2::FromXywh(100, 100, 50, 50);
  }
  row.seen_fraction = seen;
  return row;
}

// A result whose camera is 1 cm off and turned by a degree, and whose target is
// `error_m` too far away.
sdk::FrameResult Result(const TruthRow& truth, double error_m) {
  sdk::FrameResult result;
  result.sequence = truth.frame;
  result.capture_time = std::chrono::milliseconds(40 * truth.frame);
  result.camera.state = sdk::CameraState::kTracked;
  result.camera.num_inliers = 100;
  result.camera.world_from_camera = truth.world_from_camera;
  result.camera.world_from_camera->translation.y() += 0.01;
  result.camera.world_from_camera->rotation =
      geometry::QuaternionFromRotationVector(
          {0.0, 0.0, std::numbers::pi / 180.0});
  sdk::TargetResult target;
  target.state = truth.seen_fraction > 0.0 ? sdk::TargetState::kTracked
                                           : sdk::TargetState::kPredicted;
  target.box_px = geometry::Box2::FromXywh(100, 100, 50, 50);
  target.ground_center_world =
      *truth.target_world + Eigen::Vector3d(error_m, 0.0, 0.0);
  result.targets.push_back(target);
  result.times.total_ms = 5.0;
  return result;
}

// Ten frames: seen, hidden from 4 to 6, seen again; .1 m too far, and from 8 m
// on half a metre.
EvaluatedRun Drive(const Configuration& configuration) {
  EvaluatedRun run{configuration, {}, {}, {}};
  for (std::uint64_t frame = 0; frame < 10; ++frame) {
    const bool is_hidden = frame >= 4 && frame < 7;
    const double distance_m = 2.0 + static_cast<double>(frame);
    const TruthRow truth = Truth(frame, distance_m, is_hidden ? 0.0 : 1.0);
    run.frames.push_back(
        ScoreFrame(Result(truth, distance_m < 7.9 ? 0.1 : 0.5), truth));
  }
  run.score = ScoreRun(run.frames);
  return run;
}

TEST(Scores, CountTheErrorsOfCameraAndTarget) {
  const RunScore score = Drive({}).score;
  EXPECT_EQ(score.frames, 10U);
  EXPECT_EQ(score.camera_tracked, 1.0);
  EXPECT_NEAR(score.camera_error_m.median, 0.01, 1e-9);
  EXPECT_NEAR(score.camera_error_deg.max, 1.0, 1e-6);
  EXPECT_EQ(score.target_error_seen_m.count, 7U);
  EXPECT_EQ(score.target_error_hidden_m.count, 3U);
  EXPECT_NEAR(score.target_error_hidden_m.median, 0.1, 1e-9);
  EXPECT_NEAR(score.along_error_seen_m.mean, (4 * 0.1 + 3 * 0.5) / 7, 1e-9);
  EXPECT_EQ(score.mean_overlap, 1.0);
  EXPECT_EQ(score.locked_at_end, 1.0);
  // The first seen frame beyond 8 m is the one at 9 m.
  ASSERT_TRUE(score.good_up_to_m);
  EXPECT_NEAR(*score.good_up_to_m, std::hypot(9.0, kHeight_m), 1e-9);
  EXPECT_NEAR(*score.good_down_to_deg,
              std::atan2(kHeight_m, 9.0) * 180.0 / std::numbers::pi,
              1e-9);
  ASSERT_EQ(score.absences.size(), 1U);
  EXPECT_EQ(score.absences[0].first_hidden, 4U);
  EXPECT_EQ(*score.absences[0].first_seen, 7U);
  EXPECT_EQ(*score.absences[0].locked_after, 0U);
}

TEST(Scores, AHeldPoseIsNotMeasuredAndALostTargetHasNoPlace) {
  const TruthRow truth = Truth(0, 5.0, 1.0);
  sdk::FrameResult result = Result(truth, 0.1);
  result.camera.state = sdk::CameraState::kHeld;
  result.targets[0].state = sdk::TargetState::kLost;
  result.targets[0].box_px = geometry::Box2::FromXywh(500, 500, 50, 50);
  const FrameScore frame = ScoreFrame(result, truth);
  EXPECT_FALSE(frame.camera_error_m);
  EXPECT_FALSE(frame.target_error_m);
  const RunScore score = ScoreRun({frame});
  EXPECT_EQ(score.camera_tracked, 0.0);
  EXPECT_TRUE(std::isnan(score.camera_error_m.median));
  EXPECT_EQ(score.mean_overlap, 0.0);
  EXPECT_EQ(score.locked_at_end, 0.0);
}

TEST(Scores, AQuantileLiesBetweenItsNeighbours) {
  const Spread spread = SpreadOf({4.0, 1.0, 2.0, 3.0});
  EXPECT_EQ(spread.median, 2.5);
  EXPECT_NEAR(spread.p95, 3.85, 1e-12);
  EXPECT_NEAR(spread.p05, 1.15, 1e-12);
  EXPECT_EQ(spread.max, 4.0);
  EXPECT_EQ(spread.mean, 2.5);
}

Evaluation Made(const std::string& name) {
  Evaluation evaluation;
  evaluation.version = "1.2.3 (abc)";
  evaluation.machine = "a <machine> & more";
  evaluation.data = "made up";
  evaluation.experiments.push_back(
      {name, name + ".mp4", {Drive({"baseline", "act"}), Drive({})}});
  evaluation.experiments[0].runs[0].stills.push_back({3, "half way", "JPEG"});
  return evaluation;
}

TEST(Report, ShowsPublishedFiguresBesideOursAndSaysWhatFallsShort) {
  const std::vector<ComparedFigure> rows = CompareWithThesis(Made("scale"));
  const auto row = [&](const std::string& figure) {
    for (const ComparedFigure& r : rows) {
      if (r.figure.find(figure) != std::string::npos) return r;
    }
    return ComparedFigure{};
  };
  // Off by a degree, and good only up to 9 m of the thesis' 11.2.
  EXPECT_TRUE(row("camera rotation").worse.at(0));
  EXPECT_FALSE(row("camera position").worse.at(0));
  EXPECT_THAT(row("within 25 cm").ours.at(1), HasSubstr("9.1 m (10.1"));
  EXPECT_TRUE(row("within 25 cm").worse.at(1));
  EXPECT_TRUE(CompareWithThesis(Made("something else")).empty());
}

TEST(Report, IsOnePageThatAsksForNothingElse) {
  for (const char* name : {"srun", "scale", "outofview", "my<drive>"}) {
    const std::string html = ReportHtml(Made(name));
    EXPECT_THAT(html, HasSubstr("a &lt;machine&gt; &amp; more"));
    EXPECT_THAT(html, HasSubstr("data:image/jpeg;base64,SlBFRw=="));
    EXPECT_THAT(html, Not(HasSubstr("<drive>")));
    EXPECT_THAT(html, Not(HasSubstr("<script")));
    EXPECT_THAT(html, Not(HasSubstr("src='http")));
    EXPECT_THAT(html, Not(HasSubstr("nan")));
    EXPECT_THAT(html, Not(HasSubstr("inf,")));
  }
}

// Of chapter 4: the camera's errors, the target's over time, distance and
// angle, the way from above with its bias, inliers, overlap, times, pictures.
TEST(Report, HasTheFiguresOfTheThesis) {
  const std::string scale = ReportHtml(Made("scale"));
  for (const char* title : {"Camera: error of the position",
                            "Camera: error of the rotation",
                            "Landmarks that the pose rests on",
                            "From above",
                            "Target: error on the ground",
                            "distance over the distance",
                            "distance over the angle under the horizon",
                            "published (25 cm at 11.2 m, 2.7 m at 20 m)",
                            "Target: overlap of the 2D box",
                            "Time per frame: baseline+act",
                            "Time per frame: defaults",
                            "Frame 3, half way"}) {
    EXPECT_THAT(scale, HasSubstr(title));
  }
  EXPECT_THAT(ReportHtml(Made("srun")), HasSubstr("published: bias of about"));
}

TEST(Report, TheJsonSaysTheSame) {
  const auto json = nlohmann::json::parse(ReportJson(Made("srun")));
  EXPECT_EQ(json["runs"].size(), 2U);
  const auto& run = json["runs"][0];
  EXPECT_EQ(run["configuration"], "baseline+act");
  EXPECT_EQ(run["experiment"], "srun");
  EXPECT_EQ(run["per_frame"].size(), 10U);
  EXPECT_NEAR(
      run["camera"]["position_error_m"]["median"].get<double>(), 0.01, 1e-9);
  EXPECT_EQ(run["per_frame"][4]["target_state"], "PREDICTED");
  EXPECT_EQ(json["published"]["srun_bias_m"], published::kBias_m);
}

TEST(LinePlot, CutsOffWhatLiesBeyondTheAxesAndBreaksAtGaps) {
  LinePlot plot;
  plot.max = {10.0, 1.0};
  const double gap = std::nan("");
  plot.lines.push_back(
      {.label = "a < b",
       .points = {{0, 0}, {1, 1}, {gap, gap}, {2, 0}, {3, 9}}});
  const std::string svg = ToSvg(plot);
  EXPECT_THAT(svg, HasSubstr("a &lt; b"));
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  std::size_t lines = 0;
  for (std::size_t at = svg.find("<polyline"); at != std::string::npos;
       at = svg.find("<polyline", at + 1)) {
    ++lines;
  }
  EXPECT_EQ(lines, 2U);
  // Axes without an extent do not divide by zero, nor tick for ever.
  plot.max = plot.min;
  EXPECT_THAT(ToSvg(plot), Not(HasSubstr("nan")));
}

}  // namespace
}  // namespace groundlock::cli
