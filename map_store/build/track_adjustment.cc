// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment of a TrackScene.
#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "map_store/build/internal/track_scene.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::build::internal {
namespace {

// What is behind a camera is as wrong as this, whatever is done about it.
constexpr double kBehind = 30.0;
// Of a turn that tracks without depth say, and of what the lens, which may
// still be wrong, has to do with it.
constexpr double kTurnSigma_rad = 2e-4;
constexpr double kLensShare = 0.02;

// Residual of one sight, in sigmas.
struct SightCost {
  Eigen::Vector2d pixel_px;
  template <typename T>
  bool operator()(const T* pose,
                  const T* p_world,
                  const T* lens,
                  T* residual) const {
    T p[3];
    ceres::AngleAxisRotatePoint(pose, p_world, p);
    for (int i = 0; i < 3; ++i) p[i] += pose[3 + i];
    if (p[2] < T(1e-9)) {
      residual[0] = T(kBehind);
      residual[1] = T(kBehind);
      return true;
    }
    const T x = p[0] / p[2];
    const T y = p[1] / p[2];
    const T scale = lens[0] * (T(1.0) + lens[1] * (x * x + y * y));
    residual[0] = (scale * x - T(pixel_px.x())) / T(kTrackSigma_px);
    residual[1] = (scale * y - T(pixel_px.y())) / T(kTrackSigma_px);
    return true;
  }
};

// Two poses, the second of which is the first one turned.
struct TurnCost {
  std::array<double, 4> second_from_first_wxyz;
  double turn_sigma_rad = 1.0;
  double way_sigma = 1.0;
  template <typename T>
  bool operator()(const T* first, const T* second, T* residual) const {
    T first_q[4];
    T second_q[4];
    ceres::AngleAxisToQuaternion(first, first_q);
    ceres::AngleAxisToQuaternion(second, second_q);
    const T turn[4] = {T(second_from_first_wxyz[0]),
                       T(second_from_first_wxyz[1]),
                       T(second_from_first_wxyz[2]),
                       T(second_from_first_wxyz[3])};
    T turned[4];
    ceres::QuaternionProduct(turn, first_q, turned);
    const T back[4] = {turned[0], -turned[1], -turned[2], -turned[3]};
    T off[4];
    ceres::QuaternionProduct(second_q, back, off);
    T angle_axis[3];
    ceres::QuaternionToAngleAxis(off, angle_axis);
    // The first camera's centre, seen from the second.
    T center[3];
    T minus_center[3];
    const T first_back[4] = {first_q[0], -first_q[1], -first_q[2], -first_q[3]};
    ceres::UnitQuaternionRotatePoint(first_back, first + 3, minus_center);
    ceres::UnitQuaternionRotatePoint(second_q, minus_center, center);
    for (int i = 0; i < 3; ++i) {
      residual[i] = angle_axis[i] / T(turn_sigma_rad);
      residual[3 + i] = (second[3 + i] - center[i]) / T(way_sigma);
    }
    return true;
  }
};

struct LensCost {
  LensPrior prior;
  template <typename T>
  bool operator()(const T* lens, T* residual) const {
    using std::log;
    if (lens[0] < T(1.0)) return false;
    residual[0] = log(lens[0] / T(prior.focal_px)) / T(prior.focal_log_sigma);
    residual[1] = lens[1] / T(prior.k_sigma);
    return true;
  }
};

using PoseParameters = std::array<double, 6>;  // angle axis, translation

PoseParameters ParametersOf(const geometry::Rigid3& pose) {
  PoseParameters parameters{};
  const Eigen::Quaterniond& q = pose.rotation;
  const double wxyz[4] = {q.w(), q.x(), q.y(), q.z()};
  ceres::QuaternionToAngleAxis(wxyz, parameters.data());
  for (int i = 0; i < 3; ++i) {
    parameters[static_cast<std::size_t>(3 + i)] = pose.translation[i];
  }
  return parameters;
}

geometry::Rigid3 PoseOf(const PoseParameters& parameters) {
  double wxyz[4];
  ceres::AngleAxisToQuaternion(parameters.data(), wxyz);
  return {Eigen::Quaterniond(wxyz[0], wxyz[1], wxyz[2], wxyz[3]).normalized(),
          Eigen::Vector3d(parameters[3], parameters[4], parameters[5])};
}

class Cancel final : public ceres::IterationCallback {
 public:
  explicit Cancel(const std::function<bool()>& is_cancelled)
      : is_cancelled_(is_cancelled) {}
  ceres::CallbackReturnType operator()(
      const ceres::IterationSummary& /*summary*/) override {
    return is_cancelled_ && is_cancelled_() ? ceres::SOLVER_ABORT
                                            : ceres::SOLVER_CONTINUE;
  }

 private:
  const std::function<bool()>& is_cancelled_;
};

// The problem of a scene, and the parameters it works on.
struct Problem {
  std::vector<PoseParameters> poses;
  std::array<double, 2> lens{};
  ceres::Problem ceres;
};

void FillProblem(TrackScene& scene,
                 const TrackScene::Adjustment& adjustment,
                 Problem& problem) {
  std::vector<bool> is_free(scene.num_images(), adjustment.images.empty());
  for (const std::uint32_t image : adjustment.images) is_free[image] = true;
  problem.poses.resize(scene.num_images());
  for (std::uint32_t i = 0; i < scene.num_images(); ++i) {
    if (scene.camera_from_world[i]) {
      problem.poses[i] = ParametersOf(*scene.camera_from_world[i]);
    }
  }
  problem.lens = {scene.lens.focal_px, scene.lens.k};
  for (TrackScene::Point& point : scene.points) {
    if (!point.p_world) continue;
    bool is_seen = false;
    for (const TrackScene::Sight& sight : point.sights) {
      is_seen |= sight.fits && scene.camera_from_world[sight.image] &&
                 is_free[sight.image];
    }
    if (!is_seen) continue;
    for (const TrackScene::Sight& sight : point.sights) {
      if (!sight.fits || !scene.camera_from_world[sight.image]) continue;
      problem.ceres.AddResidualBlock(
          new ceres::AutoDiffCostFunction<SightCost, 2, 6, 3, 2>(
              new SightCost{sight.pixel_px}),
          new ceres::CauchyLoss(kTrackRobust_px / kTrackSigma_px),
          problem.poses[sight.image].data(),
          point.p_world->data(),
          problem.lens.data());
      if (!is_free[sight.image]) {
        problem.ceres.SetParameterBlockConstant(
            problem.poses[sight.image].data());
      }
    }
  }
  if (problem.ceres.NumResidualBlocks() == 0) return;
  for (const TrackScene::Turn& turn : scene.Turns(is_free)) {
    const Eigen::Quaterniond& q = turn.next_from_first;
    problem.ceres.AddResidualBlock(
        new ceres::AutoDiffCostFunction<TurnCost, 6, 6, 6>(
            new TurnCost{{q.w(), q.x(), q.y(), q.z()},
                         std::hypot(kTurnSigma_rad,
                                    kLensShare * Eigen::AngleAxisd(q).angle()),
                         turn.way_sigma}),
        nullptr,
        problem.poses[turn.first].data(),
        problem.poses[turn.first + 1].data());
    for (const std::uint32_t image : {turn.first, turn.first + 1}) {
      if (!is_free[image]) {
        problem.ceres.SetParameterBlockConstant(problem.poses[image].data());
      }
    }
  }
  if (scene.lens_is_known || (!adjustment.focal && !adjustment.distortion)) {
    problem.ceres.SetParameterBlockConstant(problem.lens.data());
    return;
  }
  problem.ceres.AddResidualBlock(
      new ceres::AutoDiffCostFunction<LensCost, 2, 2>(
          new LensCost{scene.prior}),
      nullptr,
      problem.lens.data());
  if (!adjustment.distortion || !adjustment.focal) {
    problem.ceres.SetManifold(
        problem.lens.data(),
        new ceres::SubsetManifold(2, {adjustment.focal ? 1 : 0}));
  }
}

}  // namespace

bool TrackScene::Adjust(const Adjustment& adjustment) {
  // Ceres tells of each step that it takes back, on its own; whoever builds a
  // map cannot do anything about them.
  [[maybe_unused]] static const bool is_quiet = [] {
    FLAGS_minloglevel = google::GLOG_ERROR;
    return true;
  }();
  Problem problem;
  FillProblem(*this, adjustment, problem);
  if (problem.ceres.NumResidualBlocks() == 0) return false;
  Cancel cancel(adjustment.is_cancelled);
  ceres::Solver::Options options;
  options.linear_solver_type =
      problem.poses.size() <= 100 ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  options.max_num_iterations = adjustment.max_iterations;
  options.function_tolerance = 1e-5;
  options.num_threads = std::max(1, adjustment.threads);
  options.logging_type = ceres::SILENT;
  options.callbacks.push_back(&cancel);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem.ceres, &summary);
  if (summary.termination_type == ceres::USER_FAILURE ||
      !summary.IsSolutionUsable()) {
    return false;
  }
  for (std::uint32_t i = 0; i < num_images(); ++i) {
    if (camera_from_world[i]) camera_from_world[i] = PoseOf(problem.poses[i]);
  }
  lens = {problem.lens[0], problem.lens[1]};
  return true;
}

}  // namespace groundlock::build::internal
