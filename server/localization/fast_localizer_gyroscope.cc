// SPDX-License-Identifier: Apache-2.0
// How FastLocalizer uses a gyroscope: to know where to look before it looks,
// and how the camera turns where nothing is seen.
#include <algorithm>
#include <utility>

#include "server/localization/fast_localizer.h"

namespace groundlock::localization {
namespace {

// So many frames more that the camera was found in without the gyroscope only,
// than with it, are no coincidence.
constexpr int kMaxContradictions = 10;
// Slower than this, axes or a clock that are wrong look like a bias, and do not
// show: 3 deg/s is the most that data sheets give a bias.
constexpr double kTellingRate_rad_s = 0.2;
// What is off by more standard deviations is no chance.
constexpr double kSigmas = 5.0;

// About all axes together.
double RotationVariance(const geometry::Matrix6d& covariance) {
  return covariance.bottomRightCorner<3, 3>().trace();
}

}  // namespace

std::optional<GyroscopeTurn> FastLocalizer::TakeInGyroscope(
    const LocalizationRequest& request) {
  if (!known_.gyroscope) return std::nullopt;
  known_.gyroscope->Add(request.inertial);
  const auto now = request.frame->capture_time;
  std::optional<GyroscopeTurn> turn;
  if (known_.last_time) {
    turn = known_.gyroscope->Between(
        *known_.last_time, now, known_.filter.gyroscope_errors());
  }
  known_.gyroscope->ForgetBefore(now);
  return turn;
}

std::optional<FastLocalizer::Followed> FastLocalizer::FollowByGyroscope(
    const LocalizationRequest& request, const GyroscopeTurn& turn) {
  const PoseFilter without = known_.filter;
  known_.filter.UpdateFromGyroscope(PoseFilter::kLastFrame, turn);
  const double expected_rad2 = RotationVariance(
      known_.filter.RelativeCovariance(PoseFilter::kLastFrame));
  // A jolt is taken in against all that was expected.
  const auto agrees = [&] {
    const Eigen::Quaterniond before_from_now =
        known_.filter.pose(PoseFilter::kLastFrame)
            .world_from_camera.rotation.conjugate() *
        known_.filter.pose().world_from_camera.rotation;
    const double off_rad =
        geometry::AngleBetween_rad(before_from_now, turn.before_from_now);
    return off_rad * off_rad <=
           kSigmas * kSigmas *
               (expected_rad2 +
                RotationVariance(known_.filter.pose().covariance));
  };
  auto followed = FollowFromExpected(request);
  if (followed && agrees()) {
    if (turn.rate_now_rad_s.norm() > kTellingRate_rad_s) {
      known_.gyroscope_contradictions =
          std::max(0, known_.gyroscope_contradictions - 1);
    }
    return followed;
  }
  PoseFilter with = std::exchange(known_.filter, without);
  followed = FollowFromExpected(request);
  if (followed) {
    if (++known_.gyroscope_contradictions >= kMaxContradictions)
      known_.gyroscope.reset();
    return followed;
  }
  // Nothing is seen, and the gyroscope sees it all the same.
  known_.filter = std::move(with);
  return std::nullopt;
}

}  // namespace groundlock::localization
