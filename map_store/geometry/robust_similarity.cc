// SPDX-License-Identifier: Apache-2.0
#include "map_store/geometry/robust_similarity.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <optional>
#include <random>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/geometry/ransac.h"

namespace groundlock::geometry {
namespace {

using Points = std::span<const Eigen::Vector3d>;

// Square root of the 95 % quantile of chi squared with 3 degrees of freedom.
constexpr double kGate = 2.795;
constexpr double kHuber = 1.345;
constexpr int kRefinements = 20;

struct Moments {
  double weight = 0.0;
  Eigen::Vector3d source = Eigen::Vector3d::Zero();
  Eigen::Vector3d target = Eigen::Vector3d::Zero();
};

// Weighted least squares; nullopt if the points do not determine it.
std::optional<Similarity3> Solve(Points source,
                                 Points target,
                                 std::span<const double> weights,
                                 bool upright) {
  Moments mean;
  for (std::size_t i = 0; i < source.size(); ++i) {
    mean.weight += weights[i];
    mean.source += weights[i] * source[i];
    mean.target += weights[i] * target[i];
  }
  if (!(mean.weight > 0.0)) return std::nullopt;
  mean.source /= mean.weight;
  mean.target /= mean.weight;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double source_variance = 0.0;
  for (std::size_t i = 0; i < source.size(); ++i) {
    const Eigen::Vector3d s = source[i] - mean.source;
    const Eigen::Vector3d t = target[i] - mean.target;
    covariance += weights[i] * t * s.transpose();
    source_variance += weights[i] * s.squaredNorm();
  }
  if (!(source_variance > 0.0)) return std::nullopt;
  Similarity3 result;
  double gain = 0.0;  // trace(R^T covariance)
  if (upright) {
    // Maximises the trace over rotations about z.
    const double cosine = covariance(0, 0) + covariance(1, 1);
    const double sine = covariance(1, 0) - covariance(0, 1);
    const double horizontal = std::hypot(cosine, sine);
    if (!(horizontal > 1e-9 * covariance.norm())) return std::nullopt;
    result.rotation = Eigen::Quaterniond(
        Eigen::AngleAxisd(std::atan2(sine, cosine), Eigen::Vector3d::UnitZ()));
    gain = horizontal + covariance(2, 2);
  } else {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(
        covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
    const Eigen::Vector3d& values = svd.singularValues();
    if (!(values(1) > 1e-9 * values(0))) return std::nullopt;  // on a line
    Eigen::Vector3d signs = Eigen::Vector3d::Ones();
    if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0) {
      signs.z() = -1.0;
    }
    result.rotation = Eigen::Quaterniond(Eigen::Matrix3d(
        svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose()));
    result.rotation.normalize();
    gain = values.dot(signs);
  }
  result.scale = gain / source_variance;
  if (!(result.scale > 0.0) || !std::isfinite(result.scale)) {
    return std::nullopt;
  }
  result.translation =
      mean.target - result.scale * (result.rotation * mean.source);
  return result;
}

std::vector<double> Errors(Points source,
                           Points target,
                           const Similarity3& similarity) {
  std::vector<double> errors(source.size());
  for (std::size_t i = 0; i < source.size(); ++i) {
    errors[i] = (similarity * source[i] - target[i]).norm();
  }
  return errors;
}

// Of the pairs, truncated at the gate: tells models apart that have the same
// number of inliers (MSAC, Torr & Zisserman 2000).
double Cost(std::span<const double> errors, double gate) {
  double cost = 0.0;
  for (const double error : errors) {
    cost += std::min(error * error, gate * gate);
  }
  return cost;
}

// Two or three pairs propose; the one of least cost wins.
struct SimilarityProblem {
  using Model = Similarity3;
  using Support = double;  // the cost

  Points source;
  Points target;
  bool upright;
  double gate;

  template <typename Consider>
  void Sample(std::mt19937_64& generator, Consider consider) const {
    const std::size_t sample_size = upright ? 2 : 3;
    std::array<Eigen::Vector3d, 3> sample_source;
    std::array<Eigen::Vector3d, 3> sample_target;
    const std::array<double, 3> ones = {1.0, 1.0, 1.0};
    for (std::size_t i = 0; i < sample_size; ++i) {
      const auto index = static_cast<std::size_t>(
          ((generator() >> 32U) * source.size()) >> 32U);
      sample_source.at(i) = source[index];
      sample_target.at(i) = target[index];
    }
    const auto candidate = Solve(std::span(sample_source).first(sample_size),
                                 std::span(sample_target).first(sample_size),
                                 std::span(ones).first(sample_size),
                                 upright);
    if (candidate) consider(*candidate);
  }
  std::optional<double> SupportOf(const Similarity3& similarity,
                                  const double* best) const {
    const double cost = Cost(Errors(source, target, similarity), gate);
    if (best != nullptr && !(cost < *best)) return std::nullopt;
    return cost;
  }
};

std::optional<Similarity3> BestOfSamples(
    Points source, Points target, const RobustSimilarityOptions& options) {
  SimilarityProblem problem{
      source, target, options.upright, kGate * options.sigma};
  std::mt19937_64 generator(options.seed);
  const auto found = Ransac(problem, options.rounds, generator);
  if (!found.best) return std::nullopt;
  return found.best->model;
}

}  // namespace

absl::StatusOr<RobustSimilarity> EstimateSimilarityRobustly(
    Points p_source, Points p_target, const RobustSimilarityOptions& options) {
  const std::size_t needed = options.upright ? 2 : 3;
  if (p_source.size() != p_target.size() || p_source.size() < needed) {
    return absl::InvalidArgumentError(absl::StrCat("a similarity needs ",
                                                   needed,
                                                   " pairs of points, got ",
                                                   p_source.size(),
                                                   " and ",
                                                   p_target.size()));
  }
  if (!(options.sigma > 0.0) || options.rounds < 1) {
    return absl::InvalidArgumentError("sigma and rounds must be positive");
  }
  for (std::size_t i = 0; i < p_source.size(); ++i) {
    if (!p_source[i].allFinite() || !p_target[i].allFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat("pair ", i, " is not finite"));
    }
  }
  auto current = BestOfSamples(p_source, p_target, options);
  const double gate = kGate * options.sigma;
  RobustSimilarity result;
  for (int i = 0; current && i < kRefinements; ++i) {
    const std::vector<double> errors = Errors(p_source, p_target, *current);
    std::vector<double> weights(errors.size(), 0.0);
    std::vector<bool> inliers(errors.size());
    for (std::size_t j = 0; j < errors.size(); ++j) {
      inliers[j] = errors[j] < gate;
      const double scaled = errors[j] / options.sigma;
      if (inliers[j]) weights[j] = scaled <= kHuber ? 1.0 : kHuber / scaled;
    }
    const bool settled = i > 2 && inliers == result.inliers;
    result.inliers = inliers;
    const auto refined = Solve(p_source, p_target, weights, options.upright);
    if (!refined) break;
    current = refined;
    if (settled && i > 5) break;
  }
  if (!current) {
    return absl::FailedPreconditionError(options.upright
                                             ? "the points lie above each other"
                                             : "the points lie on one line");
  }
  result.target_from_source = *current;
  const std::vector<double> errors = Errors(p_source, p_target, *current);
  for (std::size_t j = 0; j < errors.size(); ++j) {
    result.inliers[j] = errors[j] < gate;
    if (result.inliers[j]) ++result.num_inliers;
  }
  if (static_cast<std::size_t>(result.num_inliers) < needed ||
      2 * static_cast<std::size_t>(result.num_inliers) < p_source.size()) {
    return absl::FailedPreconditionError(
        absl::StrCat("no similarity brings even half of the ",
                     p_source.size(),
                     " pairs to within ",
                     absl::SixDigits(gate),
                     ": the best fits ",
                     result.num_inliers));
  }
  return result;
}

Eigen::Vector3d PrincipalSpread(Points points) {
  if (points.empty()) return Eigen::Vector3d::Zero();
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) mean += p;
  mean /= static_cast<double>(points.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& p : points) {
    scatter += (p - mean) * (p - mean).transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(
      Eigen::Matrix3d(scatter / static_cast<double>(points.size())),
      Eigen::EigenvaluesOnly);
  return solver.eigenvalues().reverse().cwiseMax(0.0).cwiseSqrt();
}

}  // namespace groundlock::geometry
