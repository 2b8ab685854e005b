// SPDX-License-Identifier: Apache-2.0
// Tests in a made-up place and its map, made once for all of an executable's.
#ifndef GROUNDLOCK_TESTS_SUPPORT_RENDERED_PLACE_TEST_H_
#define GROUNDLOCK_TESTS_SUPPORT_RENDERED_PLACE_TEST_H_

#include <gtest/gtest.h>

#include <memory>
#include <opencv2/core/utility.hpp>

#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "tests/support/rendered_plane_map.h"

namespace groundlock::test_support {

class RenderedPlaceTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    // Sessions are the threads; OpenCV's own, which no sanitizer sees into,
    // would only look like races.
    cv::setNumThreads(1);
    if (map_ != nullptr) return;
    place_ = std::make_unique<RenderedPlace>(1);
    map_ = OpenTemporaryMap(MapFromViews(*place_, MappingViews()));
    ASSERT_NE(map_, nullptr);
  }

  static inline std::unique_ptr<RenderedPlace> place_;
  static inline std::shared_ptr<const map::Map> map_;
  // A camera between the mapping views, at another height and angle.
  const geometry::Rigid3 truth_ = LookAlongY({0.35, 0.3, 1.7}, 0.05, -0.05);
};

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_RENDERED_PLACE_TEST_H_
