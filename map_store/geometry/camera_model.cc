// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/camera_model.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/geometry/internal/polynomial.h"

namespace groundlock::geometry {
namespace {

using internal::EvaluatePolynomial;
using internal::FirstSignChange;
using internal::SolveIncreasing;

struct ModelTraits {
  CameraModelId id;
  std::string_view name;
  int num_params;
  int num_focals;
};

constexpr std::array<ModelTraits, 6> kModels = {{
    {CameraModelId::kSimplePinhole, "SIMPLE_PINHOLE", 3, 1},
    {CameraModelId::kPinhole, "PINHOLE", 4, 2},
    {CameraModelId::kSimpleRadial, "SIMPLE_RADIAL", 4, 1},
    {CameraModelId::kRadial, "RADIAL", 5, 1},
    {CameraModelId::kOpenCv, "OPENCV", 8, 2},
    {CameraModelId::kOpenCvFisheye, "OPENCV_FISHEYE", 8, 2},
}};

// Names of the parameters in order, for error messages.
constexpr std::array<std::array<std::string_view, 8>, 6> kParamNames = {{
    {"f", "cx", "cy"},
    {"fx", "fy", "cx", "cy"},
    {"f", "cx", "cy", "k"},
    {"f", "cx", "cy", "k1", "k2"},
    {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"},
    {"fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"},
}};

// Focal length and principal point in units of the larger image side: 0.01 is
// a view of 177 degrees, 1000 one of 3 minutes of arc.
constexpr double kMinFocalSides = 0.01;
constexpr double kMaxFocalSides = 1'000.0;
constexpr double kMaxPrincipalPointSides = 10.0;
// Calibrations of real lenses stay below 100; polynomials stay finite below.
constexpr double kMaxDistortion = 1e4;

// |x| above which a radial polynomial is taken as monotone for ever: 89.99
// degrees off the axis.
constexpr double kMaxTestedRadius = 1e4;

// Fisheye rays at 90 degrees have no point on z = 1; the tangent of this angle
// is 1e7.
constexpr double kMaxFisheyeAngle_rad = std::numbers::pi / 2.0 - 1e-7;

const ModelTraits& TraitsOf(CameraModelId id) {
  return kModels.at(static_cast<std::size_t>(id));
}

std::string_view ParamName(CameraModelId id, std::size_t index) {
  return kParamNames.at(static_cast<std::size_t>(id)).at(index);
}

absl::Status CheckParams(CameraModelId id,
                         int width_px,
                         int height_px,
                         std::span<const double> params) {
  const ModelTraits& traits = TraitsOf(id);
  if (static_cast<int>(params.size()) != traits.num_params) {
    return absl::InvalidArgumentError(absl::StrCat(base::Abseil(traits.name),
                                                   " has ",
                                                   traits.num_params,
                                                   " params, got ",
                                                   params.size()));
  }
  const double side = std::max(width_px, height_px);
  for (std::size_t i = 0; i < params.size(); ++i) {
    double low = -kMaxDistortion;
    double high = kMaxDistortion;
    if (i < static_cast<std::size_t>(traits.num_focals)) {
      low = kMinFocalSides * side;
      high = kMaxFocalSides * side;
    } else if (i < static_cast<std::size_t>(traits.num_focals) + 2) {
      low = -kMaxPrincipalPointSides * side;
      high = kMaxPrincipalPointSides * side;
    }
    if (!(params[i] >= low && params[i] <= high)) {  // also true for NaN
      return absl::InvalidArgumentError(
          absl::StrCat(base::Abseil(traits.name),
                       " params[",
                       i,
                       "] (",
                       base::Abseil(ParamName(id, i)),
                       ") is ",
                       params[i],
                       ", must lie between ",
                       low,
                       " and ",
                       high));
    }
  }
  return absl::OkStatus();
}

}  // namespace

std::string_view CameraModelName(CameraModelId id) { return TraitsOf(id).name; }

absl::StatusOr<CameraModelId> CameraModelIdFromName(std::string_view name) {
  for (const ModelTraits& traits : kModels) {
    if (traits.name == name) return traits.id;
  }
  std::string known;
  for (const ModelTraits& traits : kModels) {
    absl::StrAppend(
        &known, known.empty() ? "" : ", ", base::Abseil(traits.name));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("unknown camera model '",
                   base::Abseil(name.substr(0, 40)),
                   "'; known are ",
                   known));
}

int NumCameraModelParams(CameraModelId id) { return TraitsOf(id).num_params; }

CameraModel::CameraModel() : params_{1.0, 0.5, 0.5} { ComputeMaxRadius(); }

absl::StatusOr<CameraModel> CameraModel::Create(
    CameraModelId id,
    int width_px,
    int height_px,
    std::span<const double> params) {
  const int number = static_cast<int>(id);
  if (number < 0 || number >= static_cast<int>(kModels.size())) {
    return absl::InvalidArgumentError(
        absl::StrCat("unknown camera model id ", number));
  }
  if (width_px < 1 || width_px > kMaxSizePx) {
    return absl::InvalidArgumentError(absl::StrCat(
        "width is ", width_px, ", must lie between 1 and ", kMaxSizePx));
  }
  if (height_px < 1 || height_px > kMaxSizePx) {
    return absl::InvalidArgumentError(absl::StrCat(
        "height is ", height_px, ", must lie between 1 and ", kMaxSizePx));
  }
  RETURN_IF_ERROR(CheckParams(id, width_px, height_px, params));

  CameraModel camera;
  camera.id_ = id;
  camera.width_px_ = width_px;
  camera.height_px_ = height_px;
  camera.params_.fill(0.0);
  std::copy(params.begin(), params.end(), camera.params_.begin());
  const int num_focals = TraitsOf(id).num_focals;
  camera.focal_px_ = {params[0], params[num_focals == 2 ? 1 : 0]};
  camera.principal_point_px_ = {params[num_focals], params[num_focals + 1]};
  camera.ComputeMaxRadius();
  return camera;
}

Eigen::Matrix3d CameraModel::CalibrationMatrix() const {
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k(0, 0) = focal_px_.x();
  k(1, 1) = focal_px_.y();
  k.block<2, 1>(0, 2) = principal_point_px_;
  return k;
}

CameraModel CameraModel::Rescaled(int width_px, int height_px) const {
  CameraModel scaled = *this;
  scaled.width_px_ = std::clamp(width_px, 1, kMaxSizePx);
  scaled.height_px_ = std::clamp(height_px, 1, kMaxSizePx);
  const Eigen::Vector2d scale(
      static_cast<double>(scaled.width_px_) / width_px_,
      static_cast<double>(scaled.height_px_) / height_px_);
  const int num_focals = TraitsOf(id_).num_focals;
  if (num_focals == 1) {
    // One focal length cannot follow two scales; rounded sizes differ by less
    // than a pixel, and the mean halves that.
    scaled.params_[0] *= scale.mean();
    scaled.focal_px_.setConstant(scaled.params_[0]);
  } else {
    scaled.focal_px_ = focal_px_.cwiseProduct(scale);
    scaled.params_[0] = scaled.focal_px_.x();
    scaled.params_[1] = scaled.focal_px_.y();
  }
  scaled.principal_point_px_ = principal_point_px_.cwiseProduct(scale);
  scaled.params_.at(num_focals) = scaled.principal_point_px_.x();
  scaled.params_.at(num_focals + 1) = scaled.principal_point_px_.y();
  return scaled;
}

std::optional<CameraModel> ScaledToFit(const CameraModel& camera,
                                       int width_px,
                                       int height_px) {
  if (width_px == camera.width_px() && height_px == camera.height_px()) {
    return camera;
  }
  // Encoders want even sides: each may be off by one pixel.
  const double difference =
      std::abs(static_cast<double>(width_px) * camera.height_px() -
               static_cast<double>(height_px) * camera.width_px());
  if (width_px < 1 || height_px < 1 ||
      difference > std::max({camera.width_px(), camera.height_px()}) +
                       std::max({width_px, height_px})) {
    return std::nullopt;
  }
  return camera.Rescaled(width_px, height_px);
}

// Coefficients of the odd polynomial of |x| (fisheye: of the angle), as
// 1 + c[1] u + c[2] u^2 + ..., u = the argument squared.
std::array<double, 5> CameraModel::RadialPolynomial() const {
  const auto& p = params_;
  switch (id_) {
    case CameraModelId::kSimplePinhole:
    case CameraModelId::kPinhole:
      break;
    case CameraModelId::kSimpleRadial:
      return {1.0, p[3], 0.0, 0.0, 0.0};
    case CameraModelId::kRadial:
      return {1.0, p[3], p[4], 0.0, 0.0};
    case CameraModelId::kOpenCv:
      return {1.0, p[4], p[5], 0.0, 0.0};
    case CameraModelId::kOpenCvFisheye:
      return {1.0, p[4], p[5], p[6], p[7]};
  }
  return {1.0, 0.0, 0.0, 0.0, 0.0};
}

void CameraModel::ComputeMaxRadius() {
  const std::array<double, 5> c = RadialPolynomial();
  // d/dr (r + c1 r^3 + c2 r^5 + ...) = 1 + 3 c1 u + 5 c2 u^2 + ...
  std::array<double, 5> derivative{};
  for (std::size_t i = 0; i < c.size(); ++i) {
    derivative.at(i) = static_cast<double>(2 * i + 1) * c.at(i);
  }
  const bool fisheye = id_ == CameraModelId::kOpenCvFisheye;
  const double limit = fisheye ? kMaxFisheyeAngle_rad : kMaxTestedRadius;
  const std::optional<double> fold = FirstSignChange(derivative, limit * limit);
  if (fisheye) {
    max_radius_ = std::tan(fold.has_value() ? std::sqrt(*fold) : limit);
  } else {
    max_radius_ = fold.has_value() ? std::sqrt(*fold)
                                   : std::numeric_limits<double>::infinity();
  }
}

Eigen::Vector2d CameraModel::Distort(const Eigen::Vector2d& x,
                                     Eigen::Matrix2d* jacobian) const {
  const std::array<double, 5> c = RadialPolynomial();
  const double u = x.squaredNorm();
  // x_d = s(u) x + tangential; d x_d / d x = s I + (2 ds/du) x x^T + ...
  double s = 1.0;
  double s_prime_over_r = 0.0;  // 2 ds/du
  if (id_ == CameraModelId::kOpenCvFisheye) {
    if (u < 1e-6) {
      // Series of theta_d(atan r) / r: the quotients below lose digits.
      const double a = c[1] - 1.0 / 3.0;
      const double b = 0.2 - c[1] + c[2];
      s = 1.0 + u * (a + u * b);
      s_prime_over_r = 2.0 * a + 4.0 * u * b;
    } else {
      const double r = std::sqrt(u);
      const double theta = std::atan(r);
      const double t = theta * theta;
      const double theta_d = theta * EvaluatePolynomial(c, t);
      const double theta_d_prime =
          1.0 + t * (3.0 * c[1] +
                     t * (5.0 * c[2] + t * (7.0 * c[3] + t * 9.0 * c[4])));
      s = theta_d / r;
      s_prime_over_r = (theta_d_prime / (1.0 + u) - s) / u;
    }
  } else {
    s = 1.0 + u * (c[1] + u * c[2]);
    s_prime_over_r = 2.0 * c[1] + 4.0 * u * c[2];
  }
  Eigen::Vector2d x_d = s * x;
  if (jacobian != nullptr) {
    *jacobian = s_prime_over_r * x * x.transpose();
    jacobian->diagonal().array() += s;
  }
  if (id_ == CameraModelId::kOpenCv) {
    const double p1 = params_[6];
    const double p2 = params_[7];
    const double xy = x.x() * x.y();
    x_d.x() += 2.0 * p1 * xy + p2 * (u + 2.0 * x.x() * x.x());
    x_d.y() += 2.0 * p2 * xy + p1 * (u + 2.0 * x.y() * x.y());
    if (jacobian != nullptr) {
      const double cross = 2.0 * (p1 * x.x() + p2 * x.y());
      Eigen::Matrix2d tangential;
      tangential << 2.0 * p1 * x.y() + 6.0 * p2 * x.x(), cross, cross,
          2.0 * p2 * x.x() + 6.0 * p1 * x.y();
      *jacobian += tangential;
    }
  }
  return x_d;
}

std::optional<Eigen::Vector2d> CameraModel::ImageFromCamera(
    const Eigen::Vector3d& p_camera,
    Eigen::Matrix<double, 2, 3>* jacobian) const {
  if (!(p_camera.z() > 0.0)) return std::nullopt;
  const double inverse_z = 1.0 / p_camera.z();
  const Eigen::Vector2d x = p_camera.head<2>() * inverse_z;
  if (!(x.squaredNorm() <= max_radius_ * max_radius_)) return std::nullopt;
  const bool tangential = id_ == CameraModelId::kOpenCv;
  Eigen::Matrix2d distort_jacobian;
  const Eigen::Vector2d x_d = Distort(
      x, jacobian != nullptr || tangential ? &distort_jacobian : nullptr);
  // The tangential part can fold the image inside the radial limit.
  if (tangential && !(distort_jacobian.determinant() > 0.0)) {
    return std::nullopt;
  }
  const Eigen::Vector2d pixel =
      focal_px_.cwiseProduct(x_d) + principal_point_px_;
  if (!pixel.allFinite()) return std::nullopt;
  if (jacobian != nullptr) {
    Eigen::Matrix<double, 2, 3> projection;  // d x / d p_camera
    // clang-format off
    projection << inverse_z, 0.0, -x.x() * inverse_z,
                  0.0, inverse_z, -x.y() * inverse_z;
    // clang-format on
    *jacobian = focal_px_.asDiagonal() * distort_jacobian * projection;
  }
  return pixel;
}

std::optional<Eigen::Vector2d> CameraModel::UndistortRadial(
    const Eigen::Vector2d& x_d) const {
  const double r_d = x_d.norm();
  const bool fisheye = id_ == CameraModelId::kOpenCvFisheye;
  const double high = fisheye ? std::atan(max_radius_) : max_radius_;
  const std::optional<double> solution =
      SolveIncreasing(RadialPolynomial(), high, r_d);
  if (!solution.has_value()) return std::nullopt;
  if (r_d < 1e-12) return x_d;  // the polynomial starts as the identity
  const double r = fisheye ? std::tan(*solution) : *solution;
  return Eigen::Vector2d(x_d * (r / r_d));
}

// Newton's method with the exact Jacobian, started at the radial part's inverse
// (the tangential part is a small correction in every real lens).
std::optional<Eigen::Vector2d> CameraModel::UndistortTangential(
    const Eigen::Vector2d& x_d) const {
  Eigen::Vector2d x = UndistortRadial(x_d).value_or(
      x_d.normalized() * std::min(0.99 * max_radius_, x_d.norm()));
  const double tolerance = 1e-12 * (1.0 + x_d.norm());
  Eigen::Matrix2d jacobian;
  Eigen::Vector2d residual = Distort(x, &jacobian) - x_d;
  for (int i = 0; i < 50 && residual.norm() > 0.01 * tolerance; ++i) {
    if (!(std::abs(jacobian.determinant()) > 1e-12)) return std::nullopt;
    const Eigen::Vector2d step = jacobian.inverse() * residual;
    double fraction = 1.0;  // halved until the residual falls
    Eigen::Vector2d next = x - step;
    Eigen::Vector2d next_residual = Distort(next, nullptr) - x_d;
    while (!(next_residual.norm() < residual.norm()) && fraction > 1e-3) {
      fraction *= 0.5;
      next = x - fraction * step;
      next_residual = Distort(next, nullptr) - x_d;
    }
    if (!(next_residual.norm() < residual.norm())) break;
    x = next;
    residual = Distort(x, &jacobian) - x_d;
  }
  Distort(x, &jacobian);
  if (!(residual.norm() <= tolerance) || !(x.norm() <= max_radius_) ||
      !(jacobian.determinant() > 0.0)) {
    return std::nullopt;
  }
  return x;
}

std::optional<Eigen::Vector2d> CameraModel::NormalizedFromImage(
    const Eigen::Vector2d& pixel_px) const {
  if (!pixel_px.allFinite()) return std::nullopt;
  const Eigen::Vector2d x_d =
      (pixel_px - principal_point_px_).cwiseQuotient(focal_px_);
  switch (id_) {
    case CameraModelId::kSimplePinhole:
    case CameraModelId::kPinhole:
      return x_d;
    case CameraModelId::kSimpleRadial:
    case CameraModelId::kRadial:
    case CameraModelId::kOpenCvFisheye:
      return UndistortRadial(x_d);
    case CameraModelId::kOpenCv:
      return UndistortTangential(x_d);
  }
  return std::nullopt;
}

std::optional<Eigen::Vector3d> CameraModel::RayFromImage(
    const Eigen::Vector2d& pixel_px) const {
  const std::optional<Eigen::Vector2d> x = NormalizedFromImage(pixel_px);
  if (!x.has_value()) return std::nullopt;
  return x->homogeneous().normalized();
}

bool CameraModel::IsInsideImage(const Eigen::Vector2d& pixel_px,
                                double margin_px) const {
  return pixel_px.x() >= margin_px && pixel_px.y() >= margin_px &&
         pixel_px.x() < width_px_ - margin_px &&
         pixel_px.y() < height_px_ - margin_px;
}

}  // namespace groundlock::geometry
