// SPDX-License-Identifier: Apache-2.0
// The lens that a map remembers, where the user names none.
#ifndef GROUNDLOCK_CLIENT_CLI_MAP_LENS_H_
#define GROUNDLOCK_CLIENT_CLI_MAP_LENS_H_

#include <string>

#include "absl/status/statusor.h"
#include "client/sdk/client.h"
#include "client/sdk/types.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::cli {

// "1280x720, SIMPLE_RADIAL, focal length 919.2 px".
std::string LensText(const geometry::CameraModel& lens);

// The map's lens; kInvalidArgument says why --camera is needed if it does not
// tell one.
absl::StatusOr<geometry::CameraModel> LensOfMap(sdk::Client& client,
                                                const std::string& map_name);

// `lens` for pictures of that size: itself, or scaled. kInvalidArgument if they
// are not the same picture.
absl::StatusOr<geometry::CameraModel> LensForSize(
    const geometry::CameraModel& lens,
    const std::string& map_name,
    int width_px,
    int height_px);

// What to say of a lens that was given where the map's own, for the same
// pictures, is another one by more than any calibration is off: people give the
// file of another camera, or of another size of picture, and get a place that
// is off by metres. "" if they agree, or the pictures are not the same.
std::string LensWarning(const geometry::CameraModel& given,
                        const geometry::CameraModel& of_map);

// What to say of a lens that the frames contradict.
std::string SeenLensWarning(const geometry::CameraModel& lens,
                            const sdk::LensContradiction& seen);

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_MAP_LENS_H_
