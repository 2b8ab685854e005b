// SPDX-License-Identifier: Apache-2.0
#include "server/ground/body_motion.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "server/ground/internal/view_pose.h"

namespace groundlock::ground {
namespace {

using geometry::Rigid3;
using internal::ErrorsOfOutline;
using internal::GroundCovariance;
using internal::kGround;
using internal::kNumPose;
using internal::Moved;
using internal::OutlineErrors;
using internal::Pose;
using internal::PoseJacobian;
using internal::PriorWeights;
using internal::ProjectionError_px;
using internal::RobustCost;
using internal::RobustWeight;

// Lucas-Kanade's error from frame to frame adds up to about so much in a view.
constexpr double kPixelSigma_px = 0.5;
// A point whose error is larger goes otherwise than the body.
constexpr double kMaxError_px = 1.5;
constexpr std::size_t kMinObservations = 3;
constexpr std::size_t kMinPoints = 10;
// How far from the given body's surface a point may be, of its side.
constexpr double kSurfaceSigma = 0.5;
constexpr int kIterations = 15;
constexpr int kRestIterations = 6;
// What goes on wheels goes along its heading where its rear axle is, whose
// place along the body is known to this share of its length about the middle.
constexpr double kAxleSigma = 0.3;
// It goes sideways by so much of its way (tyres slip by about a degree), and of
// its side.
constexpr double kSlip = 0.02;
constexpr double kSway = 0.003;
// However little a body goes from view to view, the ground's errors are others
// as after this share of kGroundSides (it sways on its springs).
constexpr double kLeastWay = 0.01;

struct Point {
  const BodyTrack* track = nullptr;
  std::size_t index = 0;  // of the track
  Eigen::Vector3d p_body = Eigen::Vector3d::Zero();
  Eigen::Vector3d start_body = Eigen::Vector3d::Zero();
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
};

class MotionProblem {
 public:
  MotionProblem(std::span<const BodyView> views,
                std::span<const BodyTrack> tracks,
                const BodyForm& form)
      : views_(views), form_(form), poses_(views.size(), Pose::Zero()) {
    side_m_ = std::cbrt(form.size_m.prod());
    length_m_ = form.size_m.x();
    for (const BodyView& view : views) {
      if (!view.ground_covariance.isZero(0.0)) ground_known_ = false;
    }
    geometry::Box3 body;
    body.size_m = form.size_m;
    body.world_from_object.translation.z() = 0.5 * form.size_m.z();
    for (std::size_t i = 0; i < tracks.size(); ++i) {
      const BodyTrack& track = tracks[i];
      if (track.observations.size() < kMinObservations) continue;
      // In the middle of the way the view errs least for all of it.
      const BodyTrack::Observation& middle =
          track.observations[track.observations.size() / 2];
      const BodyView& view = views_[middle.view];
      const GroundView in_body{
          &view.camera,
          view.world_from_body.Inverse() * view.world_from_camera,
          {}};
      Point point;
      point.track = &track;
      point.index = i;
      // Zero, the middle, for a ray that misses the body.
      const Eigen::Vector3d p_box =
          PointOnRay(in_body, body, middle.pixel_px, 1.0);
      point.p_body = body.world_from_object * p_box;
      if (p_box.isZero()) {
        const auto ray = view.camera.RayFromImage(middle.pixel_px);
        if (!ray) continue;
        const Eigen::Vector3d direction =
            in_body.world_from_camera.rotation * *ray;
        const Eigen::Vector3d& eye = in_body.world_from_camera.translation;
        point.p_body = eye + direction.dot(point.p_body - eye) * direction;
      }
      point.start_body = point.p_body;
      points_.push_back(point);
    }
  }

  std::vector<Point>& points() { return points_; }
  Rigid3 WorldFromBody(std::size_t view) const {
    return Moved(views_[view].world_from_body, poses_[view]);
  }

  // Gauss-Newton with Levenberg's damping on the reduced system of the poses.
  void Minimize() {
    double lambda = 1e-3;
    double cost = Cost();
    for (int i = 0; i < kIterations && lambda < 1e4; ++i) {
      const std::vector<Pose> poses = poses_;
      const double axle_m = axle_m_;
      const std::vector<Point> points = points_;
      if (!Step(lambda)) return;
      const double next = Cost();
      if (!(next < cost)) {
        poses_ = poses;
        axle_m_ = axle_m;
        points_ = points;
        lambda *= 10.0;
        continue;
      }
      const bool done = cost - next < 1e-4 * cost;
      cost = next;
      lambda = std::max(0.1 * lambda, 1e-7);
      if (done) return;
    }
  }

  // Of a point's pixels; infinite where it does not project.
  double Rms_px(const Point& point) const {
    double squared_px2 = 0.0;
    for (const auto& observation : point.track->observations) {
      const auto error = Error_px(point, observation);
      if (!error) return std::numeric_limits<double>::infinity();
      squared_px2 += error->squaredNorm();
    }
    return std::sqrt(squared_px2 /
                     static_cast<double>(point.track->observations.size()));
  }

  void TakeOutOtherMotions() {
    std::erase_if(points_, [this](const Point& point) {
      const double rms_px = Rms_px(point);
      return !(rms_px < kMaxError_px) ||
             (GoesWhileSeen(point) && RestRms_px(point) < rms_px);
    });
  }

  // Does the body go, farther than its place is known, while a point is seen,
  // so that one can tell the point from what rests? On a body that turns, some
  // depth explains nearly what a point that rests behind it does in a few
  // views; while the body rests, both are the same.
  bool GoesWhileSeen(const Point& point) const {
    const std::size_t first = point.track->observations.front().view;
    const std::size_t last = point.track->observations.back().view;
    const Eigen::Vector3d way_m =
        WorldFromBody(last).translation - WorldFromBody(first).translation;
    return way_m.norm() > views_[last].place_sigma_m;
  }

  // Of a point's pixels, if it rests, wherever that may be; infinite where no
  // place is found.
  double RestRms_px(const Point& point) const {
    const auto& seen = point.track->observations;
    Eigen::Vector3d p_world =
        WorldFromBody(seen[seen.size() / 2].view) * point.p_body;
    double squared_px2 = std::numeric_limits<double>::infinity();
    for (int i = 0; i < kRestIterations; ++i) {
      Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
      Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
      squared_px2 = 0.0;
      for (const auto& observation : seen) {
        const BodyView& view = views_[observation.view];
        const Rigid3 camera_from_world = view.world_from_camera.Inverse();
        Eigen::Matrix<double, 2, 3> J;
        const auto pixel =
            view.camera.ImageFromCamera(camera_from_world * p_world, &J);
        if (!pixel) return std::numeric_limits<double>::infinity();
        J = J * camera_from_world.rotation.toRotationMatrix();
        const Eigen::Vector2d error_px = *pixel - observation.pixel_px;
        normal += J.transpose() * J;
        gradient += J.transpose() * error_px;
        squared_px2 += error_px.squaredNorm();
      }
      normal.diagonal() *= 1.0 + 1e-6;
      p_world -= normal.ldlt().solve(gradient);
      if (!p_world.allFinite()) return std::numeric_limits<double>::infinity();
    }
    return std::sqrt(squared_px2 / static_cast<double>(seen.size()));
  }

  std::size_t PointsOfView(std::size_t view) const {
    return static_cast<std::size_t>(
        std::count_if(points_.begin(), points_.end(), [view](const Point& p) {
          const auto& seen = p.track->observations;
          return std::any_of(seen.begin(), seen.end(), [view](const auto& o) {
            return o.view == view;
          });
        }));
  }

  // With what is known of the poses, less the others' uncertainty.
  BodyPoint Result(const Point& point) const {
    return {point.p_body, point.information.inverse()};
  }

 private:
  std::optional<Eigen::Vector2d> Error_px(
      const Point& point,
      const BodyTrack::Observation& seen,
      PoseJacobian* by_pose = nullptr,
      Eigen::Matrix<double, 2, 3>* by_point = nullptr) const {
    return ProjectionError_px(views_[seen.view],
                              poses_[seen.view],
                              point.p_body,
                              seen.pixel_px,
                              by_pose,
                              by_point);
  }

  // How far sideways it went from a view to the next one, in standard
  // deviations.
  struct Slip {
    double sigmas = 0.0;
    Pose by_before = Pose::Zero();
    Pose by_after = Pose::Zero();
    double by_axle = 0.0;
  };
  Slip SlipFrom(std::size_t before) const {
    struct Axle {
      Eigen::Vector3d p_world;
      Eigen::Matrix3d world_from_start;
      Eigen::Matrix3d world_from_body;
    };
    const auto axle = [this](std::size_t view) -> Axle {
      const Rigid3 world_from_body = WorldFromBody(view);
      return {world_from_body * Eigen::Vector3d(axle_m_, 0.0, 0.0),
              views_[view].world_from_body.rotation.toRotationMatrix(),
              world_from_body.rotation.toRotationMatrix()};
    };
    const Axle a = axle(before);
    const Axle b = axle(before + 1);
    const Eigen::Vector3d way_m = b.p_world - a.p_world;
    const Eigen::Vector3d sum =
        a.world_from_body.col(1) + b.world_from_body.col(1);
    const double norm = std::max(sum.norm(), 1e-6);
    const Eigen::Vector3d across = sum / norm;
    const double sigma_m = std::hypot(kSlip * way_m.norm(), kSway * side_m_);
    Slip slip;
    slip.sigmas = across.dot(way_m) / sigma_m;
    // The middle direction turns half as fast as each end's.
    const auto by_pose = [&](const Axle& end, double sign) -> Pose {
      const Eigen::Vector3d turned = -end.world_from_body.col(0);
      const Eigen::Vector3d by_turn =
          (turned - across.dot(turned) * across) / norm;
      Pose by = Pose::Zero();  // hardly by the ground's errors
      by[0] = sign * across.dot(end.world_from_start.col(0));
      by[1] = sign * across.dot(end.world_from_start.col(1));
      by[2] = sign * axle_m_ * across.dot(end.world_from_body.col(1)) +
              by_turn.dot(way_m);
      return by / sigma_m;
    };
    slip.by_before = by_pose(a, -1.0);
    slip.by_after = by_pose(b, 1.0);
    slip.by_axle =
        across.dot(b.world_from_body.col(0) - a.world_from_body.col(0)) /
        sigma_m;
    return slip;
  }

  // How much of the ground's errors is another one than in the view before, in
  // standard deviations: a Gauss-Markov process over the way (see
  // tracking::GroundErrors).
  struct GroundStep {
    Eigen::Vector3d sigmas;
    Eigen::Matrix3d by_before;
    Eigen::Vector3d by_after;  // diagonal
  };
  GroundStep GroundStepFrom(std::size_t before) const {
    const Rigid3& from = views_[before].world_from_body;
    const Rigid3& to = views_[before + 1].world_from_body;
    const double lengths =
        (to.translation - from.translation).norm() / (kGroundSides * side_m_);
    const double stays = std::exp(-std::max(kLeastWay, lengths));
    Eigen::Matrix3d M = Eigen::Matrix3d::Identity();
    M.bottomRightCorner<2, 2>() = (to.rotation.conjugate() * from.rotation)
                                      .toRotationMatrix()
                                      .topLeftCorner<2, 2>();
    const Eigen::Vector3d by_after =
        (std::sqrt(1.0 - stays * stays) *
         GroundCovariance(views_[before + 1]).diagonal().cwiseSqrt())
            .cwiseInverse();
    GroundStep step;
    step.by_after = by_after;
    step.by_before = -stays * by_after.asDiagonal() * M;
    step.sigmas = step.by_before * poses_[before].tail<3>() +
                  by_after.cwiseProduct(poses_[before + 1].tail<3>());
    return step;
  }
  // Of a view's own: not of what hangs together with the view before.
  Pose OwnWeights(std::size_t view) const {
    Pose weights = Pose::Zero();
    weights.head<3>() = PriorWeights(views_[view]);
    if (view == 0) {
      weights.tail<3>() =
          GroundCovariance(views_[view]).diagonal().cwiseInverse();
    }
    return weights;
  }

  double Cost() const {
    double cost = 0.5 * std::pow(axle_m_ / (kAxleSigma * length_m_), 2);
    for (std::size_t v = 0; v + 1 < views_.size(); ++v) {
      cost += RobustCost(std::pow(SlipFrom(v).sigmas, 2)) +
              0.5 * GroundStepFrom(v).sigmas.squaredNorm();
    }
    for (std::size_t v = 0; v < views_.size(); ++v) {
      cost += 0.5 * poses_[v].cwiseAbs2().dot(OwnWeights(v));
      const OutlineErrors outline =
          ErrorsOfOutline(views_[v], poses_[v], form_);
      for (int i = 0; i < outline.count; ++i) {
        cost += RobustCost(std::pow(outline.edges[i].sigmas, 2));
      }
    }
    for (const Point& point : points_) {
      cost += 0.5 * (point.p_body - point.start_body).squaredNorm() /
              std::pow(kSurfaceSigma * side_m_, 2);
      for (const auto& observation : point.track->observations) {
        const auto error = Error_px(point, observation);
        if (!error) return std::numeric_limits<double>::infinity();
        cost +=
            RobustCost(error->squaredNorm() / kPixelSigma_px / kPixelSigma_px);
      }
    }
    return cost;
  }

  // What a point's place has to do with a view's pose.
  struct Cross {
    Eigen::Index at;
    Eigen::Matrix<double, kNumPose, 3> W;
  };
  // Takes a point out of the equations: off the first unknowns of each pose,
  // the lower half of S, which is symmetric.
  template <int kUnknowns>
  static void Eliminate(const std::vector<Cross>& crosses,
                        const Eigen::Matrix3d& inverse,
                        Eigen::MatrixXd& S) {
    for (const Cross& one : crosses) {
      const Eigen::Matrix<double, kUnknowns, 3> WV =
          one.W.topRows<kUnknowns>() * inverse;
      for (const Cross& other : crosses) {
        if (other.at > one.at) break;
        S.block<kUnknowns, kUnknowns>(one.at, other.at).noalias() -=
            WV * other.W.topRows<kUnknowns>().transpose();
      }
    }
  }

  bool Step(double lambda) {
    // Each view's pose, then the axle.
    const auto axle_at = static_cast<Eigen::Index>(kNumPose * views_.size());
    const Eigen::Index size = axle_at + 1;
    Eigen::MatrixXd S = Eigen::MatrixXd::Zero(size, size);
    Eigen::VectorXd g = Eigen::VectorXd::Zero(size);
    for (std::size_t v = 0; v < views_.size(); ++v) {
      const auto at = static_cast<Eigen::Index>(kNumPose * v);
      const Pose weight = OwnWeights(v);
      S.diagonal().segment<kNumPose>(at) += weight;
      g.segment<kNumPose>(at) += weight.cwiseProduct(poses_[v]);
      const OutlineErrors outline =
          ErrorsOfOutline(views_[v], poses_[v], form_);
      for (int i = 0; i < outline.count; ++i) {
        const double sigmas = outline.edges[i].sigmas;
        Pose by_pose = outline.edges[i].by_pose;
        if (ground_known_) by_pose.tail<kNumPose - kGround>().setZero();
        const double counts = RobustWeight(sigmas);
        S.block<kNumPose, kNumPose>(at, at) +=
            counts * by_pose * by_pose.transpose();
        g.segment<kNumPose>(at) += counts * sigmas * by_pose;
      }
    }
    const double axle_weight = 1.0 / std::pow(kAxleSigma * length_m_, 2);
    S(axle_at, axle_at) = axle_weight;
    g[axle_at] = axle_weight * axle_m_;
    for (std::size_t v = 0; v + 1 < views_.size(); ++v) {
      const Slip slip = SlipFrom(v);
      const double weight = RobustWeight(slip.sigmas);
      Eigen::Matrix<double, 2 * kNumPose + 1, 1> J;
      J << slip.by_before, slip.by_after, slip.by_axle;
      const auto at = static_cast<Eigen::Index>(kNumPose * v);
      S.block<2 * kNumPose, 2 * kNumPose>(at, at) +=
          weight * J.head<2 * kNumPose>() * J.head<2 * kNumPose>().transpose();
      S.block<2 * kNumPose, 1>(at, axle_at) +=
          weight * J.head<2 * kNumPose>() * J[2 * kNumPose];
      S.block<1, 2 * kNumPose>(axle_at, at) +=
          weight * J[2 * kNumPose] * J.head<2 * kNumPose>().transpose();
      S(axle_at, axle_at) += weight * J[2 * kNumPose] * J[2 * kNumPose];
      g.segment<2 * kNumPose>(at) +=
          weight * slip.sigmas * J.head<2 * kNumPose>();
      g[axle_at] += weight * slip.sigmas * J[2 * kNumPose];
      const GroundStep ground = GroundStepFrom(v);
      Eigen::Matrix<double, 3, kNumPose + 3> G;
      G << ground.by_before, Eigen::Matrix3d::Zero(),
          Eigen::Matrix3d(ground.by_after.asDiagonal());
      S.block<kNumPose + 3, kNumPose + 3>(at + kGround, at + kGround) +=
          G.transpose() * G;
      g.segment<kNumPose + 3>(at + kGround) += G.transpose() * ground.sigmas;
    }
    std::vector<std::vector<Cross>> crosses(points_.size());
    std::vector<Eigen::Matrix3d> inverses(points_.size());
    std::vector<Eigen::Vector3d> gradients(points_.size());
    const double by_surface = 1.0 / std::pow(kSurfaceSigma * side_m_, 2);
    Eigen::VectorXd diagonal = S.diagonal();
    for (std::size_t i = 0; i < points_.size(); ++i) {
      Point& point = points_[i];
      Eigen::Matrix3d V = by_surface * Eigen::Matrix3d::Identity();
      Eigen::Vector3d b = by_surface * (point.p_body - point.start_body);
      for (const auto& observation : point.track->observations) {
        PoseJacobian A;
        Eigen::Matrix<double, 2, 3> B;
        const auto error = Error_px(point, observation, &A, &B);
        if (!error) return false;
        if (ground_known_) A.rightCols<kNumPose - kGround>().setZero();
        const double weight = RobustWeight(*error, kPixelSigma_px);
        const auto at = static_cast<Eigen::Index>(kNumPose * observation.view);
        S.block<kNumPose, kNumPose>(at, at) += weight * A.transpose() * A;
        diagonal.segment<kNumPose>(at) +=
            weight * (A.transpose() * A).diagonal();
        g.segment<kNumPose>(at) += weight * A.transpose() * *error;
        V += weight * B.transpose() * B;
        b += weight * B.transpose() * *error;
        crosses[i].push_back({at, weight * A.transpose() * B});
      }
      point.information = V;
      V.diagonal() *= 1.0 + lambda;
      inverses[i] = V.inverse();
      gradients[i] = b;
      for (const Cross& one : crosses[i]) {
        g.segment<kNumPose>(one.at) -= one.W * (inverses[i] * b);
      }
      if (ground_known_) {
        Eliminate<kGround>(crosses[i], inverses[i], S);
      } else {
        Eliminate<kNumPose>(crosses[i], inverses[i], S);
      }
    }
    S.diagonal() += lambda * diagonal;
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> factors(S);
    if (factors.info() != Eigen::Success) return false;
    const Eigen::VectorXd step = factors.solve(-g);
    if (!step.allFinite()) return false;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      poses_[v] +=
          step.segment<kNumPose>(static_cast<Eigen::Index>(kNumPose * v));
    }
    axle_m_ += step[axle_at];
    for (std::size_t i = 0; i < points_.size(); ++i) {
      Eigen::Vector3d b = gradients[i];
      for (const Cross& one : crosses[i]) {
        b += one.W.transpose() * step.segment<kNumPose>(one.at);
      }
      points_[i].p_body -= inverses[i] * b;
    }
    return true;
  }

  std::span<const BodyView> views_;
  const BodyForm& form_;
  double side_m_ = 1.0;
  double length_m_ = 1.0;
  double axle_m_ = 0.0;       // along the body, from its middle
  bool ground_known_ = true;  // in all views
  std::vector<Pose> poses_;
  std::vector<Point> points_;
};

}  // namespace

std::optional<BodyMotion> SolveBodyMotion(std::span<const BodyView> views,
                                          std::span<const BodyTrack> tracks,
                                          const BodyForm& form) {
  if (views.empty()) return std::nullopt;
  MotionProblem problem(views, tracks, form);
  for (int round = 0; round < 2; ++round) {
    if (problem.points().size() < kMinPoints) return std::nullopt;
    problem.Minimize();
    problem.TakeOutOtherMotions();
  }
  if (problem.points().size() < kMinPoints) return std::nullopt;
  BodyMotion motion;
  motion.seen_in_first = problem.PointsOfView(0);
  for (std::size_t v = 0; v < views.size(); ++v) {
    motion.world_from_body.push_back(problem.WorldFromBody(v));
  }
  for (const Point& point : problem.points()) {
    motion.points.push_back(problem.Result(point));
    motion.tracks.push_back(point.index);
  }
  return motion;
}

}  // namespace groundlock::ground
