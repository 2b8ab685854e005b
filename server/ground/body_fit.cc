// SPDX-License-Identifier: Apache-2.0
#include "server/ground/body_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <vector>

#include "server/ground/box_fit.h"

namespace groundlock::ground {
namespace {

using geometry::Box2;
using geometry::Box3;

constexpr double kPi = std::numbers::pi;

// Place on the ground (2, from the guess, in units of the guess's side), turn
// from the start's direction, logarithms of length, width, height over the
// side, how high over the ground the points have the body stand, in sides, and
// its BodyShape, in standard deviations from what is expected; and the
// logarithm of BodyFit::scale.
constexpr int kNumParams = 11;
using Params = Eigen::Matrix<double, kNumParams, 1>;
using Normal = Eigen::Matrix<double, kNumParams, kNumParams>;
constexpr int kRaise = 6;
constexpr int kShape = 7;
constexpr int kScale = 10;
// Four edges of the drawn box, three of the extents, and what was known before
// of the turn, the scale, the shape and the ground.
constexpr int kNumFixed = 13;
using Fixed = Eigen::Matrix<double, kNumFixed, 1>;

constexpr std::size_t kMinPoints = 10;
// A person draws a box so well, of its size (tracking's outline_scale.cc); the
// pixels are whole ones.
constexpr double kDrawnSigma = 0.02;
constexpr double kDrawnSigma_px = 1.0;
// Silhouettes share a part of their errors, so that each counts for less; what
// is off by so many sigmas counts half (Cauchy).
constexpr double kSilhouetteSigmas = 1.4;
constexpr double kRobust = 2.0;
// Bodies fill their boxes between an octagon with a roof of a third of the
// length (saloon cars) and the whole (crates, vans); plan, roof, clearance.
const Eigen::Vector3d kUsualShape(0.8, 0.6, 0.1);
const Eigen::Vector3d kUsualShapeSigma(0.15, 0.2, 0.07);
const Eigen::Vector3d kLeastShape(0.4, 0.2, 0.0);
const Eigen::Vector3d kMostShape(1.0, 1.0, 0.3);
// Ground that is known is known to so much of a body's side.
constexpr double kStands = 1e-4;
// Sides bulge, wheels stand back: points lie so far from the box's faces, of
// its side.
constexpr double kRoughness = 0.03;
// What a point may be: on the faces, as often as they were shown, evenly within
// the body, or anywhere in its neighbourhood, of so many sides cubed.
constexpr double kOnFace = 0.7;
constexpr double kInside = 0.2;
constexpr double kBodyVolume = 0.5;
constexpr double kElsewhere = 0.1;
constexpr double kNeighbourhood = 10.0;
constexpr double kLeastShown = 0.02;  // of a face that no view shows
// Points of one body err alike (its shape is no box, its texture not even):
// together they are worth so many, and that none lies on a part of a face
// counts so much.
constexpr double kWorth = 60.0;
constexpr double kEvenness = 0.15;
// What the ground's points are known by: lower than this of the height.
constexpr double kGroundShare = 0.06;
constexpr double kDrawnMargin = 0.05;
constexpr double kReach = 1.5;  // of the guess's diagonal

// Starts in all directions take a few steps each; the best go on.
constexpr std::size_t kStarts = 18;
constexpr int kFirstIterations = 4;
constexpr std::size_t kGoOn = 6;
constexpr int kIterations = 12;
constexpr double kStep = 1e-5;
constexpr double kMaxLogExtent = 3.0;
// Another way of standing must be 20 times less likely; directions nearer than
// this are the same way.
constexpr double kMinAdvantage = 3.0;
constexpr double kSameAxis_rad = 20.0 * kPi / 180.0;
constexpr double kMaxAxisSigma_rad = 5.0 * kPi / 180.0;
// Longer than wide by less, a footprint turned by 90 degrees is the same.
constexpr double kSquareRatio = 1.2;

struct LocalPoint {
  Eigen::Vector3d p_m;  // x and y as PlaneAxes, z over the ground
  Eigen::Matrix3d covariance_m2;
};

// A box's faces but the one that it stands on: its front, back, left, right and
// top.
constexpr int kNumFaces = 5;
constexpr int kTop = 4;
using FaceValues = std::array<double, kNumFaces>;

// Signed distance from a box's faces, along a direction that is given in the
// body's axes (length, width, height), and from which face.
struct FaceDistance {
  double distance_m = 0.0;
  Eigen::Vector3d normal_body = Eigen::Vector3d::UnitZ();
  int face = kTop;
  bool is_under = false;  // lower than the box's floor, where nothing is
};

//   p_body  from the middle of the box's lower face.
FaceDistance DistanceFromFaces(const Eigen::Vector3d& p_body,
                               const Eigen::Vector3d& size_m) {
  Eigen::Vector3d beyond(std::abs(p_body.x()) - 0.5 * size_m.x(),
                         std::abs(p_body.y()) - 0.5 * size_m.y(),
                         p_body.z() - size_m.z());
  Eigen::Vector3d sign(
      p_body.x() < 0.0 ? -1.0 : 1.0, p_body.y() < 0.0 ? -1.0 : 1.0, 1.0);
  int nearest = 0;
  FaceDistance result;
  result.distance_m = beyond.maxCoeff(&nearest);
  result.face = nearest == 2 ? kTop : 2 * nearest + (sign[nearest] < 0.0);
  if (p_body.z() < 0.0) {
    // Of the side face that it is nearest to, but for its height.
    result.is_under = true;
    beyond.z() = -p_body.z();
    sign.z() = -1.0;
    result.distance_m = 1.0;  // outside
  }
  const Eigen::Vector3d out = beyond.cwiseMax(0.0);
  if (result.distance_m > 0.0) {
    result.distance_m = out.norm();
    result.normal_body = out.cwiseProduct(sign) / result.distance_m;
  } else {
    result.normal_body = sign[nearest] * Eigen::Vector3d::Unit(nearest);
  }
  return result;
}

class BodyProblem {
 public:
  BodyProblem(const GroundView& drawn,
              const Box2& drawn_px,
              const Box3& guess,
              const BodyKnowledge& known,
              const BodyPoints& seen)
      : drawn_(drawn),
        drawn_px_(drawn_px),
        axes_(drawn.ground_world),
        known_(known) {
    side_m_ = (guess.BottomCenterWorld() - drawn.world_from_camera.translation)
                  .norm() *
              std::sqrt(drawn_px.Area()) / drawn.camera->mean_focal_px();
    start_m_ = axes_.FromWorld(guess.BottomCenterWorld());
    start_size_m_ = guess.size_m;
    const Eigen::Vector2d heading =
        axes_.axes_world.transpose() *
        (guess.world_from_object.rotation * Eigen::Vector3d::UnitX());
    start_rad_ = std::atan2(heading.y(), heading.x());
    Take(seen);
  }

  std::size_t num_points() const { return points_.size(); }

  Params StartTurnedBy(double angle_rad) const {
    Params x = Params::Zero();
    x[2] = angle_rad;
    x.segment<3>(3) = (start_size_m_ / side_m_).array().log().matrix();
    if (angle_rad != 0.0) {
      // Turned, it is as much longer than wide as such bodies are.
      x[3] = 0.5 * std::log(known_.size.size_m.x() / known_.size.size_m.y());
      x[4] = -x[3];
    }
    return x;
  }

  Box3 BoxOf(const Params& x) const {
    const double angle_rad = start_rad_ + x[2];
    return UprightBox(
        drawn_.ground_world,
        axes_.ToWorld(PlaceOf(x)) + RaiseOf(x) * drawn_.ground_world.normal,
        axes_.DirectionToWorld({std::cos(angle_rad), std::sin(angle_rad)}),
        SizeOf(x));
  }

  // nullopt if its direction is not known well enough.
  std::optional<BodyFit> FitOf(const Params& x, const Normal& normal) const {
    const Normal covariance = normal.ldlt().solve(Normal::Identity().eval());
    BodyFit fit;
    fit.axis_sigma_rad = std::sqrt(covariance(2, 2));
    if (!(fit.axis_sigma_rad < kMaxAxisSigma_rad)) return std::nullopt;
    fit.box = BoxOf(x);
    fit.scale = std::exp(x[kScale]);
    fit.shape = ShapeOf(x);
    Eigen::Matrix<double, 3, kNumParams> scaled =
        Eigen::Matrix<double, 3, kNumParams>::Zero();
    scaled.block<3, 3>(0, 3).setIdentity();
    if (goes_along()) scaled.col(kScale).setOnes();
    fit.log_size_covariance = scaled * covariance * scaled.transpose();
    if (const auto fixed = DrawnAndPrior(x)) {
      fit.surprise = fixed->segment<4>(4).squaredNorm();
    }
    return fit;
  }

  // Negative logarithm of the posterior, but for a constant; infinite where the
  // body does not project. `normal` and `gradient`, if given: of Gauss-Newton's
  // step at the points' present shares.
  double Evaluate(const Params& x,
                  Normal* normal = nullptr,
                  Params* gradient = nullptr) const {
    constexpr double kImpossible = std::numeric_limits<double>::infinity();
    if (!(x.segment<3>(3).cwiseAbs().maxCoeff() < kMaxLogExtent) ||
        !(x.head<2>().norm() < 4.0)) {
      return kImpossible;
    }
    const auto fixed = DrawnAndPrior(x);
    if (!fixed) return kImpossible;
    double cost = 0.5 * fixed->squaredNorm();
    const bool steps = normal != nullptr;
    if (steps) {
      Eigen::Matrix<double, kNumFixed, kNumParams> jacobian;
      for (int k = 0; k < kNumParams; ++k) {
        const auto moved = DrawnAndPrior(x + kStep * Params::Unit(k));
        if (!moved) return kImpossible;
        jacobian.col(k) = (*moved - *fixed) / kStep;
      }
      *normal = jacobian.transpose() * jacobian;
      *gradient = jacobian.transpose() * *fixed;
    }
    if (!AddSilhouettes(x, cost, normal, gradient)) return kImpossible;
    const FaceValues shown = ShownShares(start_rad_ + x[2]);
    const double log_area = kEvenness * LogShownArea(x);
    // In sides^3. What surrounds a body at rest is at rest, too, and a larger
    // box must not be likelier for taking that in; of one that moves there are
    // no points but its own, and what no view shows of it may be there.
    const double volume =
        goes_along() ? kBodyVolume : std::exp(x.segment<3>(3).sum());
    const double counts =
        std::min(1.0, kWorth / static_cast<double>(points_.size()));
    Params area_slope = Params::Zero();
    Params volume_slope = Params::Zero();
    if (!goes_along()) volume_slope.segment<3>(3).setOnes();
    if (steps) {
      for (const int k : {2, 3, 4, 5}) {
        const Params moved = x + kStep * Params::Unit(k);
        area_slope[k] = (kEvenness * LogShownArea(moved) - log_area) / kStep;
      }
    }
    const Eigen::Vector3d size_m = SizeOf(x);
    const Eigen::Matrix3d body_from_plane =
        Eigen::AngleAxisd(-start_rad_ - x[2], Eigen::Vector3d::UnitZ())
            .toRotationMatrix();
    Eigen::Vector3d place_m;
    place_m << PlaceOf(x), RaiseOf(x);
    for (const LocalPoint& point : points_) {
      const Eigen::Vector3d p_body = body_from_plane * (point.p_m - place_m);
      const FaceDistance face = DistanceFromFaces(p_body, size_m);
      const Eigen::Vector3d normal_plane =
          body_from_plane.transpose() * face.normal_body;
      const double roughness_m = kRoughness * side_m_;
      const double sigma_m =
          std::sqrt(normal_plane.dot(point.covariance_m2 * normal_plane) +
                    roughness_m * roughness_m);
      const double r = face.distance_m / sigma_m;
      const double on_face = kOnFace * shown[face.face] *
                             std::exp(-0.5 * r * r - log_area) * side_m_ /
                             (sigma_m * std::sqrt(2.0 * kPi));
      const double inside = face.distance_m < 0.0 ? kInside / volume : 0.0;
      const double any = on_face + inside + kElsewhere / kNeighbourhood;
      cost -= counts * std::log(any);
      if (!steps) continue;
      const double weight = counts * on_face / any;
      Params j = Params::Zero();  // of the distance
      j.head<2>() = -side_m_ * normal_plane.head<2>();
      j[2] =
          face.normal_body.x() * p_body.y() - face.normal_body.y() * p_body.x();
      j.segment<3>(3) = -face.normal_body.cwiseAbs().cwiseProduct(
          Eigen::Vector3d(0.5 * size_m.x(),
                          0.5 * size_m.y(),
                          face.is_under ? 0.0 : size_m.z()));
      j[kRaise] = goes_along() ? -side_m_ * normal_plane.z() : 0.0;
      j /= sigma_m;
      *normal += weight * j * j.transpose();
      *gradient +=
          weight * (r * j + area_slope) + counts * inside / any * volume_slope;
    }
    return cost;
  }

 private:
  Eigen::Vector2d PlaceOf(const Params& x) const {
    return start_m_ + side_m_ * x.head<2>();
  }
  double RaiseOf(const Params& x) const {
    return goes_along() ? side_m_ * x[kRaise] : 0.0;
  }
  bool goes_along() const { return known_.scale_sigma > 0.0; }
  Eigen::Vector3d SizeOf(const Params& x) const {
    return side_m_ * x.segment<3>(3).array().exp().matrix();
  }

  // How much of each face of a body that is turned so the views showed, in the
  // mean: the cosine to the direction from which it was seen.
  FaceValues ShownShares(double angle_rad) const {
    const Eigen::Vector2d along(std::cos(angle_rad), std::sin(angle_rad));
    const Eigen::Vector2d across(-along.y(), along.x());
    FaceValues shown{};
    for (const Eigen::Vector3d& from : seen_from_) {
      const double a = along.dot(from.head<2>());
      const double b = across.dot(from.head<2>());
      shown[a < 0.0 ? 1 : 0] += std::abs(a);
      shown[b < 0.0 ? 3 : 2] += std::abs(b);
      shown[kTop] += std::max(0.0, from.z());
    }
    for (double& share : shown) {
      share = share / static_cast<double>(seen_from_.size()) + kLeastShown;
    }
    return shown;
  }

  // Logarithm of the faces' area, each as much as it was shown, in sides^2.
  double LogShownArea(const Params& x) const {
    const FaceValues shown = ShownShares(start_rad_ + x[2]);
    const Eigen::Vector3d size = x.segment<3>(3).array().exp();
    return std::log((shown[0] + shown[1]) * size.y() * size.z() +
                    (shown[2] + shown[3]) * size.x() * size.z() +
                    shown[kTop] * size.x() * size.y());
  }

  BodyShape ShapeOf(const Params& x) const {
    const Eigen::Vector3d shape =
        (kUsualShape + kUsualShapeSigma.cwiseProduct(x.segment<3>(kShape)))
            .cwiseMax(kLeastShape)
            .cwiseMin(kMostShape);
    return {.plan = shape[0], .roof = shape[1], .clearance = shape[2]};
  }

  // In sigmas.
  std::optional<Fixed> DrawnAndPrior(const Params& x) const {
    const auto hull = ProjectBodyHull(drawn_, BoxOf(x), ShapeOf(x));
    if (!hull) return std::nullopt;
    const double scale = std::exp(x[kScale]);
    const Eigen::Vector2d sigma_px =
        (kDrawnSigma * drawn_px_.size_px()).cwiseMax(kDrawnSigma_px);
    Fixed r;
    r.segment<2>(0) = (hull->min_px - drawn_px_.min_px).cwiseQuotient(sigma_px);
    r.segment<2>(2) = (hull->max_px - drawn_px_.max_px).cwiseQuotient(sigma_px);
    r.segment<3>(4) =
        known_.size.whitening_log * (scale * SizeOf(x))
                                        .cwiseQuotient(known_.size.size_m)
                                        .array()
                                        .log()
                                        .matrix();
    r[7] = known_.heading_sigma_rad ? x[2] / *known_.heading_sigma_rad : 0.0;
    r.segment<3>(9) = x.segment<3>(kShape);
    if (goes_along()) {
      // About the camera, it is as much larger as its points have it stand over
      // the ground.
      const double stands_m = RaiseOf(x) + eye_height_m_ * (1.0 / scale - 1.0);
      r[8] = x[kScale] / known_.scale_sigma;
      r[12] = stands_m / std::hypot(known_.ground_sigma_m, kStands * side_m_);
    } else {
      // Its points have a scale.
      r[8] = x[kScale];
      r[12] = x[kRaise];
    }
    return r;
  }

  // Of each edge of each silhouette, in sigmas that grow no more once they are
  // large: the root of Cauchy's cost.
  std::optional<Eigen::VectorXd> Silhouettes(const Params& x) const {
    Eigen::VectorXd r(4 * std::ssize(outlines_));
    for (std::size_t i = 0; i < outlines_.size(); ++i) {
      const OutlineView& seen = outlines_[i];
      const auto there = ProjectBodyHull(
          {&seen.camera, seen.world_from_camera, {}}, BoxOf(x), ShapeOf(x));
      if (!there) return std::nullopt;
      const Eigen::Vector4d sigmas =
          seen.outline.OffBy_px(*there) /
          (kSilhouetteSigmas * seen.outline.sigma_px);
      for (int edge = 0; edge < 4; ++edge) {
        r[4 * static_cast<Eigen::Index>(i) + edge] = std::copysign(
            kRobust *
                std::sqrt(std::log1p(std::pow(sigmas[edge] / kRobust, 2))),
            sigmas[edge]);
      }
    }
    return r;
  }

  // Adds them to the cost and, if given, to the step's equations. False: one
  // does not project.
  bool AddSilhouettes(const Params& x,
                      double& cost,
                      Normal* normal,
                      Params* gradient) const {
    if (outlines_.empty()) return true;
    const auto r = Silhouettes(x);
    if (!r) return false;
    cost += 0.5 * r->squaredNorm();
    if (normal == nullptr) return true;
    Eigen::MatrixXd jacobian(r->size(), kNumParams);
    for (int k = 0; k < kNumParams; ++k) {
      const auto moved = Silhouettes(x + kStep * Params::Unit(k));
      if (!moved) return false;
      jacobian.col(k) = (*moved - *r) / kStep;
    }
    *normal += jacobian.transpose() * jacobian;
    *gradient += jacobian.transpose() * *r;
    return true;
  }

  void Take(const BodyPoints& seen) {
    outlines_ = seen.outlines;
    const Eigen::Vector3d up = drawn_.ground_world.normal;
    Eigen::Matrix3d plane_from_world;
    plane_from_world << axes_.axes_world.transpose(), up.transpose();
    const Box2 within_px =
        Box2::FromCenter(drawn_px_.center_px(),
                         (1.0 + 2.0 * kDrawnMargin) * drawn_px_.size_px());
    const double reach_m = kReach * start_size_m_.norm();
    const geometry::Rigid3 camera_from_world =
        drawn_.world_from_camera.Inverse();
    const Eigen::Vector3d p_middle_world = axes_.ToWorld(start_m_);
    for (const Eigen::Vector3d& eye_world : seen.eyes_world) {
      seen_from_.push_back(plane_from_world *
                           (eye_world - p_middle_world).normalized());
      eye_height_m_ += drawn_.ground_world.SignedDistance(eye_world) /
                       static_cast<double>(seen.eyes_world.size());
    }
    for (const BodyPoint& point : seen.points) {
      const auto pixel =
          drawn_.camera->ImageFromCamera(camera_from_world * point.p_world);
      if (!pixel || (pixel->array() < within_px.min_px.array()).any() ||
          (pixel->array() > within_px.max_px.array()).any()) {
        continue;
      }
      LocalPoint local;
      local.p_m << axes_.FromWorld(point.p_world),
          drawn_.ground_world.SignedDistance(point.p_world);
      local.covariance_m2 =
          plane_from_world * point.covariance_m2 * plane_from_world.transpose();
      const double height_sigma_m = std::sqrt(local.covariance_m2(2, 2));
      const bool is_ground =
          !goes_along() &&
          local.p_m.z() <
              std::max(kGroundShare * start_size_m_.z(), 2.0 * height_sigma_m);
      if (is_ground || (local.p_m.head<2>() - start_m_).norm() > reach_m) {
        continue;
      }
      points_.push_back(local);
    }
  }

  const GroundView& drawn_;
  const Box2& drawn_px_;
  geometry::PlaneAxes axes_;
  const BodyKnowledge& known_;
  double side_m_ = 1.0;
  double eye_height_m_ = 0.0;  // of the cameras, over the ground, in the mean
  double start_rad_ = 0.0;
  Eigen::Vector2d start_m_;
  Eigen::Vector3d start_size_m_;
  std::vector<LocalPoint> points_;
  std::span<const OutlineView> outlines_;
  std::vector<Eigen::Vector3d> seen_from_;  // unit, as LocalPoint::p_m
};

struct Standing {
  Params x = Params::Zero();
  double cost = std::numeric_limits<double>::infinity();
  Normal normal = Normal::Identity();
};

bool IsLikelier(const Standing& a, const Standing& b) {
  return a.cost < b.cost;
}

// Levenberg-Marquardt; the cost falls with each step that is taken.
Standing Minimize(const BodyProblem& problem,
                  const Params& start,
                  int iterations) {
  Standing best{start};
  Params gradient;
  best.cost = problem.Evaluate(best.x, &best.normal, &gradient);
  if (!std::isfinite(best.cost)) return best;
  double lambda = 1e-2;
  for (int i = 0; i < iterations && lambda < 1e6; ++i) {
    Normal damped = best.normal;
    damped.diagonal() *= 1.0 + lambda;
    const Params step = damped.ldlt().solve(-gradient);
    const double cost = problem.Evaluate(best.x + step);
    if (!(cost < best.cost)) {
      lambda *= 10.0;
      continue;
    }
    const bool done = best.cost - cost < 1e-3;
    best.x += step;
    best.cost = problem.Evaluate(best.x, &best.normal, &gradient);
    if (done) break;
    lambda = std::max(0.1 * lambda, 1e-6);
  }
  return best;
}

// The same box with its longer side along x.
Params LongerFirst(Params x) {
  if (x[4] > x[3]) {
    std::swap(x[3], x[4]);
    x[2] += 0.5 * kPi;
  }
  return x;
}

bool StandTheSameWay(const Params& a, const Params& b) {
  const bool square =
      std::min(a[3] - a[4], b[3] - b[4]) < std::log(kSquareRatio);
  const double apart = std::remainder(a[2] - b[2], square ? 0.5 * kPi : kPi);
  return std::abs(apart) < kSameAxis_rad;
}

}  // namespace

std::optional<BodyFit> FitBodyToPoints(const GroundView& drawn,
                                       const Box2& drawn_px,
                                       const Box3& guess,
                                       const BodyKnowledge& known,
                                       const BodyPoints& seen) {
  if (seen.eyes_world.empty()) return std::nullopt;
  const BodyProblem problem(drawn, drawn_px, guess, known, seen);
  if (problem.num_points() < kMinPoints) return std::nullopt;
  std::vector<Standing> ways;
  if (known.heading_sigma_rad) {
    const Standing way =
        Minimize(problem, problem.StartTurnedBy(0.0), 2 * kIterations);
    if (!std::isfinite(way.cost)) return std::nullopt;
    return problem.FitOf(way.x, way.normal);
  }
  for (std::size_t i = 0; i < kStarts; ++i) {
    const double turn_rad = static_cast<double>(i) * kPi / kStarts;
    Standing way =
        Minimize(problem, problem.StartTurnedBy(turn_rad), kFirstIterations);
    if (std::isfinite(way.cost)) ways.push_back(std::move(way));
  }
  std::sort(ways.begin(), ways.end(), IsLikelier);
  ways.resize(std::min(ways.size(), kGoOn));
  if (ways.empty()) return std::nullopt;
  for (Standing& way : ways) way = Minimize(problem, way.x, kIterations);
  auto best = std::min_element(ways.begin(), ways.end(), IsLikelier);
  if (known.is_fit) {
    // What it was fitted to before is among the points: it goes on from there,
    // unless another way of standing is clearly likelier.
    Standing on = Minimize(problem, problem.StartTurnedBy(0.0), kIterations);
    if (on.cost - best->cost < kMinAdvantage) {
      ways = {std::move(on)};
      best = ways.begin();
    }
  }
  const Params x = LongerFirst(best->x);
  for (const Standing& way : ways) {
    if (way.cost - best->cost < kMinAdvantage &&
        !StandTheSameWay(x, LongerFirst(way.x))) {
      return std::nullopt;
    }
  }
  return problem.FitOf(x, best->normal);
}

}  // namespace groundlock::ground
