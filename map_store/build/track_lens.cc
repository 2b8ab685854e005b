// SPDX-License-Identifier: Apache-2.0
// How sure the lens of a TrackScene is, and what follows for the lens.
#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <utility>
#include <vector>

#include "map_store/build/internal/track_scene.h"

namespace groundlock::build::internal {
namespace {

// Stretches of time that are left out by turns.
constexpr std::size_t kBlocks = 10;
// Parts of the picture that are left out by turns: so many columns, and as many
// parts of each.
constexpr std::size_t kColumns = 3;
// Relative to the diagonal: the seven directions that no picture shows.
constexpr double kGauge = 1e-9;
// Beyond this share of the prior's weight the data alone do not say what the
// lens is.
constexpr double kPriorTells = 0.05;

constexpr int kMaxSteps = 4;
constexpr double kSmallStep = 0.3;  // of a sigma
constexpr double kLongestStep = 0.1;

// The principal point is taken for the picture's middle, which is true to a
// hundredth of the width or so: the calibrated camera of Strecha et al. 2008 is
// off by 0.005 and 0.006. What that makes of the focal length all stretches of
// time have in common.
constexpr double kPrincipalSigma = 0.01;
// What the model lacks in all stretches alike (a shutter that rolls, a
// stabiliser, one coefficient of distortion): flights with one kind of camera
// gave focal lengths that differ by 1 % and more where their tracks alone
// promise 0.2 %.
constexpr double kModelSigma = 0.01;
// log f, k; x and y of the principal point, which is not adjusted.
constexpr Eigen::Index kLens = 4;
constexpr Eigen::Index kAdjusted = 2;
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
using LensBorder = Eigen::Matrix<double, 6, kLens>;

// Normal equations of poses and lens with the points eliminated.
struct Reduced {
  std::map<std::pair<std::uint32_t, std::uint32_t>, Matrix6d> poses;
  std::vector<LensBorder> border;
  Eigen::Matrix4d lens = Eigen::Matrix4d::Zero();
  Eigen::VectorXd gradient;  // 6 per pose, then the lens

  explicit Reduced(std::size_t num_poses)
      : border(num_poses, LensBorder::Zero()),
        gradient(Eigen::VectorXd::Zero(
            6 * static_cast<Eigen::Index>(num_poses) + kLens)) {}

  void Add(const Reduced& other, double sign) {
    for (const auto& [key, value] : other.poses) {
      poses.try_emplace(key, Matrix6d::Zero()).first->second += sign * value;
    }
    for (std::size_t i = 0; i < border.size(); ++i) {
      border[i] += sign * other.border[i];
    }
    lens += sign * other.lens;
    gradient += sign * other.gradient;
  }
};

// What one sight says, in sigmas, weighted as Cauchy's loss does.
struct Linearised {
  std::uint32_t pose = 0;
  Eigen::Vector2d residual;
  Eigen::Matrix<double, 2, 6> by_pose;  // turn and shift in the camera's axes
  Eigen::Matrix<double, 2, kLens> by_lens;
  Eigen::Matrix<double, 2, 3> by_point;
};

std::optional<Linearised> Linearise(const RadialLens& lens,
                                    const geometry::Rigid3& camera_from_world,
                                    const Eigen::Vector3d& p_world,
                                    const Eigen::Vector2d& pixel_px) {
  const Eigen::Vector3d p = camera_from_world * p_world;
  if (!(p.z() > 1e-6 * p.norm())) return std::nullopt;
  const Eigen::Vector2d x = p.head<2>() / p.z();
  const double r2 = x.squaredNorm();
  const double radial = 1.0 + lens.k * r2;
  const Eigen::Matrix2d by_x =
      lens.focal_px *
      (radial * Eigen::Matrix2d::Identity() + 2.0 * lens.k * x * x.transpose());
  Eigen::Matrix<double, 2, 3> x_by_p;
  x_by_p << 1.0 / p.z(), 0.0, -x.x() / p.z(), 0.0, 1.0 / p.z(), -x.y() / p.z();
  const Eigen::Matrix<double, 2, 3> by_p = by_x * x_by_p;
  Eigen::Matrix3d cross;
  cross << 0.0, -p.z(), p.y(), p.z(), 0.0, -p.x(), -p.y(), p.x(), 0.0;
  Linearised result;
  result.residual = lens.ImageFromCamera(p) - pixel_px;
  const double scale = 1.0 / kTrackSigma_px;
  const double off = result.residual.norm() / kTrackRobust_px;
  const double weighted = scale / std::sqrt(1.0 + off * off);
  result.residual *= weighted;
  result.by_pose << -by_p * cross, by_p;
  result.by_pose *= weighted;
  result.by_lens.col(0) = weighted * lens.focal_px * radial * x;
  result.by_lens.col(1) = weighted * lens.focal_px * r2 * x;
  result.by_lens.rightCols<2>() = weighted * Eigen::Matrix2d::Identity();
  result.by_point =
      weighted * by_p * camera_from_world.rotation.toRotationMatrix();
  return result;
}

void AddTrack(const std::vector<Linearised>& sights, Reduced& reduced) {
  Eigen::Matrix3d point = Eigen::Matrix3d::Zero();
  Eigen::Vector3d point_gradient = Eigen::Vector3d::Zero();
  Eigen::Matrix<double, 3, kLens> lens_point =
      Eigen::Matrix<double, 3, kLens>::Zero();
  for (const Linearised& s : sights) {
    point += s.by_point.transpose() * s.by_point;
    point_gradient += s.by_point.transpose() * s.residual;
    lens_point += s.by_point.transpose() * s.by_lens;
  }
  point.diagonal().array() += kGauge * point.trace();
  const Eigen::LDLT<Eigen::Matrix3d> solver(point);
  if (solver.info() != Eigen::Success) return;
  const Eigen::Matrix<double, 3, kLens> solved_lens = solver.solve(lens_point);
  const Eigen::Vector3d solved_gradient = solver.solve(point_gradient);
  const Eigen::Index lens_at = reduced.gradient.size() - kLens;
  reduced.lens -= lens_point.transpose() * solved_lens;
  reduced.gradient.tail<kLens>() -= lens_point.transpose() * solved_gradient;
  for (const Linearised& a : sights) {
    const Eigen::Matrix<double, 6, 3> a_point =
        a.by_pose.transpose() * a.by_point;
    const Eigen::Matrix<double, 6, 3> a_solved =
        solver.solve(a_point.transpose()).transpose();
    reduced.poses.try_emplace({a.pose, a.pose}, Matrix6d::Zero())
        .first->second += a.by_pose.transpose() * a.by_pose;
    for (const Linearised& b : sights) {
      if (b.pose > a.pose) continue;
      reduced.poses.try_emplace({a.pose, b.pose}, Matrix6d::Zero())
          .first->second -= a_solved * b.by_point.transpose() * b.by_pose;
    }
    reduced.border[a.pose] +=
        a.by_pose.transpose() * a.by_lens - a_solved * lens_point;
    reduced.gradient.segment<6>(6 * a.pose) +=
        a.by_pose.transpose() * a.residual - a_solved * point_gradient;
    reduced.lens += a.by_lens.transpose() * a.by_lens;
    reduced.gradient.segment<kLens>(lens_at) +=
        a.by_lens.transpose() * a.residual;
  }
}

struct LensStep {
  double log_focal = 0.0;  // to the optimum
  // What that changes by with the principal point, 1/px.
  Eigen::RowVector2d by_principal = Eigen::RowVector2d::Zero();
  // Of log f, if all errors were independent.
  double variance = 0.0;
};

// nullopt if there is no optimum.
std::optional<LensStep> StepOfLens(const Reduced& reduced) {
  const Eigen::Index size = reduced.gradient.size() - kLens;
  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(36 * reduced.poses.size());
  for (const auto& [key, block] : reduced.poses) {
    for (int r = 0; r < 6; ++r) {
      for (int c = 0; c < 6; ++c) {
        const int row = 6 * static_cast<int>(key.first) + r;
        const int column = 6 * static_cast<int>(key.second) + c;
        if (row < column) continue;
        const double gauge = row == column ? kGauge * block(r, c) + 1e-12 : 0.0;
        entries.emplace_back(row, column, block(r, c) + gauge);
      }
    }
  }
  Eigen::SparseMatrix<double> poses(size, size);
  poses.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(poses);
  if (solver.info() != Eigen::Success) return std::nullopt;
  Eigen::MatrixXd right(size, kLens + 1);
  for (std::size_t i = 0; i < reduced.border.size(); ++i) {
    right.block<6, kLens>(6 * static_cast<Eigen::Index>(i), 0) =
        reduced.border[i];
  }
  const Eigen::MatrixXd border = right.leftCols<kLens>();
  right.col(kLens) = reduced.gradient.head(size);
  const Eigen::MatrixXd solved = solver.solve(right);
  const Eigen::Matrix4d lens =
      reduced.lens - border.transpose() * solved.leftCols<kLens>();
  const Eigen::Vector4d gradient =
      reduced.gradient.tail<kLens>() - border.transpose() * solved.col(kLens);
  const Eigen::LDLT<Eigen::Matrix2d> solver2(
      lens.topLeftCorner<kAdjusted, kAdjusted>());
  if (solver2.info() != Eigen::Success || !solver2.isPositive()) {
    return std::nullopt;
  }
  LensStep step;
  step.log_focal = -solver2.solve(gradient.head<kAdjusted>())[0];
  step.by_principal =
      -solver2.solve(lens.topRightCorner<kAdjusted, 2>()).row(0);
  step.variance = solver2.solve(Eigen::Matrix2d::Identity())(0, 0);
  if (!std::isfinite(step.log_focal) || !step.by_principal.allFinite() ||
      !(step.variance > 0.0)) {
    return std::nullopt;
  }
  return step;
}

// A track as it adds to the normal equations, and where it is.
struct LinearisedTrack {
  std::uint32_t middle = 0;  // the pose at the middle of its sights
  Eigen::Vector2d mean_px = Eigen::Vector2d::Zero();
  std::vector<Linearised> sights;
};

// Of log f: what it varies by when each of the blocks is left out by turns.
// nullopt if it cannot be told without one of them.
std::optional<double> Jackknife(const Reduced& all,
                                const std::vector<Reduced>& blocks) {
  const auto count = static_cast<double>(blocks.size());
  std::vector<double> steps;
  double mean = 0.0;
  for (const Reduced& block : blocks) {
    Reduced rest = all;
    rest.Add(block, -1.0);
    const auto step = StepOfLens(rest);
    if (!step) return std::nullopt;
    steps.push_back(step->log_focal);
    mean += step->log_focal / count;
  }
  double sum = 0.0;
  for (const double step : steps) sum += (step - mean) * (step - mean);
  // A variance from so few has a spread of its own: Student's t.
  const double freedom = count - 1.0;
  return sum * (count - 1.0) / count * freedom / (freedom - 2.0);
}

// Of each part of the picture; they hold as many tracks each.
std::vector<Reduced> BlocksOfPlace(const std::vector<LinearisedTrack>& tracks,
                                   std::size_t num_posed) {
  std::vector<const LinearisedTrack*> order;
  for (const LinearisedTrack& track : tracks) order.push_back(&track);
  std::stable_sort(
      order.begin(), order.end(), [](const auto* a, const auto* b) {
        return a->mean_px.x() < b->mean_px.x();
      });
  std::vector<Reduced> blocks;
  for (std::size_t c = 0; c < kColumns; ++c) {
    const std::size_t first = c * order.size() / kColumns;
    const std::size_t end = (c + 1) * order.size() / kColumns;
    std::vector<const LinearisedTrack*> column(
        order.begin() + static_cast<std::ptrdiff_t>(first),
        order.begin() + static_cast<std::ptrdiff_t>(end));
    std::stable_sort(
        column.begin(), column.end(), [](const auto* a, const auto* b) {
          return a->mean_px.y() < b->mean_px.y();
        });
    for (std::size_t r = 0; r < kColumns; ++r) {
      Reduced& block = blocks.emplace_back(num_posed);
      for (std::size_t i = r * column.size() / kColumns;
           i < (r + 1) * column.size() / kColumns;
           ++i) {
        AddTrack(column[i]->sights, block);
      }
    }
  }
  return blocks;
}

}  // namespace

// Errors of a track's sights hang together, and so do those of tracks that are
// followed at the same time or seen in the same part of the picture (what moves
// by itself along with the camera pulls at the lens from there all the time): a
// covariance that takes them for independent promises ten times too much.
// Leaving out one stretch of time, or part of the picture, after the other
// shows how far the result really hangs on each; a Newton step stands for the
// adjustment of the rest.
std::optional<TrackScene::FocalEvidence> TrackScene::WeighFocal() const {
  std::vector<std::uint32_t> index(num_images());
  std::uint32_t num_posed = 0;
  for (std::uint32_t i = 0; i < num_images(); ++i) {
    if (camera_from_world[i]) index[i] = num_posed++;
  }
  std::vector<LinearisedTrack> tracks;
  for (const Point& point : points) {
    if (!point.p_world) continue;
    LinearisedTrack track;
    for (const Sight& sight : point.sights) {
      if (!sight.fits || !camera_from_world[sight.image]) continue;
      auto one = Linearise(lens,
                           *camera_from_world[sight.image],
                           *point.p_world,
                           sight.pixel_px);
      if (!one) continue;
      one->pose = index[sight.image];
      track.sights.push_back(*one);
      track.mean_px += sight.pixel_px;
    }
    if (track.sights.size() < 2) continue;
    track.middle = track.sights[track.sights.size() / 2].pose;
    track.mean_px /= static_cast<double>(track.sights.size());
    tracks.push_back(std::move(track));
  }
  if (tracks.size() < 2 * kBlocks) return std::nullopt;
  std::stable_sort(
      tracks.begin(), tracks.end(), [](const auto& a, const auto& b) {
        return a.middle < b.middle;
      });
  Reduced all(num_posed);
  all.lens(1, 1) += 1.0 / (prior.k_sigma * prior.k_sigma);
  all.gradient[all.gradient.size() - kLens + 1] +=
      lens.k / (prior.k_sigma * prior.k_sigma);
  std::vector<Reduced> times(kBlocks, Reduced(num_posed));
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    AddTrack(tracks[i].sights, times[i * kBlocks / tracks.size()]);
  }
  for (const Reduced& block : times) all.Add(block, 1.0);
  const auto whole = StepOfLens(all);
  if (!whole) return std::nullopt;
  const auto by_time = Jackknife(all, times);
  const auto by_place = Jackknife(all, BlocksOfPlace(tracks, num_posed));
  if (!by_time || !by_place) return std::nullopt;
  // What both contain, independent errors, counts once.
  const double variance = std::max({*by_time + *by_place - whole->variance,
                                    *by_time,
                                    *by_place,
                                    whole->variance});
  const double by_principal =
      whole->by_principal.norm() * kPrincipalSigma * width_px_;
  return FocalEvidence{whole->log_focal,
                       std::hypot(std::sqrt(variance), by_principal)};
}

std::optional<double> TrackScene::SettleLens(const Adjustment& adjustment) {
  Adjustment rest = adjustment;
  rest.images.clear();
  rest.focal = true;
  rest.distortion = true;
  if (!Adjust(rest)) return std::nullopt;
  // The valley in which focal length, depths and shifts make up for each other
  // is long and nearly level: an adjustment stops anywhere along it. Newton's
  // step of the focal length alone goes on from there.
  rest.focal = false;
  auto evidence = WeighFocal();
  for (int i = 0; i < kMaxSteps && evidence; ++i) {
    if (std::abs(evidence->log_step) < kSmallStep * evidence->log_sigma) break;
    lens.focal_px *=
        std::exp(std::clamp(evidence->log_step, -kLongestStep, kLongestStep));
    if (!Adjust(rest)) return std::nullopt;
    evidence = WeighFocal();
  }
  const double prior_variance = prior.focal_log_sigma * prior.focal_log_sigma;
  const double variance = evidence ? evidence->log_sigma * evidence->log_sigma +
                                         evidence->log_step * evidence->log_step
                                   : 1e3 * prior_variance;
  // Bayes, in the logarithm.
  const double prior_share = variance / (variance + prior_variance);
  if (prior_share > kPriorTells) {
    lens.focal_px *= std::pow(prior.focal_px / lens.focal_px, prior_share);
    if (!Adjust(rest)) return std::nullopt;
  }
  return std::hypot(std::sqrt(prior_share * prior_variance), kModelSigma) *
         lens.focal_px;
}

}  // namespace groundlock::build::internal
