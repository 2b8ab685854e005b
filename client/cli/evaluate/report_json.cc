// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <nlohmann/json.hpp>

#include "client/cli/evaluate/evaluation.h"
#include "client/cli/names.h"

namespace groundlock::cli {
namespace {

using nlohmann::json;

// JSON has no word for "not a number".
json Number(double value) {
  return std::isfinite(value) ? json(value) : json();
}
json Number(const std::optional<double>& value) {
  return value ? Number(*value) : json();
}

json SpreadJson(const Spread& spread) {
  return {{"count", spread.count},
          {"mean", Number(spread.mean)},
          {"median", Number(spread.median)},
          {"p05", Number(spread.p05)},
          {"p95", Number(spread.p95)},
          {"max", Number(spread.max)}};
}

json AbsenceJson(const Absence& absence) {
  return {
      {"first_hidden", absence.first_hidden},
      {"first_seen", absence.first_seen ? json(*absence.first_seen) : json()},
      {"locked_after_frames",
       absence.locked_after ? json(*absence.locked_after) : json()}};
}

json ScoreJson(const RunScore& score) {
  json absences = json::array();
  for (const Absence& absence : score.absences) {
    absences.push_back(AbsenceJson(absence));
  }
  return {
      {"frames", score.frames},
      {"camera",
       {{"tracked_share", Number(score.camera_tracked)},
        {"position_error_m", SpreadJson(score.camera_error_m)},
        {"rotation_error_deg", SpreadJson(score.camera_error_deg)},
        {"inliers", SpreadJson(score.inliers)}}},
      {"target",
       {{"ground_error_seen_m", SpreadJson(score.target_error_seen_m)},
        {"ground_error_hidden_m", SpreadJson(score.target_error_hidden_m)},
        {"error_away_from_camera_m", SpreadJson(score.along_error_seen_m)},
        {"abs_distance_error_m", SpreadJson(score.abs_distance_error_seen_m)},
        {"distance_within_25_cm_up_to_m", Number(score.good_up_to_m)},
        {"distance_within_25_cm_down_to_deg", Number(score.good_down_to_deg)},
        {"greatest_distance_m", score.greatest_distance_m},
        {"abs_distance_error_in_the_farthest_metre_m",
         SpreadJson(score.abs_distance_error_far_m)},
        {"mean_overlap", Number(score.mean_overlap)},
        {"locked_at_end_share", Number(score.locked_at_end)},
        {"absences", absences}}},
      {"times_ms",
       {{"decode", SpreadJson(score.decode_ms)},
        {"localize", SpreadJson(score.localize_ms)},
        {"track", SpreadJson(score.track_ms)},
        {"total", SpreadJson(score.total_ms)}}}};
}

json FrameJson(const FrameScore& frame) {
  json object = {{"frame", frame.frame},
                 {"t_s", frame.time_s},
                 {"camera_state", CameraStateName(frame.camera_state)},
                 {"inliers", frame.num_inliers},
                 {"camera_error_m", Number(frame.camera_error_m)},
                 {"camera_error_deg", Number(frame.camera_error_deg)},
                 {"seen_fraction", frame.seen_fraction},
                 {"confidence", frame.confidence},
                 {"overlap", Number(frame.overlap)},
                 {"true_distance_m", Number(frame.true_distance_m)},
                 {"below_horizon_deg", Number(frame.below_horizon_deg)},
                 {"ground_error_m", Number(frame.target_error_m)},
                 {"error_away_from_camera_m", Number(frame.along_error_m)},
                 {"distance_error_m", Number(frame.distance_error_m)},
                 {"total_ms", frame.times.total_ms}};
  object["target_state"] =
      frame.target_state ? json(TargetStateName(*frame.target_state)) : json();
  return object;
}

}  // namespace

std::string ReportJson(const Evaluation& evaluation) {
  json runs = json::array();
  for (const Experiment& experiment : evaluation.experiments) {
    for (const EvaluatedRun& run : experiment.runs) {
      json object = ScoreJson(run.score);
      object["experiment"] = experiment.name;
      object["video"] = experiment.video;
      object["configuration"] = run.configuration.Name();
      object["per_frame"] = json::array();
      for (const FrameScore& frame : run.frames) {
        object["per_frame"].push_back(FrameJson(frame));
      }
      runs.push_back(std::move(object));
    }
  }
  const json published = {
      {"source", "Robinson 2014, LiTH-ISY-EX--14/4800--SE, chapter 4"},
      {"camera_position_error_m", published::kCameraError_m},
      {"camera_rotation_error_deg", published::kCameraError_deg},
      {"camera_position_spike_m", published::kCameraSpike_m},
      {"camera_rotation_spike_deg", published::kCameraSpike_deg},
      {"distance_within_25_cm_up_to_m", published::kGoodUpTo_m},
      {"distance_within_25_cm_down_to_deg", published::kGoodDownTo_deg},
      {"distance_error_at_20_m_m", published::kFarError_m},
      {"srun_bias_m", published::kBias_m},
      {"frame_ms_without_features", published::kFrame_ms}};
  return json{{"version", evaluation.version},
              {"machine", evaluation.machine},
              {"data", evaluation.data},
              {"map_landmarks", evaluation.map_landmarks},
              {"published", published},
              {"runs", runs}}
      .dump();
}

}  // namespace groundlock::cli
