// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/track_turn.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "map_store/base/order_statistics.h"

namespace groundlock::build::internal {
namespace {

constexpr std::size_t kMinTracks = 30;
constexpr int kReweightings = 12;
constexpr int kLensSteps = 12;
// Focal lengths that are tried for an unknown lens, as factors of the prior's.
constexpr std::array<double, 7> kFactors = {
    0.5, 0.65, 0.85, 1.1, 1.4, 2.0, 3.0};
// Half of the tracks farther off than this: no lens makes that a turn, and none
// is adjusted.
constexpr double kHopeless_px = 20.0;
// A pose under which fewer tracks fit than this share of those that fit a turn.
constexpr double kContradictedShare = 0.7;
// Errors of tracks hang together: so many count as one (as in track_motion.cc).
constexpr double kTracksPerFact = 20.0;
// Of a turn that is to tell the lens: beyond the first, a way that is too short
// to be seen as one may bend it.
constexpr double kMaxLensError_px = 1.0;
constexpr double kMaxLensSigma = 0.1;
// What a lens model lacks, and a short way beside a turn, is in its sigma: the
// turns of eight flights are off by 0 to 9 %.
constexpr double kMinLensSigma = 0.03;
// Under a lens that is not the camera's neighbours in a turn are off by this.
constexpr double kMaybeTurn_px = 3.0;

double Error_px(const Eigen::Quaterniond& second_from_first,
                const RadialLens& lens,
                const Eigen::Vector2d& first_px,
                const Eigen::Vector2d& second_px) {
  const Eigen::Vector3d ray =
      second_from_first * lens.NormalizedFromImage(first_px).homogeneous();
  if (!(ray.z() > 0.05 * ray.norm())) return 1e4;
  return (lens.ImageFromCamera(ray) - second_px).norm();
}

class TurnProblem {
 public:
  TurnProblem(std::span<const Eigen::Vector2d> first_px,
              std::span<const Eigen::Vector2d> second_px,
              const LensPrior* prior)
      : first_px_(first_px), second_px_(second_px), prior_(prior) {}

  // The turn under a lens as it is: Kabsch's, reweighted by 1 / error.
  TurnFit Turn(const RadialLens& lens) const {
    const std::size_t count = first_px_.size();
    std::vector<Eigen::Vector3d> from(count);
    std::vector<Eigen::Vector3d> to(count);
    for (std::size_t i = 0; i < count; ++i) {
      from[i] =
          lens.NormalizedFromImage(first_px_[i]).homogeneous().normalized();
      to[i] =
          lens.NormalizedFromImage(second_px_[i]).homogeneous().normalized();
    }
    std::vector<double> weights(count, 1.0);
    TurnFit fit{Eigen::Quaterniond::Identity(), lens, count};
    for (int round = 0; round < kReweightings; ++round) {
      Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
      for (std::size_t i = 0; i < count; ++i) {
        moment += weights[i] * to[i] * from[i].transpose();
      }
      const Eigen::JacobiSVD<Eigen::Matrix3d> svd(
          moment, Eigen::ComputeFullU | Eigen::ComputeFullV);
      Eigen::Matrix3d sign = Eigen::Matrix3d::Identity();
      sign(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant();
      fit.second_from_first =
          Eigen::Quaterniond(svd.matrixU() * sign * svd.matrixV().transpose());
      for (std::size_t i = 0; i < count; ++i) {
        const double error_px =
            lens.focal_px * (fit.second_from_first * from[i] - to[i]).norm();
        weights[i] = 1.0 / std::max(kTrackSigma_px, error_px);
      }
    }
    Judge(fit);
    return fit;
  }

  // Gauss-Newton of turn, log f and k together, each track's error against
  // Cauchy's loss; a step that does not help the median ends it.
  TurnFit Adjusted(TurnFit fit) const {
    for (int step = 0; step < kLensSteps; ++step) {
      const TurnFit next = Stepped(fit);
      if (!(next.median_px < 0.999 * fit.median_px)) break;
      fit = next;
    }
    return fit;
  }

 private:
  static TurnFit Moved(const TurnFit& fit,
                       const Eigen::Matrix<double, 5, 1>& by) {
    TurnFit moved = fit;
    const Eigen::Vector3d turn = by.head<3>();
    if (turn.norm() > 0.0) {
      moved.second_from_first = Eigen::Quaterniond(Eigen::AngleAxisd(
                                    turn.norm(), turn.normalized())) *
                                fit.second_from_first;
    }
    moved.lens.focal_px *= std::exp(std::clamp(by[3], -0.5, 0.5));
    moved.lens.k += by[4];
    return moved;
  }

  Eigen::Vector2d Residual_px(const TurnFit& fit, std::size_t i) const {
    const Eigen::Vector3d ray =
        fit.second_from_first *
        fit.lens.NormalizedFromImage(first_px_[i]).homogeneous();
    return fit.lens.ImageFromCamera(ray) - second_px_[i];
  }

  TurnFit Stepped(const TurnFit& fit) const {
    constexpr double kDelta = 1e-5;
    Eigen::Matrix<double, 5, 5> H = Eigen::Matrix<double, 5, 5>::Zero();
    Eigen::Matrix<double, 5, 1> g = Eigen::Matrix<double, 5, 1>::Zero();
    std::array<TurnFit, 5> moved;
    for (int c = 0; c < 5; ++c) {
      moved[static_cast<std::size_t>(c)] =
          Moved(fit, kDelta * Eigen::Matrix<double, 5, 1>::Unit(c));
    }
    const double scale_px = std::max(1.0, 1.5 * fit.median_px);
    for (std::size_t i = 0; i < first_px_.size(); ++i) {
      const Eigen::Vector2d error = Residual_px(fit, i);
      Eigen::Matrix<double, 2, 5> J;
      for (int c = 0; c < 5; ++c) {
        J.col(c) =
            (Residual_px(moved[static_cast<std::size_t>(c)], i) - error) /
            kDelta;
      }
      if (!J.allFinite() || !error.allFinite()) continue;
      const double weight =
          1.0 / (1.0 + error.squaredNorm() / (scale_px * scale_px));
      H += weight * J.transpose() * J;
      g += weight * J.transpose() * error;
    }
    const double f_weight =
        std::pow(kTrackSigma_px / prior_->focal_log_sigma, 2);
    const double k_weight = std::pow(kTrackSigma_px / prior_->k_sigma, 2);
    H(3, 3) += f_weight;
    g[3] += f_weight * std::log(fit.lens.focal_px / prior_->focal_px);
    H(4, 4) += k_weight;
    g[4] += k_weight * fit.lens.k;
    const Eigen::Matrix<double, 5, 1> step = -H.ldlt().solve(g);
    if (!step.allFinite()) return fit;
    TurnFit next = Moved(fit, step);
    Judge(next);
    // Errors of tracks hang together, and are as large as half of them say.
    const double sigma_px = std::max(kTrackSigma_px, next.median_px);
    next.focal_log_sigma =
        sigma_px *
        std::sqrt(kTracksPerFact *
                  H.ldlt().solve(Eigen::MatrixXd::Identity(5, 5))(3, 3));
    return next;
  }

  void Judge(TurnFit& fit) const {
    std::vector<double> errors_px;
    std::vector<double> shifts_px;
    errors_px.reserve(first_px_.size());
    shifts_px.reserve(first_px_.size());
    std::size_t within = 0;
    for (std::size_t i = 0; i < first_px_.size(); ++i) {
      errors_px.push_back(Error_px(
          fit.second_from_first, fit.lens, first_px_[i], second_px_[i]));
      shifts_px.push_back((second_px_[i] - first_px_[i]).norm());
      within += errors_px.back() <= TurnFit::kTurnGate_px ? 1 : 0;
    }
    fit.share = static_cast<double>(within) /
                static_cast<double>(std::max<std::size_t>(1, errors_px.size()));
    fit.median_px = base::Median(std::move(errors_px));
    fit.median_shift_px = base::Median(std::move(shifts_px));
  }

  const std::span<const Eigen::Vector2d> first_px_;
  const std::span<const Eigen::Vector2d> second_px_;
  const LensPrior* const prior_;  // null: the lens is known
};

// The share of the tracks of two posed images that lie, in the second one, near
// where their ray of the first is seen, in front of both.
double ShareOnRays(const TrackScene& scene,
                   std::uint32_t first,
                   std::uint32_t second) {
  const geometry::Rigid3 second_from_first =
      *scene.camera_from_world[second] *
      scene.camera_from_world[first]->Inverse();
  std::size_t count = 0;
  std::size_t near = 0;
  scene.CommonSights(first, second, [&](const auto& a, const auto& b) {
    ++count;
    // Points of the ray, up to scale: far + w * t, w from 0 (infinitely far).
    const Eigen::Vector3d far =
        second_from_first.rotation *
        scene.lens.NormalizedFromImage(a.pixel_px).homogeneous();
    const Eigen::Vector3d& t = second_from_first.translation;
    const Eigen::Vector3d seen =
        scene.lens.NormalizedFromImage(b.pixel_px).homogeneous();
    const Eigen::Vector3d across = seen.cross(t);
    double w = across.squaredNorm() > 0.0
                   ? -seen.cross(far).dot(across) / across.squaredNorm()
                   : 0.0;
    w = std::max(0.0, w);
    const Eigen::Vector3d nearest = far + w * t;
    if (!(nearest.z() > 0.05 * nearest.norm())) return;
    near += (scene.lens.ImageFromCamera(nearest) - b.pixel_px).norm() <=
                    TurnFit::kTurnGate_px
                ? 1
                : 0;
  });
  return static_cast<double>(near) /
         static_cast<double>(std::max<std::size_t>(1, count));
}

std::vector<std::uint32_t> PosedNeighbours(const TrackScene& scene,
                                           std::uint32_t image) {
  std::vector<std::uint32_t> neighbours;
  if (image > 0 && scene.camera_from_world[image - 1]) {
    neighbours.push_back(image - 1);
  }
  if (image + 1 < scene.num_images() && scene.camera_from_world[image + 1]) {
    neighbours.push_back(image + 1);
  }
  return neighbours;
}

geometry::Rigid3 Turned(const geometry::Rigid3& camera_from_world,
                        const TurnFit& turn) {
  return {(turn.second_from_first * camera_from_world.rotation).normalized(),
          turn.second_from_first * camera_from_world.translation};
}

}  // namespace

std::optional<TurnFit> FitTurn(std::span<const Eigen::Vector2d> first_px,
                               std::span<const Eigen::Vector2d> second_px,
                               const RadialLens& lens,
                               const LensPrior* prior_of_unknown) {
  if (first_px.size() < kMinTracks) return std::nullopt;
  const TurnProblem problem(first_px, second_px, prior_of_unknown);
  TurnFit best = problem.Turn(lens);
  if (prior_of_unknown == nullptr) return best;
  for (const double factor : kFactors) {
    TurnFit fit = problem.Turn({factor * prior_of_unknown->focal_px, 0.0});
    if (fit.median_px < best.median_px) best = fit;
  }
  return best.median_px < kHopeless_px ? problem.Adjusted(best) : best;
}

std::optional<TurnFit> FitTurn(const TrackScene& scene,
                               std::uint32_t first,
                               std::uint32_t second,
                               bool lens_is_known) {
  std::vector<Eigen::Vector2d> first_px;
  std::vector<Eigen::Vector2d> second_px;
  scene.CommonSights(first, second, [&](const auto& a, const auto& b) {
    first_px.push_back(a.pixel_px);
    second_px.push_back(b.pixel_px);
  });
  return FitTurn(
      first_px, second_px, scene.lens, lens_is_known ? nullptr : &scene.prior);
}

std::optional<TurnFit> LensOfTurns(const TrackScene& scene) {
  std::optional<TurnFit> best;
  const auto consider = [&](std::uint32_t first, std::uint32_t second) {
    const auto fit = FitTurn(scene, first, second, /*lens_is_known=*/false);
    if (!fit || fit->median_px > kMaxLensError_px ||
        !(fit->focal_log_sigma > 0.0) || fit->focal_log_sigma > kMaxLensSigma) {
      return;
    }
    if (!best || fit->focal_log_sigma < best->focal_log_sigma) best = fit;
  };
  std::uint32_t from = 0;
  for (std::uint32_t i = 1; i <= scene.num_images(); ++i) {
    const auto step = i < scene.num_images()
                          ? FitTurn(scene, i - 1, i, /*lens_is_known=*/true)
                          : std::nullopt;
    if (step && step->median_px <= kMaybeTurn_px) continue;
    // It turned from `from` to the image before this one.
    for (std::uint32_t gap = 1; gap < i - from; gap *= 2) {
      for (std::uint32_t first = from; first + gap < i; first += gap) {
        consider(first, first + gap);
      }
    }
    from = i;
  }
  if (best) {
    best->focal_log_sigma = std::hypot(best->focal_log_sigma, kMinLensSigma);
  }
  return best;
}

std::vector<std::uint32_t> FindTurns(const TrackScene& scene) {
  const auto is_turn = [&scene](std::uint32_t first, std::uint32_t second) {
    const auto turn = FitTurn(scene, first, second, /*lens_is_known=*/true);
    if (!turn) return std::optional<bool>();
    return std::optional<bool>(turn->ExplainsTheTracks());
  };
  std::vector<std::uint32_t> turn_of(scene.num_images());
  std::uint32_t first = 0;
  for (std::uint32_t i = 1; i < scene.num_images(); ++i) {
    turn_of[i] = turn_of[i - 1];
    bool is_same = is_turn(i - 1, i).value_or(false);
    // A slow way is none from image to image; it is one from the first image
    // that still shows the same.
    for (std::uint32_t j = first; is_same && j + 1 < i; ++j) {
      const auto is_turned = is_turn(j, i);
      if (!is_turned) continue;
      is_same = *is_turned;
      break;
    }
    if (is_same) continue;
    ++turn_of[i];
    first = i;
  }
  return turn_of;
}

bool PlaceByTurn(std::uint32_t image, TrackScene& scene) {
  for (const std::uint32_t neighbour : PosedNeighbours(scene, image)) {
    if (!scene.IsSameTurn(neighbour, image)) continue;
    const auto turn = FitTurn(scene, neighbour, image, /*lens_is_known=*/true);
    if (!turn) continue;
    scene.SetPose(image, Turned(*scene.camera_from_world[neighbour], *turn));
    return true;
  }
  return false;
}

bool PlaceImage(std::uint32_t image, TrackScene& scene) {
  if (PlaceByTurn(image, scene)) return true;
  if (!scene.Resect(image)) return false;
  for (const std::uint32_t neighbour : PosedNeighbours(scene, image)) {
    const auto turn = FitTurn(scene, neighbour, image, /*lens_is_known=*/true);
    if (!turn || ShareOnRays(scene, neighbour, image) >=
                     kContradictedShare * turn->share) {
      continue;
    }
    scene.camera_from_world[image].reset();
    return false;
  }
  return true;
}

}  // namespace groundlock::build::internal
