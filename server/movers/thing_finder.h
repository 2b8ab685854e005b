// SPDX-License-Identifier: Apache-2.0
// Points that move are made things: groups of them, each with a box in the
// image and a place on the ground.
#ifndef GROUNDLOCK_SERVER_MOVERS_THING_FINDER_H_
#define GROUNDLOCK_SERVER_MOVERS_THING_FINDER_H_

#include <Eigen/Core>
#include <span>
#include <vector>

#include "server/movers/mover_list.h"
#include "server/movers/movers.h"
#include "server/movers/point_field.h"

namespace groundlock::movers {

// What moves in this key view and is none of the frame's targets.
//   eye_velocity_m_s  how the camera went since the window's oldest key view,
//                     in the axes of the ground's reference plane.
//   sigma_px          of a followed point in the image.
// Pure and thread-safe.
std::vector<Finding> FindThings(const MoversFrame& frame,
                                std::span<const FieldPoint> points,
                                const Eigen::Vector2d& eye_velocity_m_s,
                                double sigma_px);

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_THING_FINDER_H_
