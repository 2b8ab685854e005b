// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/lens_check.h"

#include <algorithm>
#include <cmath>

#include "map_store/base/order_statistics.h"
#include "server/localization/search/feature_errors.h"
#include "server/localization/solvers/normal_matrix.h"
#include "server/localization/solvers/pose_estimate.h"
#include "server/localization/solvers/pose_refinement.h"

namespace groundlock::localization {
namespace {

using Matrix8d = Eigen::Matrix<double, 8, 8>;
using Vector8d = Eigen::Matrix<double, 8, 1>;

// Matches of one place share a blur, a texture's parallax, a wrong match's
// neighbour: their errors are not independent, as the formulas take them. What
// they tell has so many times the standard deviation that the formulas give.
constexpr double kFeatureDependence = 1.5;
constexpr int kLensIterations = 20;
constexpr double kNarrowing = 0.8;  // of the gate, at each iteration
// With a wider gate the distortion is left as it is: wrong matches would make
// one up.
constexpr double kDistortionGate_px = 8.0;
constexpr double kHeld = 1e9;
constexpr double kMostLogFocal = 0.9;
constexpr double kMostCorner = 0.5;
constexpr std::size_t kMostLensMatches = 400;
// Focal lengths to begin with, relative to the given one.
constexpr double kStarts[] = {1.0, 0.8, 1.25, 0.64, 1.56};
constexpr int kMinLensMatches = 40;  // as of an anchor

// With the right lens frames differ by up to 2.4 % (docs/benchmarks.md); by 5 %
// off, every pose is off by more than 10 cm at 10 m.
constexpr double kOtherFocal = 0.04;  // of the logarithm
constexpr double kOtherCorner = 0.02;
constexpr double kLensSigmas = 4.0;
// So many frames have to agree, and those that say otherwise are fewer than one
// in four of them.
constexpr std::size_t kMinAgreeing = 3;
constexpr std::size_t kMaxMeasurements = 24;
// A frame's measurement costs 20 ms: no more once so many confirm the lens.
constexpr std::size_t kEnoughSame = 6;

// A search by a lens finds cameras whose focal length is within an eighth of
// it: from half to twice the focal length in steps of a quarter.
constexpr std::size_t kMostProbes = 12;
constexpr double kProbes[] = {1.25, 0.8, 1.56, 0.64, 2.0, 0.5};

struct LensModel {
  geometry::Rigid3 world_from_camera;
  double focal = 0.0;   // relative to 1
  double corner = 0.0;  // times the squared distance over the corner's
};

struct LensEquations {
  Matrix8d H = Matrix8d::Zero();
  Vector8d b = Vector8d::Zero();
  double squared_px2 = 0.0;
  int num_inliers = 0;
};

// Of the image's corner that is farthest from the principal point.
double CornerRadius_px(const geometry::CameraModel& camera) {
  const Eigen::Vector2d center = camera.principal_point_px();
  const Eigen::Vector2d size(camera.width_px(), camera.height_px());
  return center.cwiseMax(size - center).norm();
}

LensEquations LinearizeLens(const map::Map& map,
                            const geometry::CameraModel& camera,
                            std::span<const LandmarkMatch> matches,
                            const LensModel& model,
                            double gate_px) {
  const double corner_px = CornerRadius_px(camera);
  LensEquations equations;
  for (const LandmarkMatch& match : matches) {
    Eigen::Matrix<double, 2, 6> d_pose;
    const auto error =
        ReprojectionResidual(camera,
                             model.world_from_camera,
                             map.landmarks()[match.landmark].Position(),
                             match.pixel_px,
                             &d_pose);
    if (!error) continue;
    const Eigen::Vector2d from_center =
        *error + match.pixel_px - camera.principal_point_px();
    const double share = from_center.squaredNorm() / (corner_px * corner_px);
    const double scale = 1.0 + model.focal + model.corner * share;
    const Eigen::Vector2d residual = *error + (scale - 1.0) * from_center;
    const double weight = TukeyWeight(residual.squaredNorm(), gate_px);
    if (weight <= 0.0) continue;
    Eigen::Matrix<double, 2, 8> J;
    J.leftCols<6>() =
        scale * d_pose + 2.0 * model.corner / (corner_px * corner_px) *
                             from_center * (from_center.transpose() * d_pose);
    J.col(6) = from_center;
    J.col(7) = share * from_center;
    equations.H.noalias() += weight * J.transpose() * J;
    equations.b.noalias() -= weight * J.transpose() * residual;
    equations.squared_px2 += weight * residual.squaredNorm();
    ++equations.num_inliers;
  }
  return equations;
}

// The pose from which, with `ratio` times the focal length, the landmarks look
// as large.
LensModel Dollied(const map::Map& map,
                  std::span<const LandmarkMatch> matches,
                  const geometry::Rigid3& world_from_camera,
                  double ratio) {
  const Eigen::Vector3d axis =
      world_from_camera.rotation * Eigen::Vector3d::UnitZ();
  std::vector<double> depths;
  depths.reserve(matches.size());
  for (const LandmarkMatch& match : matches) {
    depths.push_back(axis.dot(map.landmarks()[match.landmark].Position() -
                              world_from_camera.translation));
  }
  LensModel model{world_from_camera, ratio - 1.0, 0.0};
  model.world_from_camera.translation -=
      (ratio - 1.0) * base::Median(depths) * axis;
  return model;
}

struct FittedLens {
  LensModel model;
  LensEquations equations;
};

// From `model`, whose corner is 0, until all matches are gated narrowly.
std::optional<FittedLens> FitLens(const map::Map& map,
                                  const geometry::CameraModel& camera,
                                  std::span<const LandmarkMatch> matches,
                                  LensModel model) {
  double gate_px = kLensMatchRadius_px;
  for (int i = 0; i < kLensIterations; ++i) {
    LensEquations equations =
        LinearizeLens(map, camera, matches, model, gate_px);
    if (equations.num_inliers < kMinLensMatches) return std::nullopt;
    const bool is_rough = gate_px > kDistortionGate_px;
    if (is_rough) equations.H(7, 7) *= kHeld;
    const auto inverse = InvertNormalMatrix(equations.H);
    if (!inverse) return std::nullopt;
    const Vector8d step = *inverse * equations.b;
    model.world_from_camera = MovePose(model.world_from_camera, step.head<6>());
    model.focal += step[6];
    if (!is_rough) model.corner += step[7];
    // Beyond these it is no lens, but matches that fix none.
    if (!(std::abs(std::log1p(model.focal)) < kMostLogFocal &&
          std::abs(model.corner) < kMostCorner)) {
      return std::nullopt;
    }
    gate_px = std::max(kFeatureGate_px, kNarrowing * gate_px);
  }
  FittedLens fitted{
      model, LinearizeLens(map, camera, matches, model, kFeatureGate_px)};
  if (fitted.equations.num_inliers < kMinLensMatches) return std::nullopt;
  return fitted;
}

bool IsOther(double value, double sigma, double least) {
  return std::abs(value) > least && std::abs(value) > kLensSigmas * sigma;
}

bool IsSame(double value, double sigma, double least) {
  return std::abs(value) + 2.0 * sigma < least;
}

std::size_t NumSame(const std::vector<LensMeasurement>& measurements) {
  return static_cast<std::size_t>(std::count_if(
      measurements.begin(),
      measurements.end(),
      [](const LensMeasurement& measurement) {
        return IsSame(
            measurement.log_focal, measurement.log_focal_sigma, kOtherFocal);
      }));
}

// The median of those that say that it is another one, if they agree.
std::optional<double> Agreed(const std::vector<LensMeasurement>& measurements,
                             double LensMeasurement::*value,
                             double LensMeasurement::*sigma,
                             double least) {
  std::vector<double> others[2];  // smaller, greater
  std::size_t same = 0;
  for (const LensMeasurement& measurement : measurements) {
    const double v = measurement.*value;
    if (IsOther(v, measurement.*sigma, least)) {
      others[v > 0.0 ? 1 : 0].push_back(v);
    } else if (IsSame(v, measurement.*sigma, least)) {
      ++same;
    }
  }
  for (int i = 0; i < 2; ++i) {
    const std::size_t against = same + others[1 - i].size();
    if (others[i].size() >= kMinAgreeing && others[i].size() > 4 * against) {
      return base::Median(others[i]);
    }
  }
  return std::nullopt;
}

}  // namespace

std::optional<LensMeasurement> MeasureLens(
    const map::Map& map,
    const geometry::CameraModel& camera,
    std::span<const LandmarkMatch> matches,
    const geometry::Rigid3& world_from_camera) {
  std::vector<LandmarkMatch> some;
  const std::size_t stride = matches.size() / kMostLensMatches + 1;
  for (std::size_t i = 0; i < matches.size(); i += stride) {
    some.push_back(matches[i]);
  }
  std::optional<FittedLens> best;
  for (const double ratio : kStarts) {
    auto fitted = FitLens(
        map, camera, some, Dollied(map, some, world_from_camera, ratio));
    if (fitted && (!best || fitted->equations.num_inliers >
                                best->equations.num_inliers)) {
      best = std::move(fitted);
    }
  }
  if (!best) return std::nullopt;
  const LensEquations& equations = best->equations;
  const auto inverse = InvertNormalMatrix(equations.H);
  if (!inverse) return std::nullopt;
  const double variance_px2 = kFeatureDependence * kFeatureDependence *
                              equations.squared_px2 /
                              (2 * equations.num_inliers - 8);
  LensMeasurement measurement;
  measurement.log_focal = std::log1p(best->model.focal);
  measurement.log_focal_sigma =
      std::sqrt(variance_px2 * (*inverse)(6, 6)) / (1.0 + best->model.focal);
  measurement.corner = best->model.corner;
  measurement.corner_sigma = std::sqrt(variance_px2 * (*inverse)(7, 7));
  return measurement;
}

std::optional<geometry::CameraModel> WithFocalRatio(
    const geometry::CameraModel& camera, double ratio) {
  std::vector<double> params(camera.params().begin(), camera.params().end());
  params[0] *= ratio;
  if (camera.id() == geometry::CameraModelId::kPinhole ||
      camera.id() == geometry::CameraModelId::kOpenCv ||
      camera.id() == geometry::CameraModelId::kOpenCvFisheye) {
    params[1] *= ratio;
  }
  auto other = geometry::CameraModel::Create(
      camera.id(), camera.width_px(), camera.height_px(), params);
  if (!other.ok()) return std::nullopt;
  return *std::move(other);
}

bool LensCheck::WantsMore() const {
  return measurements_.size() < kMaxMeasurements &&
         NumSame(measurements_) < kEnoughSame;
}

void LensCheck::Add(const LensMeasurement& measurement) {
  if (!WantsMore()) return;
  measurements_.push_back(measurement);
  const auto focal = Agreed(measurements_,
                            &LensMeasurement::log_focal,
                            &LensMeasurement::log_focal_sigma,
                            kOtherFocal);
  const auto corner = Agreed(measurements_,
                             &LensMeasurement::corner,
                             &LensMeasurement::corner_sigma,
                             kOtherCorner);
  if (IsOther(
          measurement.log_focal, measurement.log_focal_sigma, kOtherFocal)) {
    suspected_ratio_ = std::exp(measurement.log_focal);
  }
  is_confirmed_ = NumSame(measurements_) >= kMinAgreeing && !focal && !corner;
  contradiction_.reset();
  if (!focal && !corner) return;
  contradiction_.emplace();
  if (focal) contradiction_->focal_ratio = std::exp(*focal);
  if (corner) contradiction_->corner_share = *corner;
}

std::optional<double> LensCheck::NextProbe() {
  if (contradiction_ || is_confirmed_ || num_probes_ >= kMostProbes) {
    return std::nullopt;
  }
  ++num_probes_;
  if (suspected_ratio_) return suspected_ratio_;
  return kProbes[next_probe_++ % std::size(kProbes)];
}

}  // namespace groundlock::localization
