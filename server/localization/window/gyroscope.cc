// SPDX-License-Identifier: Apache-2.0
#include "server/localization/window/gyroscope.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "map_store/geometry/rigid3.h"
#include "server/localization/window/seconds.h"

namespace groundlock::localization {
namespace {

using std::chrono::nanoseconds;

// Gyroscopes end at 4000 deg/s; higher numbers are degrees taken for radians.
constexpr double kMaxRate_rad_s = 70.0;
// Of crash sensors: 400 g.
constexpr double kMaxAcceleration_m_s2 = 4'000.0;
// Samples farther apart have something missing between them.
constexpr nanoseconds kMaxGap = std::chrono::milliseconds(50);

// How Exp(v) turns with v, from the right.
Eigen::Matrix3d RightJacobian(const Eigen::Vector3d& v) {
  const double angle2 = v.squaredNorm();
  const Eigen::Matrix3d V = geometry::Skew(v);
  if (angle2 < 1e-8) return Eigen::Matrix3d::Identity() - 0.5 * V;
  const double angle = std::sqrt(angle2);
  return Eigen::Matrix3d::Identity() - (1.0 - std::cos(angle)) / angle2 * V +
         (angle - std::sin(angle)) / (angle2 * angle) * V * V;
}

absl::Status CheckNotNegative(const char* field, double value, double most) {
  if (value >= 0.0 && value <= most) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, " is ", value, ", must be in [0, ", most, "]"));
}

}  // namespace

absl::Status ValidateInertial(std::span<const InertialSample> samples) {
  if (samples.size() > kMaxInertialSamples) {
    return absl::InvalidArgumentError(absl::StrCat(
        samples.size(), " samples, at most ", kMaxInertialSamples));
  }
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const InertialSample& sample = samples[i];
    const auto wrong = [i](const auto&... parts) {
      return absl::InvalidArgumentError(absl::StrCat("[", i, "].", parts...));
    };
    if (sample.time.count() < 0) {
      return wrong("time_ns: ", sample.time.count(), " is below 0");
    }
    if (i > 0 && sample.time <= samples[i - 1].time) {
      return wrong("time_ns: ",
                   sample.time.count(),
                   " is not above ",
                   samples[i - 1].time.count(),
                   ", that of the sample before");
    }
    // NaN fails these, too.
    if (!(sample.angular_rate_rad_s.cwiseAbs().maxCoeff() <= kMaxRate_rad_s) ||
        !sample.angular_rate_rad_s.allFinite()) {
      return wrong("angular_rate_rad_s: not within ",
                   kMaxRate_rad_s,
                   " rad/s about each axis (degrees?)");
    }
    if (!(sample.acceleration_m_s2.cwiseAbs().maxCoeff() <=
          kMaxAcceleration_m_s2) ||
        !sample.acceleration_m_s2.allFinite()) {
      return wrong("acceleration_m_s2: not within ",
                   kMaxAcceleration_m_s2,
                   " m/s^2 along each axis");
    }
  }
  return absl::OkStatus();
}

absl::Status ImuModel::Validate() const {
  if (!imu_from_camera.coeffs().allFinite() ||
      std::abs(imu_from_camera.norm() - 1.0) > 1e-6) {
    return absl::InvalidArgumentError("imu_from_camera is no unit quaternion");
  }
  // Far above what the worst gyroscopes have.
  constexpr double kMost = 10.0;
  for (const auto& [field, value] :
       {std::pair{"gyroscope_noise_rad_s_sqrt_hz",
                  gyroscope_noise_rad_s_sqrt_hz},
        std::pair{"gyroscope_walk_rad_s2_sqrt_hz",
                  gyroscope_walk_rad_s2_sqrt_hz},
        std::pair{"gyroscope_bias_rad_s", gyroscope_bias_rad_s}}) {
    const absl::Status valid = CheckNotNegative(field, value, kMost);
    if (!valid.ok()) return valid;
  }
  return absl::OkStatus();
}

GyroscopeTurn::ErrorJacobian ErrorJacobianOfRate(
    const Eigen::Vector3d& rate_rad_s) {
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  GyroscopeTurn::ErrorJacobian J;
  J << I, rate_rad_s.x() * I, rate_rad_s.y() * I, rate_rad_s.z() * I;
  return J;
}

void Gyroscope::Add(std::span<const InertialSample> samples) {
  const Eigen::Quaterniond camera_from_imu = imu_.imu_from_camera.conjugate();
  for (const InertialSample& sample : samples) {
    if (!samples_.empty() && sample.time <= samples_.back().time) continue;
    samples_.push_back(
        {sample.time, camera_from_imu * sample.angular_rate_rad_s});
  }
  // A clock that runs ahead of the frames' must not gather samples for ever.
  while (samples_.size() > 2 * kMaxInertialSamples) samples_.pop_front();
}

std::optional<Eigen::Vector3d> Gyroscope::RateAt(nanoseconds time) const {
  if (samples_.empty()) return std::nullopt;
  const auto after = std::lower_bound(
      samples_.begin(), samples_.end(), time, [](const Rate& a, nanoseconds t) {
        return a.time < t;
      });
  if (after == samples_.end()) {
    const Rate& last = samples_.back();
    if (time - last.time > kMaxGap) return std::nullopt;
    return last.rate_rad_s;
  }
  if (after->time == time) return after->rate_rad_s;
  if (after == samples_.begin()) {
    if (after->time - time > kMaxGap) return std::nullopt;
    return after->rate_rad_s;
  }
  const Rate& before = *std::prev(after);
  if (after->time - before.time > kMaxGap) return std::nullopt;
  const double f =
      Seconds(time - before.time) / Seconds(after->time - before.time);
  return (1.0 - f) * before.rate_rad_s + f * after->rate_rad_s;
}

std::optional<GyroscopeTurn> Gyroscope::Between(
    nanoseconds before, nanoseconds now, const GyroscopeErrors& errors) const {
  const auto first = RateAt(before);
  const auto last = RateAt(now);
  if (!(now > before) || !first || !last) return std::nullopt;
  GyroscopeTurn turn;
  turn.duration_s = Seconds(now - before);
  const Eigen::Matrix3d unscaled =
      (Eigen::Matrix3d::Identity() + errors.scale).inverse();
  turn.rate_now_rad_s = unscaled * (*last - errors.bias_rad_s);
  nanoseconds at = before;
  Eigen::Vector3d rate = *first;
  int steps = 0;
  const auto step = [&](nanoseconds to, const Eigen::Vector3d& rate_there) {
    if (to <= at) return true;
    if (to - at > kMaxGap) return false;
    const double dt_s = Seconds(to - at);
    // The mean of both ends: exact to the second order.
    const Eigen::Vector3d true_rate_rad_s =
        unscaled * (0.5 * (rate + rate_there) - errors.bias_rad_s);
    const Eigen::Vector3d turned = dt_s * true_rate_rad_s;
    const Eigen::Quaterniond q = geometry::QuaternionFromRotationVector(turned);
    turn.error_jacobian =
        q.toRotationMatrix().transpose() * turn.error_jacobian +
        dt_s * RightJacobian(turned) * unscaled *
            ErrorJacobianOfRate(true_rate_rad_s);
    turn.before_from_now = (turn.before_from_now * q).normalized();
    at = to;
    rate = rate_there;
    ++steps;
    return true;
  };
  for (const Rate& sample : samples_) {
    if (sample.time <= before) continue;
    if (sample.time >= now) break;
    if (!step(sample.time, sample.rate_rad_s)) return std::nullopt;
  }
  if (!step(now, *last)) return std::nullopt;
  turn.sample_period_s = turn.duration_s / steps;
  return turn;
}

void Gyroscope::ForgetBefore(nanoseconds time) {
  // One sample at or before it is what rates there are interpolated from.
  while (samples_.size() > 1 && samples_[1].time <= time) samples_.pop_front();
}

}  // namespace groundlock::localization
