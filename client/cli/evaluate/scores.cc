// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/scores.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "map_store/geometry/box.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::cli {
namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;
constexpr std::size_t kFramesAtEnd = 24;
constexpr double kFarWithin_m = 1.0;

// Linear between the two nearest, as numpy's percentile.
double Quantile(const std::vector<double>& sorted, double q) {
  const double at = q * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(at);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  const double share = at - static_cast<double>(below);
  return (1.0 - share) * sorted[below] + share * sorted[above];
}

void ScoreTarget(const sdk::FrameResult& result,
                 const TruthRow& truth,
                 FrameScore& score) {
  if (truth.target_world) {
    const Eigen::Vector3d sight =
        *truth.target_world - truth.world_from_camera.translation;
    score.true_distance_m = sight.norm();
    score.below_horizon_deg =
        kDegrees * std::atan2(-sight.z(), sight.head<2>().norm());
  }
  if (result.targets.empty()) return;
  const sdk::TargetResult& target = result.targets.front();
  score.target_state = target.state;
  score.confidence = target.confidence;
  if (target.box_px && truth.visible_box_px) {
    score.overlap =
        geometry::IntersectionOverUnion(*target.box_px, *truth.visible_box_px);
  }
  // A target that is given up has no place.
  if (target.state == sdk::TargetState::kLost) return;
  score.target_world = target.ground_center_world;
  if (!score.target_world || !truth.target_world) return;
  const Eigen::Vector2d error =
      (*score.target_world - *truth.target_world).head<2>();
  const Eigen::Vector2d away =
      (*truth.target_world - truth.world_from_camera.translation)
          .head<2>()
          .normalized();
  score.target_error_m = error.norm();
  score.along_error_m = error.dot(away);
  if (result.camera.world_from_camera) {
    score.distance_error_m =
        (*score.target_world - result.camera.world_from_camera->translation)
            .norm() -
        *score.true_distance_m;
  }
}

std::vector<Absence> Absences(const std::vector<FrameScore>& frames) {
  std::vector<Absence> absences;
  std::size_t i = 0;
  while (i < frames.size()) {
    if (!frames[i].hidden()) {
      ++i;
      continue;
    }
    Absence absence;
    absence.first_hidden = frames[i].frame;
    while (i < frames.size() && !frames[i].seen()) ++i;
    if (i < frames.size()) absence.first_seen = frames[i].frame;
    for (std::size_t k = i; k < frames.size(); ++k) {
      if (frames[k].target_state == sdk::TargetState::kTracked &&
          frames[k].overlap.value_or(0.0) > kLockedOverlap) {
        absence.locked_after = frames[k].frame - *absence.first_seen;
        break;
      }
    }
    absences.push_back(absence);
  }
  return absences;
}

void FindGoodRange(const std::vector<FrameScore>& frames, RunScore& score) {
  for (const FrameScore& frame : frames) {
    if (!frame.seen() || !frame.distance_error_m ||
        std::abs(*frame.distance_error_m) <= kGoodDistanceError_m ||
        *frame.true_distance_m >=
            score.good_up_to_m.value_or(std::numeric_limits<double>::max())) {
      continue;
    }
    score.good_up_to_m = frame.true_distance_m;
    score.good_down_to_deg = frame.below_horizon_deg;
  }
}

// The values that `value` finds in the frames that pass `test`.
template <typename Test, typename Value>
std::vector<double> Collect(const std::vector<FrameScore>& frames,
                            const Test& test,
                            const Value& value) {
  std::vector<double> values;
  for (const FrameScore& frame : frames) {
    if (!test(frame)) continue;
    const std::optional<double> v = value(frame);
    if (v) values.push_back(*v);
  }
  return values;
}

std::optional<double> Magnitude(const std::optional<double>& value) {
  if (!value) return std::nullopt;
  return std::abs(*value);
}

}  // namespace

FrameScore ScoreFrame(const sdk::FrameResult& result, const TruthRow& truth) {
  FrameScore score;
  score.frame = truth.frame;
  score.time_s = std::chrono::duration<double>(result.capture_time).count();
  score.camera_state = result.camera.state;
  score.num_inliers = result.camera.num_inliers;
  score.true_camera_world = truth.world_from_camera.translation;
  if (result.camera.state == sdk::CameraState::kTracked &&
      result.camera.world_from_camera) {
    const geometry::Rigid3& found = *result.camera.world_from_camera;
    score.camera_error_m =
        (found.translation - truth.world_from_camera.translation).norm();
    score.camera_error_deg =
        kDegrees * geometry::AngleBetween_rad(found.rotation,
                                              truth.world_from_camera.rotation);
  }
  score.seen_fraction = truth.seen_fraction;
  score.true_target_world = truth.target_world;
  ScoreTarget(result, truth, score);
  score.times = result.times;
  return score;
}

Spread SpreadOf(std::vector<double> values) {
  const double none = std::numeric_limits<double>::quiet_NaN();
  if (values.empty()) return {0, none, none, none, none, none};
  std::sort(values.begin(), values.end());
  double sum = 0.0;
  for (const double value : values) sum += value;
  return {values.size(),
          sum / static_cast<double>(values.size()),
          Quantile(values, 0.5),
          Quantile(values, 0.05),
          Quantile(values, 0.95),
          values.back()};
}

RunScore ScoreRun(const std::vector<FrameScore>& frames) {
  RunScore score;
  score.frames = frames.size();
  const auto all = [](const FrameScore&) { return true; };
  const auto seen = [](const FrameScore& f) { return f.seen(); };
  const auto hidden = [](const FrameScore& f) { return f.hidden(); };
  const auto spread = [&](const auto& test, const auto& value) {
    return SpreadOf(Collect(frames, test, value));
  };
  using Value = std::optional<double>;
  score.camera_tracked = spread(all, [](const FrameScore& f) -> Value {
                           return f.camera_error_m ? 1.0 : 0.0;
                         }).mean;
  score.camera_error_m =
      spread(all, [](const FrameScore& f) { return f.camera_error_m; });
  score.camera_error_deg =
      spread(all, [](const FrameScore& f) { return f.camera_error_deg; });
  score.inliers = spread(all, [](const FrameScore& f) -> Value {
    return f.camera_error_m ? Value(f.num_inliers) : std::nullopt;
  });
  score.target_error_seen_m =
      spread(seen, [](const FrameScore& f) { return f.target_error_m; });
  score.target_error_hidden_m =
      spread(hidden, [](const FrameScore& f) { return f.target_error_m; });
  score.along_error_seen_m =
      spread(seen, [](const FrameScore& f) { return f.along_error_m; });
  const auto distance_error = [](const FrameScore& f) {
    return Magnitude(f.distance_error_m);
  };
  score.abs_distance_error_seen_m = spread(seen, distance_error);
  FindGoodRange(frames, score);
  for (const FrameScore& frame : frames) {
    score.greatest_distance_m = std::max(score.greatest_distance_m,
                                         frame.true_distance_m.value_or(0.0));
  }
  score.abs_distance_error_far_m = spread(
      [&](const FrameScore& f) {
        return f.seen() && f.true_distance_m.value_or(0.0) >
                               score.greatest_distance_m - kFarWithin_m;
      },
      distance_error);
  // A frame without a box while the target is seen is an overlap of nothing.
  const std::vector<double> overlaps =
      Collect(frames, seen, [](const FrameScore& f) -> Value {
        if (!f.target_state) return std::nullopt;
        return f.overlap.value_or(0.0);
      });
  score.mean_overlap = SpreadOf(overlaps).mean;
  std::vector<double> locked;
  for (const double overlap : overlaps) {
    locked.push_back(overlap > kLockedOverlap ? 1.0 : 0.0);
  }
  if (locked.size() > kFramesAtEnd) {
    locked.erase(locked.begin(), locked.end() - kFramesAtEnd);
  }
  score.locked_at_end = SpreadOf(locked).mean;
  score.absences = Absences(frames);
  score.decode_ms = spread(
      all, [](const FrameScore& f) -> Value { return f.times.decode_ms; });
  score.localize_ms = spread(
      all, [](const FrameScore& f) -> Value { return f.times.localize_ms; });
  score.track_ms = spread(
      all, [](const FrameScore& f) -> Value { return f.times.track_ms; });
  score.total_ms = spread(
      all, [](const FrameScore& f) -> Value { return f.times.total_ms; });
  return score;
}

}  // namespace groundlock::cli
