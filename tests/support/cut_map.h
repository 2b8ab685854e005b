// SPDX-License-Identifier: Apache-2.0
// A map of which a part is missing.
#ifndef GROUNDLOCK_TESTS_SUPPORT_CUT_MAP_H_
#define GROUNDLOCK_TESTS_SUPPORT_CUT_MAP_H_

#include "map_store/geometry/plane.h"
#include "map_store/map/map_data.h"

namespace groundlock::test_support {

// Without the landmarks and the views in front of the plane.
map::MapData CutMap(const map::MapData& whole, const geometry::Plane& plane);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_CUT_MAP_H_
