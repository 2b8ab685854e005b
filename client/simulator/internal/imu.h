// SPDX-License-Identifier: Apache-2.0
// The inertial measurement unit that is fixed to the camera, with the noise and
// the wandering zeros that such units have.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_IMU_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_IMU_H_

#include <cstdint>
#include <functional>
#include <string>

#include "map_store/geometry/rigid3.h"

namespace groundlock::simulator {

// From time 0 to `duration_s` and one sample beyond, 200 a second, as EuRoC's
// imu0/data.csv has them (Burri et al. 2016): timestamp in ns, then the angular
// rate in rad/s and the specific force in m/s^2 along the unit's axes: x
// forward, y left, z up, some degrees off the camera's.
std::string ImuCsv(
    const std::function<geometry::Rigid3(double t_s)>& world_from_camera,
    double duration_s,
    std::uint64_t seed);
// The unit as `groundlock track --imu-model` takes it.
std::string ImuJson();

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_IMU_H_
