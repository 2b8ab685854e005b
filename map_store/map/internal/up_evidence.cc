// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/up_evidence.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace groundlock::map::internal {
namespace {

// Roll of a camera that is held level: gimbals 1 degree, hands 3.
constexpr double kRollSigma_rad = 0.05;
// Share of cameras that are not held level at all, and how densely their rolls
// then lie, against the peak of those that are.
constexpr double kNotLevel = 0.15;
constexpr double kNotLevelDensity = 0.1;
// Climbing, likewise.
constexpr double kClimbSigma_rad = 0.15;
constexpr double kClimbing = 0.3;
constexpr double kClimbingDensity = 0.2;
// Images that look the same way within this share their roll: a gimbal's error
// is the same in all of them.
constexpr double kSameLook_rad = 0.09;
constexpr double kMaxLooks = 20.0;
constexpr double kMaxWays = 4.0;
constexpr std::size_t kWays = 12;

double Robust(double angle_rad,
              double sigma_rad,
              double share,
              double density) {
  const double z = angle_rad / sigma_rad;
  return std::log((1.0 - share) * std::exp(-0.5 * z * z) + share * density) -
         std::log(1.0 - share + share * density);
}

}  // namespace

UpEvidence::UpEvidence(std::span<const geometry::Rigid3> camera_from_world) {
  std::vector<Eigen::Vector3d> centers;
  std::vector<std::size_t> looks;
  for (std::size_t i = 0; i < camera_from_world.size(); ++i) {
    const Eigen::Matrix3d R = camera_from_world[i].rotation.toRotationMatrix();
    rights_.emplace_back(R.row(0));
    downs_.emplace_back(R.row(1));
    forwards_.emplace_back(R.row(2));
    centers.push_back(camera_from_world[i].Inverse().translation);
    const bool is_new =
        std::none_of(looks.begin(), looks.end(), [&](std::size_t look) {
          return rights_[look].cross(rights_[i]).norm() < kSameLook_rad &&
                 forwards_[look].cross(forwards_[i]).norm() < kSameLook_rad;
        });
    if (is_new && static_cast<double>(looks.size()) < kMaxLooks) {
      looks.push_back(i);
    }
  }
  num_looks_ = static_cast<double>(looks.size());
  // Between places far enough apart that noise does not decide the direction.
  double length = 0.0;
  for (std::size_t i = 1; i < centers.size(); ++i) {
    length += (centers[i] - centers[i - 1]).norm();
  }
  std::size_t from = 0;
  for (std::size_t i = 1; i < centers.size(); ++i) {
    const Eigen::Vector3d way = centers[i] - centers[from];
    if (!(way.norm() > length / kWays)) continue;
    ways_.push_back(way.normalized());
    from = i;
  }
}

double UpEvidence::LogOf(const Eigen::Vector3d& up) const {
  if (rights_.empty()) return 0.0;
  double level = 0.0;
  double upright = 0.0;
  for (std::size_t i = 0; i < rights_.size(); ++i) {
    const double roll = std::asin(std::clamp(rights_[i].dot(up), -1.0, 1.0));
    level += Robust(roll, kRollSigma_rad, kNotLevel, kNotLevelDensity);
    // Up is up in the image, or out of it for a camera that looks down.
    upright += downs_[i].dot(up) < 0.2 ? 0.0 : 1.0;
  }
  const auto count = static_cast<double>(rights_.size());
  double log = num_looks_ * level / count - 6.0 * upright / count;
  double climbs = 0.0;
  for (const Eigen::Vector3d& way : ways_) {
    climbs += Robust(std::asin(std::clamp(way.dot(up), -1.0, 1.0)),
                     kClimbSigma_rad,
                     kClimbing,
                     kClimbingDensity);
  }
  if (!ways_.empty()) {
    const auto num_ways = static_cast<double>(ways_.size());
    log += std::min(kMaxWays, num_ways) * climbs / num_ways;
  }
  return log;
}

double UpEvidence::SpreadAbout_rad(const Eigen::Vector3d& up) const {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& right : rights_) {
    const Eigen::Vector3d along = right - right.dot(up) * up;
    if (along.norm() > 0.1)
      sum += along.normalized() * along.normalized().transpose();
  }
  const double total = sum.trace();
  if (!(total > 0.0)) return 0.0;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(sum / total);
  // Axes spread evenly over an angle a have a second eigenvalue of
  // (1 - sin(a) / a) / 2, for small a a^2 / 12.
  return std::sqrt(12.0 * std::max(0.0, eigen.eigenvalues()[1]));
}

double UpEvidence::LooksAlong(const Eigen::Vector3d& up) const {
  double sum = 0.0;
  for (const Eigen::Vector3d& forward : forwards_) {
    sum += std::abs(forward.dot(up));
  }
  return forwards_.empty() ? 0.0 : sum / static_cast<double>(forwards_.size());
}

Eigen::Vector3d UpEvidence::Best() const {
  Eigen::Vector3d up = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& down : downs_) up -= down;
  if (!(up.norm() > 1e-6)) return Eigen::Vector3d::UnitZ();
  up.normalize();
  // Perpendicular to the axes to the right, as far as they agree.
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& right : rights_) sum += right * right.transpose();
  sum /= static_cast<double>(rights_.size());
  // A level camera's sigma, and a weak pull to the mean of the images' up.
  const Eigen::Matrix3d A =
      sum / (kRollSigma_rad * kRollSigma_rad) + Eigen::Matrix3d::Identity();
  const Eigen::Vector3d best = A.ldlt().solve(up);
  return best.norm() > 1e-9 ? best.normalized() : up;
}

}  // namespace groundlock::map::internal
