// SPDX-License-Identifier: Apache-2.0
// Truth of a rendered sequence, and results in the columns of the results CSV.
#ifndef GROUNDLOCK_TESTS_EVAL_SEQUENCE_CSV_H_
#define GROUNDLOCK_TESTS_EVAL_SEQUENCE_CSV_H_

#include <chrono>
#include <filesystem>
#include <optional>
#include <ostream>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/rigid3.h"
#include "server/tracking/tracking_session.h"

namespace groundlock::eval {

struct TruthRow {
  int frame = 0;
  std::chrono::nanoseconds time{0};
  geometry::Rigid3 world_from_camera;
  std::optional<geometry::Box2> visible_box_px;
  double seen_fraction = 0.0;
  Eigen::Vector3d target_world = Eigen::Vector3d::Zero();  // on the ground
};

// Rows of a *_truth.csv with a target. kInvalidArgument names a missing column.
absl::StatusOr<std::vector<TruthRow>> ReadTruth(
    const std::filesystem::path& path);

void WriteResultsHeader(std::ostream& out);
// One row per target of the result (one without a target if there is none).
void WriteResults(std::ostream& out, const tracking::FrameResult& result);

}  // namespace groundlock::eval

#endif  // GROUNDLOCK_TESTS_EVAL_SEQUENCE_CSV_H_
