// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/body_kind.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "server/tracking/body_size.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

constexpr int kDirections = 12;  // of half a turn
constexpr double kStep_rad = std::numbers::pi / kDirections;
constexpr int kHalvings = 2;  // of their step, about the likeliest one
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
// Of a size that a client tells: data sheets leave out mirrors, loads and what
// was built on. Nothing that moves on the ground is larger than the longest
// road train or ship, or as thin as a plank.
constexpr double kMeasuredSigma = 0.05;
constexpr double kLargestBody_m = 500.0;
constexpr double kLongestOfBody = 100.0;

ground::SizePrior AnySize() {
  ground::SizePrior prior =
      ground::SizePriorOf({.length_over_width = 1.0,
                           .length_over_width_sigma = kAnyRatioSigma,
                           .tallness = kAnyTallness,
                           .tallness_sigma = kAnyTallnessSigma});
  prior.size_m *= kAnySide_m / Side(prior.size_m);
  prior.whitening_log.row(2) << 0.5 / kAnySideSigma, 0.5 / kAnySideSigma, 0.0;
  return prior;
}

//   scale_sigma  by which all extents are larger or smaller together.
ground::SizePrior PriorOf(const BodyKind& kind,
                          const Eigen::Vector3d& size,
                          double scale_sigma) {
  const Eigen::Matrix3d covariance_log =
      Eigen::Matrix3d(kind.log_sigma.cwiseAbs2().asDiagonal()) +
      (scale_sigma * scale_sigma + kind.scale_sigma * kind.scale_sigma) *
          Eigen::Matrix3d::Ones();
  ground::SizePrior prior;
  prior.size_m = size;
  prior.whitening_log =
      covariance_log.llt().matrixL().solve(Eigen::Matrix3d::Identity());
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

// One way of standing, and how likely it is.
struct Way {
  const BodyKind* kind = nullptr;
  ground::SizePrior size;
  ground::BoxFit fit = {};
  double direction_rad = 0.0;  // from `away_world`
  double log_weight = 0.0;
};

// Where a box in the image is seen, from where ways of standing are counted.
struct Marked {
  const ground::GroundView& view;
  const Box2& box_px;
  Eigen::Vector3d away_world;
};

std::optional<Marked> MarkedAt(const ground::GroundView& view,
                               const Box2& box_px) {
  const auto bottom = ground::GroundFromImage(
      view, {box_px.center_px().x(), box_px.max_px.y()});
  if (!bottom) return std::nullopt;
  return Marked{view, box_px, ground::AwayOnGround(view, *bottom)};
}

// `way` with its fit and the weight of that; false: it does not fit.
bool Fit(const Marked& marked, double log_odds, Way& way) {
  const Eigen::Vector3d heading_world =
      Eigen::AngleAxisd(way.direction_rad, marked.view.ground_world.normal) *
      marked.away_world;
  const auto fit =
      ground::FitBoxOfSize(marked.view, marked.box_px, heading_world, way.size);
  if (!fit) return false;
  way.fit = *fit;
  way.log_weight = log_odds + fit->log_evidence;
  return true;
}

void AddWays(const Marked& marked,
             const BodyKind& kind,
             const ground::SizePrior& size,
             double log_odds,
             std::vector<Way>& ways) {
  for (int i = 0; i < kDirections; ++i) {
    Way way{.kind = &kind, .size = size, .direction_rad = i * kStep_rad};
    if (Fit(marked, log_odds, way)) ways.push_back(std::move(way));
  }
}

// Of at least one.
KindFit LikeliestOf(const Marked& marked, std::span<const Way> ways) {
  Way best = *std::max_element(
      ways.begin(), ways.end(), [](const Way& a, const Way& b) {
        return a.log_weight < b.log_weight;
      });
  double weight = 0.0;
  double squared_rad2 = 0.0;
  for (const Way& way : ways) {
    // Half a turn is none.
    const double off_rad = std::remainder(
        way.direction_rad - best.direction_rad, std::numbers::pi);
    const double relative = std::exp(way.log_weight - best.log_weight);
    weight += relative;
    squared_rad2 += relative * off_rad * off_rad;
  }
  const double log_odds = best.log_weight - best.fit.log_evidence;
  double step_rad = kStep_rad;
  for (int i = 0; i < kHalvings; ++i) {
    step_rad *= 0.5;
    const double middle_rad = best.direction_rad;
    for (const double sign : {-1.0, 1.0}) {
      Way way = best;
      way.direction_rad = middle_rad + sign * step_rad;
      if (Fit(marked, log_odds, way) && way.log_weight > best.log_weight) {
        best = std::move(way);
      }
    }
  }
  return {.kind = *best.kind,
          .fit = best.fit,
          .axis_sigma_rad = std::sqrt(squared_rad2 / weight)};
}

absl::Status CheckSize(const Eigen::Vector3d& size_m) {
  constexpr std::array<const char*, 3> kAxes = {"x", "y", "z"};
  for (int k = 0; k < 3; ++k) {
    if (!(size_m[k] > 0.0) || !(size_m[k] <= kLargestBody_m)) {
      return absl::InvalidArgumentError(
          absl::StrCat("body.size_m.",
                       kAxes[k],
                       ": ",
                       size_m[k],
                       ", where more than 0 and at most ",
                       kLargestBody_m,
                       " is expected"));
    }
  }
  if (size_m.maxCoeff() > kLongestOfBody * size_m.minCoeff()) {
    return absl::InvalidArgumentError(absl::StrCat("body.size_m: ",
                                                   size_m.x(),
                                                   " x ",
                                                   size_m.y(),
                                                   " x ",
                                                   size_m.z(),
                                                   ": one extent is more than ",
                                                   kLongestOfBody,
                                                   " times another"));
  }
  return absl::OkStatus();
}

}  // namespace

ground::SizePrior BodyKind::Size() const {
  return PriorOf(*this, size_m, kGroundSigma);
}

ground::SizePrior BodyKind::SizeInAnyUnit(double side) const {
  return PriorOf(*this, side / Side(size_m) * size_m, kAnySideSigma);
}

std::span<const BodyKind> BodyKinds() {
  static const std::array<BodyKind, 8> kKinds = {
      BodyKind{"car", {4.5, 1.85, 1.62}, {0.10, 0.08, 0.09}, 0.55},
      BodyKind{"van", {5.2, 1.95, 2.2}, {0.12, 0.08, 0.12}, 0.06},
      BodyKind{"truck", {8.3, 2.6, 3.1}, {0.30, 0.10, 0.15}, 0.08},
      BodyKind{"bus", {11.9, 2.9, 3.4}, {0.15, 0.07, 0.08}, 0.02},
      BodyKind{"motorcycle", {2.2, 0.85, 1.6}, {0.10, 0.15, 0.12}, 0.02},
      BodyKind{"bicycle", {1.75, 0.65, 1.65}, {0.08, 0.18, 0.12}, 0.05},
      BodyKind{"person", {0.75, 0.68, 1.75}, {0.25, 0.18, 0.07}, 0.22},
      BodyKind{"boat", {5.0, 1.9, 1.4}, {0.07, 0.07, 0.25}, 0.0, 0.3}};
  return kKinds;
}

absl::StatusOr<std::optional<BodyKind>> KindOf(const TargetBody& told) {
  std::optional<BodyKind> kind;
  if (!told.kind.empty()) {
    for (const BodyKind& known : BodyKinds()) {
      if (known.name == told.kind) kind = known;
    }
    if (!kind) {
      return absl::InvalidArgumentError(absl::StrCat(
          "body.kind: '",
          told.kind,
          "' is none of ",
          absl::StrJoin(
              BodyKinds(), ", ", [](std::string* out, const BodyKind& k) {
                absl::StrAppend(out, base::Abseil(k.name));
              })));
    }
  }
  if (told.size_m) {
    RETURN_IF_ERROR(CheckSize(*told.size_m));
    if (!kind) kind.emplace();
    kind->size_m = *told.size_m;
    kind->log_sigma.setConstant(kMeasuredSigma);
    kind->scale_sigma = 0.0;
    kind->was_measured = true;
  }
  return kind;
}

std::optional<KindFit> FitLikelyKind(const ground::GroundView& view,
                                     const Box2& box_px) {
  const auto marked = MarkedAt(view, box_px);
  if (!marked) return std::nullopt;
  const auto any =
      ground::FitBoxOfSize(view, box_px, marked->away_world, AnySize());
  if (!any) return std::nullopt;
  constexpr double kOdds = (1.0 - kNoKind) / kNoKind / kDirections;
  std::vector<Way> ways;
  for (const BodyKind& kind : BodyKinds()) {
    if (!(kind.share > 0.0) || !MayBe(kind, any->box.size_m)) continue;
    AddWays(*marked, kind, kind.Size(), std::log(kOdds * kind.share), ways);
  }
  double weight = 0.0;  // relative to that of any size
  for (const Way& way : ways) {
    weight += std::exp(way.log_weight - any->log_evidence);
  }
  if (ways.empty() || !(weight > kSureOfKind * (1.0 + weight))) {
    return std::nullopt;
  }
  return LikeliestOf(*marked, ways);
}

std::optional<KindFit> FitKind(const ground::GroundView& view,
                               const Box2& box_px,
                               const BodyKind& kind,
                               bool metric) {
  const auto marked = MarkedAt(view, box_px);
  if (!marked) return std::nullopt;
  ground::SizePrior size = kind.Size();
  if (!metric && !kind.was_measured) {
    const auto any =
        ground::FitBoxOfSize(view, box_px, marked->away_world, AnySize());
    if (!any) return std::nullopt;
    size = kind.SizeInAnyUnit(Side(any->box.size_m));
  }
  std::vector<Way> ways;
  AddWays(*marked, kind, size, /*log_odds=*/0.0, ways);
  if (ways.empty()) return std::nullopt;
  return LikeliestOf(*marked, ways);
}

}  // namespace groundlock::tracking
