// SPDX-License-Identifier: Apache-2.0
// A camera in steady motion, and what the tests of PoseFilter measure of it.
#ifndef GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_POSE_FILTER_TEST_H_
#define GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_POSE_FILTER_TEST_H_

#include <gtest/gtest.h>

#include <chrono>

#include "server/localization/window/pose_filter.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {

using geometry::Matrix6d;
using geometry::Rigid3;
using geometry::Vector6d;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using test_support::AngleError_rad;
using test_support::CenterError;
using test_support::MakeWorldFromCamera;

inline constexpr nanoseconds kStep = milliseconds(40);

// 1.2 m/s and 0.5 rad/s, about directions of its own.
inline Rigid3 PoseAt(nanoseconds time) {
  const double t_s = std::chrono::duration<double>(time).count();
  Vector6d motion;
  motion << 1.0 * t_s, -0.6 * t_s, 0.3 * t_s, 0.1 * t_s, -0.2 * t_s, 0.45 * t_s;
  return MovePose(MakeWorldFromCamera(), motion);
}

// Of what is followed: as much as an ordinary frame says.
inline constexpr double kOrdinary = 40.0;
inline constexpr double kWhateverItTakes = 1e9;

// A millimetre and a milliradian.
inline Matrix6d Sharp() { return 1e-6 * Matrix6d::Identity(); }

inline MapMeasurement FromMap(const Rigid3& pose,
                              const Matrix6d& random = Sharp(),
                              const Matrix6d& systematic = Matrix6d::Zero(),
                              double shared = 0.0) {
  return {pose, random, systematic, shared};
}

inline PoseFilter Moving(int frames) {
  PoseFilter filter{PoseFilterOptions()};
  filter.Start(nanoseconds(0), FromMap(PoseAt(nanoseconds(0))));
  for (int i = 1; i <= frames; ++i) {
    filter.Propagate(i * kStep);
    EXPECT_TRUE(filter.UpdateFromMap(FromMap(PoseAt(i * kStep))));
  }
  return filter;
}

inline double Nees(const PoseEstimate& estimate, const Rigid3& truth) {
  const Vector6d error = PoseDifference(estimate.world_from_camera, truth);
  return error.dot(estimate.covariance.ldlt().solve(error));
}

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_TESTS_UNIT_SERVER_LOCALIZATION_POSE_FILTER_TEST_H_
