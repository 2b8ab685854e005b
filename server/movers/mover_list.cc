// SPDX-License-Identifier: Apache-2.0
#include "server/movers/mover_list.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>
#include <tuple>

namespace groundlock::movers {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix4d;
using Eigen::Vector2d;
using Eigen::Vector4d;
using geometry::Box2;

// It is reported from here on, and no longer from there on.
constexpr double kBelieved = 0.9;
constexpr double kDoubted = 0.4;
constexpr double kForgotten = 0.03;
constexpr std::size_t kMaxListed = 64;
// Speed and direction change by this share of the speed within a second
// (1 sigma): of a car that brakes or turns; independent of the map's scale.
constexpr double kChangePerSecond = 0.6;
// Chi-square of four degrees, 99.9 %.
constexpr double kMaxInnovation = 18.5;
// Findings with so many points in common are of one thing.
constexpr double kSharedPoints = 0.3;
// Chance findings per key view, anywhere in the image.
constexpr double kChanceFindings = 0.5;
// A box takes this share of the newest finding's size: points come and go.
constexpr double kNewSize = 0.3;

double SharedShare(const std::vector<std::uint64_t>& a,
                   const std::vector<std::uint64_t>& b) {
  if (a.empty() || b.empty()) return 0.0;
  std::vector<std::uint64_t> common;
  std::set_intersection(
      a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(common));
  return static_cast<double>(common.size()) /
         static_cast<double>(std::min(a.size(), b.size()));
}

Matrix4d Covariance(const Finding& finding) {
  Matrix4d covariance = Matrix4d::Zero();
  covariance.topLeftCorner<2, 2>() = finding.place_covariance_m2;
  covariance.bottomRightCorner<2, 2>() = finding.velocity_covariance_m2_s2;
  return covariance;
}

Vector4d State(const Finding& finding) {
  Vector4d state;
  state << finding.place_m, finding.velocity_m_s;
  return state;
}

void Predict(ListedMover& mover, double step_s) {
  Matrix4d transition = Matrix4d::Identity();
  transition.topRightCorner<2, 2>() = step_s * Matrix2d::Identity();
  mover.state = transition * mover.state;
  const double change = kChangePerSecond * mover.state.tail<2>().norm();
  const double noise = change * change * step_s;
  mover.covariance = transition * mover.covariance * transition.transpose();
  // White acceleration, integrated over the step.
  mover.covariance.topLeftCorner<2, 2>() +=
      noise * step_s * step_s / 3.0 * Matrix2d::Identity();
  mover.covariance.topRightCorner<2, 2>() +=
      noise * step_s / 2.0 * Matrix2d::Identity();
  mover.covariance.bottomLeftCorner<2, 2>() +=
      noise * step_s / 2.0 * Matrix2d::Identity();
  mover.covariance.bottomRightCorner<2, 2>() += noise * Matrix2d::Identity();
  mover.unseen_s += step_s;
}

}  // namespace

bool IsSamePlace(const Box2& a_px, const Box2& b_px) {
  const double common = geometry::Intersection(a_px, b_px).Area();
  const double smaller = std::min(a_px.Area(), b_px.Area());
  return common > 0.5 * smaller ||
         geometry::IntersectionOverUnion(a_px, b_px) > 1.0 / 3.0;
}

void MoverList::Correct(ListedMover& mover,
                        const Finding& finding,
                        double image_px2) {
  const Vector4d innovation = State(finding) - mover.state;
  const Matrix4d total = mover.covariance + Covariance(finding);
  const Matrix2d place_total = total.topLeftCorner<2, 2>();
  const double density_per_m2 =
      std::exp(-0.5 * innovation.head<2>().dot(
                          place_total.ldlt().solve(innovation.head<2>()))) /
      (2.0 * std::numbers::pi *
       std::sqrt(std::max(1e-300, place_total.determinant())));
  const double chance_per_px2 = kChanceFindings / image_px2;
  mover.existence =
      Found(model_,
            mover.existence,
            density_per_m2 * finding.ground_per_image_m2_px2 / chance_per_px2);
  const Matrix4d gain = mover.covariance * total.inverse();
  mover.state += gain * innovation;
  mover.covariance -= gain * mover.covariance;
  mover.covariance =
      (0.5 * (mover.covariance + mover.covariance.transpose())).eval();
  mover.box_px = Box2::FromCenter(finding.box_px.center_px(),
                                  (1.0 - kNewSize) * mover.box_px.size_px() +
                                      kNewSize * finding.box_px.size_px());
  mover.point_ids = finding.point_ids;
  mover.unseen_s = 0.0;
}

void MoverList::Update(std::span<const Finding> findings,
                       double step_s,
                       double image_px2) {
  for (ListedMover& mover : movers_) {
    Predict(mover, step_s);
    mover.existence = PredictExistence(model_, mover.existence, step_s);
  }
  // Those that share points first, the most first; then the nearest.
  std::vector<std::tuple<int, double, std::size_t, std::size_t>> pairs;
  for (std::size_t m = 0; m < movers_.size(); ++m) {
    for (std::size_t f = 0; f < findings.size(); ++f) {
      const double shared =
          SharedShare(movers_[m].point_ids, findings[f].point_ids);
      if (shared >= kSharedPoints) {
        pairs.emplace_back(0, -shared, m, f);
        continue;
      }
      const Vector4d innovation = State(findings[f]) - movers_[m].state;
      const Matrix4d total = movers_[m].covariance + Covariance(findings[f]);
      const double distance = innovation.dot(total.ldlt().solve(innovation));
      if (distance < kMaxInnovation) pairs.emplace_back(1, distance, m, f);
    }
  }
  std::sort(pairs.begin(), pairs.end());
  std::vector<bool> mover_taken(movers_.size(), false);
  std::vector<bool> finding_taken(findings.size(), false);
  for (const auto& [kind, cost, m, f] : pairs) {
    if (mover_taken[m] || finding_taken[f]) continue;
    mover_taken[m] = finding_taken[f] = true;
    Correct(movers_[m], findings[f], image_px2);
  }
  for (std::size_t m = 0; m < mover_taken.size(); ++m) {
    if (!mover_taken[m]) {
      movers_[m].existence = NotFound(model_, movers_[m].existence);
    }
  }
  for (std::size_t f = 0; f < findings.size(); ++f) {
    if (finding_taken[f] || movers_.size() >= kMaxListed) continue;
    ListedMover mover;
    mover.existence = model_.birth;
    mover.box_px = findings[f].box_px;
    mover.state = State(findings[f]);
    mover.covariance = Covariance(findings[f]);
    mover.point_ids = findings[f].point_ids;
    movers_.push_back(std::move(mover));
  }
  for (ListedMover& mover : movers_) {
    if (mover.id == 0 && mover.existence >= kBelieved) mover.id = next_id_++;
  }
  std::erase_if(movers_, [](const ListedMover& mover) {
    return mover.existence < (mover.reported() ? kDoubted : kForgotten);
  });
  std::stable_sort(movers_.begin(),
                   movers_.end(),
                   [](const ListedMover& a, const ListedMover& b) {
                     return a.existence > b.existence;
                   });
}

void MoverList::NotePlaces(
    const std::function<std::optional<Vector2d>(const Vector2d& place_m)>&
        pixel_px) {
  for (ListedMover& mover : movers_) {
    if (mover.unseen_s == 0.0) mover.place_px = pixel_px(mover.state.head<2>());
  }
}

void MoverList::Forget(std::span<const Box2> boxes_px) {
  std::erase_if(movers_, [&](const ListedMover& mover) {
    return std::any_of(
        boxes_px.begin(), boxes_px.end(), [&](const Box2& box_px) {
          return IsSamePlace(mover.box_px, box_px);
        });
  });
}

}  // namespace groundlock::movers
