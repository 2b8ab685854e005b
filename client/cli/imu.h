// SPDX-License-Identifier: Apache-2.0
// What an inertial measurement unit recorded beside a video, as users have it.
#ifndef GROUNDLOCK_CLIENT_CLI_IMU_H_
#define GROUNDLOCK_CLIENT_CLI_IMU_H_

#include <chrono>
#include <cstddef>
#include <filesystem>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/sdk/types.h"

namespace groundlock::cli {

// Rows as in EuRoC's imu0/data.csv: time in ns, angular rate x, y, z in rad/s,
// specific force x, y, z in m/s^2, and what follows is passed over. Lines that
// begin with # are, too. Times ascend. kInvalidArgument names line and column.
absl::StatusOr<std::vector<sdk::InertialSample>> InertialFromCsv(
    std::string_view csv);
// The unit: {"imu_from_camera_wxyz": [w, x, y, z]}, and optionally
// gyroscope_noise_rad_s_sqrt_hz, gyroscope_walk_rad_s2_sqrt_hz,
// gyroscope_bias_rad_s. kInvalidArgument names the field.
absl::StatusOr<sdk::ImuModel> ImuFromJson(std::string_view json);
// The same from files; errors name them.
absl::StatusOr<std::vector<sdk::InertialSample>> ReadInertial(
    const std::filesystem::path& path);
absl::StatusOr<sdk::ImuModel> ReadImu(const std::filesystem::path& path);

// Deals a recording out to the frames of its video, in order.
class InertialTrack {
 public:
  InertialTrack() = default;
  //   epoch  what the unit's clock says when a frame's capture time is 0.
  InertialTrack(std::vector<sdk::InertialSample> samples,
                std::chrono::nanoseconds epoch);
  // Those not dealt out yet up to the first one that is not before the frame;
  // the newest ones only, if they are more than a frame may bring.
  std::vector<sdk::InertialSample> Until(std::chrono::nanoseconds capture_time);

 private:
  std::vector<sdk::InertialSample> samples_;  // times of the frames' clock
  std::size_t next_ = 0;
};

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_IMU_H_
