// SPDX-License-Identifier: Apache-2.0
// The results CSV: one row per frame and target, poses in the map's world.
#ifndef GROUNDLOCK_CLIENT_CLI_RESULTS_CSV_H_
#define GROUNDLOCK_CLIENT_CLI_RESULTS_CSV_H_

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

#include "client/sdk/types.h"

namespace groundlock::cli {

// The header line, with its line feed:
//   frame,t_s,camera_state,cam_x,cam_y,cam_z,cam_qw,cam_qx,cam_qy,cam_qz,
//   inliers,target,target_state,confidence,box_x,box_y,box_w,box_h,
//   ground_x,ground_y,ground_z,heading_rad,length_m,width_m,height_m,
//   decode_ms,localize_ms,track_ms,total_ms
// cam_* is the camera's centre and the world_from_camera quaternion, box_* the
// 2D box (upper-left corner), ground_* the target's centre on the ground. An
// empty field means none.
std::string ResultsCsvHeader();

// The rows of a frame: one per target; one with empty target fields if there is
// no target.
std::string ResultsCsvRows(const sdk::FrameResult& result);

// The row of a frame that was dropped or failed: only its number and time.
std::string ResultsCsvEmptyRow(std::uint64_t frame,
                               std::chrono::nanoseconds capture_time);

// Single images: the same columns and, last, the image's name.
std::string LocalizeCsvHeader();
std::string LocalizeCsvRow(std::uint64_t index,
                           const sdk::LocalizeReport& report,
                           std::string_view image);
// An image that could not be processed.
std::string LocalizeCsvEmptyRow(std::uint64_t index, std::string_view image);

// A text as a CSV field: quoted if it holds a comma, a quote or a line break
// (RFC 4180).
std::string CsvField(std::string_view text);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_RESULTS_CSV_H_
