// SPDX-License-Identifier: Apache-2.0
// Does a frame show what the map says it must? A right pose finds landmarks all
// over the image; one that rests on a part that looks alike elsewhere (a facade
// whose mirror image is a facade) finds them there only.
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_VIEW_COVERAGE_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_VIEW_COVERAGE_H_

#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/localization/localizer.h"

namespace groundlock::localization {

// Of the cells of an 8 x 6 grid over the image in which the map's nearby views
// have at least ten landmarks outside `masks_px`: the share in which `matches`
// found some. A cell with less than a twentieth of its landmarks counts half.
// 0 if there are no such cells. Thread-safe.
double ViewCoverage(const map::Map& map,
                    const geometry::CameraModel& camera,
                    const geometry::Rigid3& world_from_camera,
                    const std::vector<geometry::Box2>& masks_px,
                    const std::vector<LandmarkMatch>& matches,
                    int min_landmark_views);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_SEARCH_VIEW_COVERAGE_H_
