// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/body_kind.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "server/tracking/body_size.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

constexpr int kDirections = 12;  // of half a turn
constexpr int kHalvings = 2;     // of their step, about the likeliest one
// How well the camera's height over the ground is known, with which all sizes
// grow: relative.
constexpr double kGroundSigma = 0.05;
// What is known of nothing: seen from an unknown side, apparent depth and width
// are alike to a factor of 1.5, height to one of 2.2 about 0.7 of them, and
// things on the ground are of any size (a factor of 3.3 about 1.5 m).
constexpr double kAnySide_m = 1.5;
constexpr double kAnySideSigma = 1.2;
constexpr double kAnyTallness = 0.7;
constexpr double kAnyTallnessSigma = 0.8;
constexpr double kAnyRatioSigma = 0.4;
// Half of what is marked is none of the kinds, before it is looked at; so sure
// it must be one after that.
constexpr double kNoKind = 0.5;
constexpr double kSureOfKind = 0.8;

ground::SizePrior AnySize() {
  ground::SizePrior prior;
  prior.size_m = {kAnySide_m, kAnySide_m, kAnyTallness * kAnySide_m};
  // Rows: length over width, height over the footprint's side, that side.
  prior.whitening_log << 1.0 / kAnyRatioSigma, -1.0 / kAnyRatioSigma, 0.0,
      -0.5 / kAnyTallnessSigma, -0.5 / kAnyTallnessSigma,
      1.0 / kAnyTallnessSigma, 0.5 / kAnySideSigma, 0.5 / kAnySideSigma, 0.0;
  return prior;
}

// Not what is half or twice as tall, or narrower or longer by as much: that
// spares the time of finding out how badly it fits.
bool MayBe(const BodyKind& kind, const Eigen::Vector3d& seen_m) {
  const double side_m = Side(seen_m);
  return seen_m.z() > 0.5 * kind.size_m.z() &&
         seen_m.z() < 2.0 * kind.size_m.z() && side_m > 0.5 * kind.size_m.y() &&
         side_m < 2.0 * kind.size_m.x();
}

}  // namespace

ground::SizePrior BodyKind::Size() const {
  const Eigen::Matrix3d covariance_log =
      Eigen::Matrix3d(log_sigma.cwiseAbs2().asDiagonal()) +
      kGroundSigma * kGroundSigma * Eigen::Matrix3d::Ones();
  ground::SizePrior prior;
  prior.size_m = size_m;
  prior.whitening_log =
      covariance_log.llt().matrixL().solve(Eigen::Matrix3d::Identity());
  return prior;
}

ground::ShapePrior BodyKind::Shape() const {
  const Eigen::Array3d variance = log_sigma.array().square();
  return {.length_over_width = size_m.x() / size_m.y(),
          .length_over_width_sigma = std::sqrt(variance[0] + variance[1]),
          .tallness = size_m.z() / std::sqrt(size_m.x() * size_m.y()),
          .tallness_sigma =
              std::sqrt(variance[2] + 0.25 * (variance[0] + variance[1]))};
}

std::span<const BodyKind> BodyKinds() {
  static const std::array<BodyKind, 7> kKinds = {
      BodyKind{"car", {4.5, 1.85, 1.62}, {0.10, 0.08, 0.09}, 0.55},
      BodyKind{"van", {5.2, 1.95, 2.2}, {0.12, 0.08, 0.12}, 0.06},
      BodyKind{"truck", {8.3, 2.6, 3.1}, {0.30, 0.10, 0.15}, 0.08},
      BodyKind{"bus", {11.9, 2.9, 3.4}, {0.15, 0.07, 0.08}, 0.02},
      BodyKind{"motorcycle", {2.2, 0.85, 1.6}, {0.10, 0.15, 0.12}, 0.02},
      BodyKind{"bicycle", {1.75, 0.65, 1.65}, {0.08, 0.18, 0.12}, 0.05},
      BodyKind{"person", {0.75, 0.68, 1.75}, {0.25, 0.18, 0.07}, 0.22}};
  return kKinds;
}

std::optional<KindFit> FitLikelyKind(const ground::GroundView& view,
                                     const Box2& box_px) {
  const auto bottom = ground::GroundFromImage(
      view, {box_px.center_px().x(), box_px.max_px.y()});
  if (!bottom) return std::nullopt;
  const Eigen::Vector3d away = ground::AwayOnGround(view, *bottom);
  const Eigen::Vector3d& up = view.ground_world.normal;
  const auto any = ground::FitBoxOfSize(view, box_px, away, AnySize());
  if (!any) return std::nullopt;
  constexpr double kOdds = (1.0 - kNoKind) / kNoKind / kDirections;
  struct Way {
    KindFit found;
    double direction_rad;
    double weight;  // relative to that of any size
  };
  const auto fit = [&](const BodyKind& kind,
                       double direction_rad) -> std::optional<Way> {
    const auto box = ground::FitBoxOfSize(
        view, box_px, Eigen::AngleAxisd(direction_rad, up) * away, kind.Size());
    if (!box) return std::nullopt;
    return Way{
        {&kind, *box},
        direction_rad,
        kOdds * kind.share * std::exp(box->log_evidence - any->log_evidence)};
  };
  constexpr double kStep_rad = std::numbers::pi / kDirections;
  std::vector<Way> ways;
  double weight = 0.0;
  for (const BodyKind& kind : BodyKinds()) {
    if (!MayBe(kind, any->box.size_m)) continue;
    for (int i = 0; i < kDirections; ++i) {
      const auto way = fit(kind, i * kStep_rad);
      if (!way) continue;
      weight += way->weight;
      ways.push_back(*way);
    }
  }
  if (ways.empty() || !(weight > kSureOfKind * (1.0 + weight))) {
    return std::nullopt;
  }
  Way best = *std::max_element(
      ways.begin(), ways.end(), [](const Way& a, const Way& b) {
        return a.weight < b.weight;
      });
  double squared_rad2 = 0.0;
  for (const Way& way : ways) {
    // Half a turn is none.
    const double off_rad = std::remainder(
        way.direction_rad - best.direction_rad, std::numbers::pi);
    squared_rad2 += way.weight * off_rad * off_rad;
  }
  best.found.axis_sigma_rad = std::sqrt(squared_rad2 / weight);
  KindFit found = best.found;
  double step_rad = kStep_rad;
  for (int i = 0; i < kHalvings; ++i) {
    step_rad *= 0.5;
    const double middle_rad = best.direction_rad;
    for (const double sign : {-1.0, 1.0}) {
      const auto way = fit(*found.kind, middle_rad + sign * step_rad);
      if (!way || way->weight <= best.weight) continue;
      best = *way;
      found.fit = best.found.fit;
    }
  }
  return found;
}

}  // namespace groundlock::tracking
