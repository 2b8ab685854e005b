// SPDX-License-Identifier: Apache-2.0
// A run's answers against the truth, in the figures of Robinson 2014, chapter
// 4, and in those that robotics asks for beside them.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_SCORES_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_SCORES_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "client/cli/evaluate/truth_csv.h"
#include "client/sdk/types.h"

namespace groundlock::cli {

// A target of which more can be seen counts as seen, of which less as hidden:
// between them neither is expected.
inline constexpr double kSeenFraction = 0.5;
inline constexpr double kHiddenFraction = 0.02;
// A box that overlaps the visible part by more is on the target (PASCAL's .5 is
// too strict for boxes that are partly hidden).
inline constexpr double kLockedOverlap = 0.3;
// The error of the distance from camera to target up to which Robinson 2014,
// chapter 4, calls it good.
inline constexpr double kGoodDistanceError_m = 0.25;

// One frame. World: m, z up, the ground near z = 0.
struct FrameScore {
  std::uint64_t frame = 0;
  double time_s = 0.0;

  sdk::CameraState camera_state = sdk::CameraState::kInitializing;
  int num_inliers = 0;
  Eigen::Vector3d true_camera_world = Eigen::Vector3d::Zero();
  // Of TRACKED poses alone: what is held is not measured.
  std::optional<double> camera_error_m;
  std::optional<double> camera_error_deg;

  double seen_fraction = 0.0;
  std::optional<sdk::TargetState> target_state;  // unset = not there yet
  double confidence = 0.0;
  std::optional<double> overlap;  // of box and visible part, where both are
  std::optional<Eigen::Vector3d> true_target_world;
  std::optional<Eigen::Vector3d> target_world;
  // Where both are known. True: from the true camera. The distance's error is
  // that of target and camera together; the angle lies between the line of
  // sight and the horizontal plane.
  std::optional<double> true_distance_m;
  std::optional<double> below_horizon_deg;
  std::optional<double> target_error_m;    // on the ground, horizontally
  std::optional<double> along_error_m;     // away from the true camera: above 0
  std::optional<double> distance_error_m;  // signed

  sdk::StageTimes times;

  bool seen() const { return seen_fraction > kSeenFraction; }
  bool hidden() const { return seen_fraction < kHiddenFraction; }
};

// `result`'s only target is the one of the truth.
FrameScore ScoreFrame(const sdk::FrameResult& result, const TruthRow& truth);

// NaN where there was nothing to measure.
struct Spread {
  std::size_t count = 0;
  double mean = 0.0, median = 0.0, p05 = 0.0, p95 = 0.0, max = 0.0;
};
Spread SpreadOf(std::vector<double> values);

// A time out of sight, from the first hidden frame to the first seen one.
struct Absence {
  std::uint64_t first_hidden = 0;
  // Unset: hidden to the end.
  std::optional<std::uint64_t> first_seen;
  // Frames from first_seen until the target is TRACKED with kLockedOverlap;
  // unset: never.
  std::optional<std::uint64_t> locked_after;
};

struct RunScore {
  std::size_t frames = 0;
  double camera_tracked = 0.0;  // share of the frames
  Spread camera_error_m, camera_error_deg, inliers;
  Spread target_error_seen_m, target_error_hidden_m;
  Spread along_error_seen_m;  // its mean is the bias
  Spread abs_distance_error_seen_m;
  // The least true distance at which the distance's error exceeds
  // kGoodDistanceError_m, and the angle there; unset: it never does.
  std::optional<double> good_up_to_m, good_down_to_deg;
  // Of frames within 1 m of the greatest distance.
  double greatest_distance_m = 0.0;
  Spread abs_distance_error_far_m;
  double mean_overlap = 0.0;   // while seen
  double locked_at_end = 0.0;  // share of the last 24 seen frames
  std::vector<Absence> absences;
  Spread decode_ms, localize_ms, track_ms, total_ms;
};
RunScore ScoreRun(const std::vector<FrameScore>& frames);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_SCORES_H_
