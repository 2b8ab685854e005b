// SPDX-License-Identifier: Apache-2.0
// What is true of a sequence's frames: the camera, and perhaps a target.
#ifndef GROUNDLOCK_CLIENT_CLI_EVALUATE_TRUTH_CSV_H_
#define GROUNDLOCK_CLIENT_CLI_EVALUATE_TRUTH_CSV_H_

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::cli {

struct TruthRow {
  std::uint64_t frame = 0;  // counted from 0, as the video's
  std::chrono::nanoseconds time{0};
  geometry::Rigid3 world_from_camera;
  // The centre of the target's base, on the ground.
  std::optional<Eigen::Vector3d> target_world;
  // The box of what can be seen of it.
  std::optional<geometry::Box2> visible_box_px;
  // How much of its side towards the camera can be seen, 0 to 1.
  double seen_fraction = 0.0;
};

// Rows of a truth CSV as `groundlock simulate` writes them, in the order of
// their frames. The header names the columns, in any order:
//   frame, cam_x, cam_y, cam_z, q_w, q_x, q_y, q_z   required; m, and the
//                                world_from_camera quaternion, of unit length
//   t_s                          seconds, 0 without it
//   tgt_x, tgt_y, tgt_z          all or none; cells may be empty
//   vis_x, vis_y, vis_w, vis_h   likewise; px, the upper-left corner and size
//   seen_fraction                without it, 1 where there is a visible box
// Other columns are passed over. kInvalidArgument names line and column.
absl::StatusOr<std::vector<TruthRow>> TruthFromCsv(std::string_view csv);
// The same from a file; errors name it.
absl::StatusOr<std::vector<TruthRow>> ReadTruth(
    const std::filesystem::path& path);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_EVALUATE_TRUTH_CSV_H_
