// SPDX-License-Identifier: Apache-2.0
// Where other sensors say the camera was, as a user writes it.
#ifndef GROUNDLOCK_CLIENT_CLI_PRIORS_H_
#define GROUNDLOCK_CLIENT_CLI_PRIORS_H_

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "client/sdk/types.h"

namespace groundlock::cli {

// As it stands on the command line; empty = not given.
struct PriorFlags {
  std::string position;  // "X,Y,Z" in world, m
  std::string geodetic;  // "LATITUDE,LONGITUDE,HEIGHT", degrees and m, WGS84
  double sigma_m = 0.0;
};
// nullopt if neither is given. kInvalidArgument names the flag.
absl::StatusOr<std::optional<sdk::PosePrior>> PriorFromFlags(
    const PriorFlags& flags);

// Priors by frame number: a CSV whose header names its columns, in any order:
//   frame                                 required
//   x, y, z                               position in world, m, or
//   latitude, longitude, height           WGS84: degrees, m above the ellipsoid
//   sigma                                 of the position, per axis, m
//   arm_x, arm_y, arm_z                   from the camera to the position's
//                                         sensor, in camera, m
//   qw, qx, qy, qz, rotation_sigma_deg    world_from_camera
// Other columns are passed over; a row may leave the position's or the
// rotation's cells empty. kInvalidArgument names line and column.
using Priors = std::map<std::uint64_t, sdk::PosePrior>;
absl::StatusOr<Priors> PriorsFromCsv(std::string_view csv);
// The same from a file; errors name it.
absl::StatusOr<Priors> ReadPriors(const std::filesystem::path& path);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_PRIORS_H_
