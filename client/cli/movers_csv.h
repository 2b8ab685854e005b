// SPDX-License-Identifier: Apache-2.0
// The movers CSV: one row per frame and mover, in the map's world.
#ifndef GROUNDLOCK_CLIENT_CLI_MOVERS_CSV_H_
#define GROUNDLOCK_CLIENT_CLI_MOVERS_CSV_H_

#include <string>

#include "client/sdk/types.h"

namespace groundlock::cli {

// The header line, with its line feed:
//   frame,t_s,movers_state,mover,confidence,box_x,box_y,box_w,box_h,
//   ground_x,ground_y,ground_z,velocity_x,velocity_y,velocity_z,
//   place_sigma_m,velocity_sigma_m_s
// box_* is the 2D box (upper-left corner), ground_* where it stands, the sigmas
// are root mean squares over x and y. An empty field means none.
std::string MoversCsvHeader();

// The rows of a frame: one per mover; one with empty mover fields if there is
// none, whose state says why.
std::string MoversCsvRows(const sdk::FrameResult& result);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_MOVERS_CSV_H_
