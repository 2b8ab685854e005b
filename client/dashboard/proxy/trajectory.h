// SPDX-License-Identifier: Apache-2.0
// Results as the files that other tools read.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_TRAJECTORY_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_TRAJECTORY_H_

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "groundlock/v1/geometry.pb.h"
#include "groundlock/v1/tracking.pb.h"

namespace groundlock::dashboard {

namespace gl = ::groundlock::v1;

enum class TrajectoryFormat { kCsv, kTum, kKml, kGeoJson };

// "csv", "tum", "kml", "geojson"; kInvalidArgument lists them.
absl::StatusOr<TrajectoryFormat> TrajectoryFormatFromName(
    std::string_view name);
std::string_view MimeType(TrajectoryFormat format);
std::string_view Extension(TrajectoryFormat format);

// csv: the columns that `groundlock track --results` writes. tum: "t x y z qx
// qy qz qw" per pose, seconds and metres, of the camera (`of` empty or
// "camera"; frames in which it is TRACKED, HELD or ODOMETRY) or of a target
// (its centre on the ground and its heading). kml, geojson: the camera's and
// each target's line, WGS84; kFailedPrecondition without `origin`, the place
// whose east, north and up the world's axes are. kNotFound: no target of that
// name.
absl::StatusOr<std::string> WriteTrajectory(
    const std::vector<std::shared_ptr<const gl::FrameResult>>& results,
    TrajectoryFormat format,
    std::string_view of,
    const std::optional<gl::GeodeticPosition>& origin);

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_TRAJECTORY_H_
