// SPDX-License-Identifier: Apache-2.0
// What users write down of places: control points, points of a map, the ground.
#ifndef GROUNDLOCK_CLIENT_CLI_CONTROL_POINTS_H_
#define GROUNDLOCK_CLIENT_CLI_CONTROL_POINTS_H_

#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/sdk/map_types.h"

namespace groundlock::cli {

// {"points":[{"name":"corner",
//             "position":[x,y,z] or
//             "pixels":[{"image":"a.jpg","xy":[x,y]},...], "place":[x,y,z] or
//             {"latitude_deg":..,"longitude_deg":..,
//                                 "height_m":..}}, ...]}
// kInvalidArgument names the point and the field.
absl::StatusOr<std::vector<sdk::AlignRequest::ControlPoint>>
ControlPointsFromJson(std::string_view json);

// "X,Y,Z", a position in the map's world; or "IMAGE@X,Y;IMAGE@X,Y;...", pixels
// in images.
absl::StatusOr<sdk::MapPoint> ParseMapPoint(std::string_view text);

// "LATITUDE,LONGITUDE[,HEIGHT]", degrees and metres.
absl::StatusOr<geometry::GeodeticPosition> ParseGeodetic(std::string_view text);

// "auto"; "X,Y,Z", a point on the ground; "A,B,C,D", the plane
// A x + B y + C z + D = 0; all in the map's world.
absl::Status ParseGround(std::string_view text, sdk::AlignRequest* request);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_CONTROL_POINTS_H_
