// SPDX-License-Identifier: Apache-2.0
#include "client/cli/movers_csv.h"

#include <chrono>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/names.h"

namespace groundlock::cli {

std::string MoversCsvHeader() {
  return "frame,t_s,movers_state,mover,confidence,box_x,box_y,box_w,box_h,"
         "ground_x,ground_y,ground_z,velocity_x,velocity_y,velocity_z,"
         "place_sigma_m,velocity_sigma_m_s\n";
}

std::string MoversCsvRows(const sdk::FrameResult& result) {
  const std::string start = absl::StrFormat(
      "%d,%.6f,%s",
      result.sequence,
      std::chrono::duration<double>(result.capture_time).count(),
      MoversStateName(result.movers_state));
  if (result.movers.empty()) return absl::StrCat(start, ",,,,,,,,,,,,,,\n");
  std::string rows;
  for (const sdk::Mover& mover : result.movers) {
    const geometry::Box2& box_px = mover.box_px;
    const Eigen::Vector3d& place = mover.ground_center_world;
    const Eigen::Vector3d& velocity = mover.velocity_world_m_s;
    absl::StrAppendFormat(
        &rows,
        "%s,%d,%.4f,%.3f,%.3f,%.3f,%.3f,%.6f,%.6f,%.6f,"
        "%.6f,%.6f,%.6f,%.6f,%.6f\n",
        start,
        mover.id,
        mover.confidence,
        box_px.x(),
        box_px.y(),
        box_px.width(),
        box_px.height(),
        place.x(),
        place.y(),
        place.z(),
        velocity.x(),
        velocity.y(),
        velocity.z(),
        std::sqrt(0.5 * mover.ground_covariance_m2.trace()),
        std::sqrt(0.5 * mover.velocity_covariance_m2_s2.trace()));
  }
  return rows;
}

}  // namespace groundlock::cli
