// SPDX-License-Identifier: Apache-2.0
// Results that are the same to the last bit.
#ifndef GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_SAME_RESULT_H_
#define GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_SAME_RESULT_H_

#include <gtest/gtest.h>

#include "server/localization/localizer.h"

namespace groundlock::localization {

inline void ExpectSame(const LocalizationResult& a,
                       const LocalizationResult& b,
                       int frame) {
  SCOPED_TRACE(frame);
  ASSERT_EQ(a.state, b.state);
  ASSERT_EQ(a.reset_count, b.reset_count);
  ASSERT_EQ(a.num_inliers, b.num_inliers);
  ASSERT_EQ(a.mean_reprojection_error_px, b.mean_reprojection_error_px);
  ASSERT_EQ(a.ignores_gyroscope, b.ignores_gyroscope);
  ASSERT_EQ(a.lens_contradiction.has_value(), b.lens_contradiction.has_value());
  ASSERT_EQ(a.covariance, b.covariance);
  ASSERT_EQ(a.world_from_camera.has_value(), b.world_from_camera.has_value());
  if (a.world_from_camera) {
    ASSERT_EQ(a.world_from_camera->translation,
              b.world_from_camera->translation);
    ASSERT_EQ(a.world_from_camera->rotation.coeffs(),
              b.world_from_camera->rotation.coeffs());
  }
  ASSERT_EQ(a.inliers.size(), b.inliers.size());
  for (std::size_t i = 0; i < a.inliers.size(); ++i) {
    ASSERT_EQ(a.inliers[i].landmark, b.inliers[i].landmark);
    ASSERT_EQ(a.inliers[i].pixel_px, b.inliers[i].pixel_px);
  }
}

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_SAME_RESULT_H_
