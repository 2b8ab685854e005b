// SPDX-License-Identifier: Apache-2.0
#include "server/ground/box_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "map_store/base/status.h"

namespace groundlock::ground {
namespace {

using geometry::Box2;
using geometry::Box3;

// Place on the ground (2, relative to the start, in units of the start width),
// then the logarithms of length, width and height.
using Params = Eigen::Matrix<double, 5, 1>;

// See BodyShape: the waist's height over the middle, as a share of half the
// height, and where the wheels are, of half the length.
constexpr double kWaist = 0.0;
constexpr double kAxle = 0.6;

constexpr int kMaxIterations = 60;
constexpr double kStep = 1e-5;       // of the numerical derivative
constexpr double kEdgeSigma = 0.01;  // of the box's size
// An edge off by more than so many sigmas (5 % of the box) is no fit.
constexpr double kMaxEdgeError = 5.0;
// Extents stay within a factor e^5 of the start: beyond, nothing fits.
constexpr double kMaxLogExtent = 5.0;
// A body whose shape is off by two sigmas of the prior is rather one that
// stands otherwise, or that is longer than wide; what is tried then. Boxes that
// were drawn from the side have 0.3 to 1.8, of rendered yards and hills, those
// from above or by a camera that rolls by 30 degrees up to 13.
constexpr double kUnlikelyShape = 4.0;
constexpr int kHeadings = 12;
constexpr double kLongShape = 2.0;

// What is believed of the logarithms of length, width and height, as residuals;
// `start` is that of the length that they are relative to.
struct ByShape {
  static constexpr int kResiduals = 2;
  const ShapePrior* prior;

  Eigen::Vector2d Residuals(const Eigen::Vector3d& log_size,
                            double /*start*/) const {
    return {(log_size[0] - log_size[1] - std::log(prior->length_over_width)) /
                prior->length_over_width_sigma,
            (log_size[2] - 0.5 * (log_size[0] + log_size[1]) -
             std::log(prior->tallness)) /
                prior->tallness_sigma};
  }
};

struct BySize {
  static constexpr int kResiduals = 3;
  const SizePrior* prior;

  Eigen::Vector3d Residuals(const Eigen::Vector3d& log_size,
                            double start) const {
    return prior->whitening_log *
           (log_size - (prior->size_m.array().log() - start).matrix());
  }
};

template <typename Prior>
struct FitProblem {
  static constexpr int kResiduals = 4 + Prior::kResiduals;
  using Residuals = Eigen::Matrix<double, kResiduals, 1>;

  const GroundView* view;
  const Box2* box_px;
  Prior prior;
  geometry::PlaneAxes axes;
  Eigen::Vector2d start_place;
  Eigen::Vector3d heading;
  double start_width;

  Box3 BoxOf(const Params& x) const {
    const Eigen::Vector2d place = start_place + start_width * x.head<2>();
    return UprightBox(view->ground_world,
                      axes.ToWorld(place),
                      heading,
                      start_width * x.tail<3>().array().exp().matrix());
  }

  std::optional<Residuals> Evaluate(const Params& x) const {
    if (x.tail<3>().cwiseAbs().maxCoeff() > kMaxLogExtent) return std::nullopt;
    const std::optional<Box2> hull = ProjectBodyHull(*view, BoxOf(x));
    if (!hull) return std::nullopt;
    const Eigen::Vector2d sigma =
        (kEdgeSigma * box_px->size_px()).cwiseMax(1.0);
    Residuals r;
    r.template segment<2>(0) =
        (hull->min_px - box_px->min_px).cwiseQuotient(sigma);
    r.template segment<2>(2) =
        (hull->max_px - box_px->max_px).cwiseQuotient(sigma);
    r.template tail<Prior::kResiduals>() =
        prior.Residuals(x.tail<3>(), std::log(start_width));
    return r;
  }

  // Numerical.
  std::optional<Eigen::Matrix<double, kResiduals, 5>> Jacobian(
      const Params& x, const Residuals& r) const {
    Eigen::Matrix<double, kResiduals, 5> jacobian;
    for (int k = 0; k < 5; ++k) {
      const auto moved = Evaluate(x + kStep * Params::Unit(k));
      if (!moved) return std::nullopt;
      jacobian.col(k) = (*moved - r) / kStep;
    }
    return jacobian;
  }
};

// The same start for every fit of a box.
template <typename Prior>
absl::StatusOr<FitProblem<Prior>> StartFit(
    const GroundView& view,
    const Box2& box_px,
    const std::optional<Eigen::Vector3d>& heading_world,
    const Prior& prior) {
  if (!box_px.IsFinite() || !(box_px.Area() > 0.0)) {
    return absl::InvalidArgumentError("the box has no size");
  }
  const auto bottom =
      GroundFromImage(view, {box_px.center_px().x(), box_px.max_px.y()});
  if (!bottom) {
    return absl::OutOfRangeError(
        "the box's lower edge is not on the ground in front of the camera");
  }
  const Eigen::Vector3d& camera = view.world_from_camera.translation;
  const double width =
      (*bottom - camera).norm() * box_px.width() / view.camera->mean_focal_px();
  const Eigen::Vector3d away = AwayOnGround(view, *bottom);
  const geometry::PlaneAxes axes(view.ground_world);
  return FitProblem<Prior>{&view,
                           &box_px,
                           prior,
                           axes,
                           axes.FromWorld(*bottom + 0.5 * width * away),
                           heading_world.value_or(away),
                           width};
}

// Levenberg-Marquardt with numerical derivatives: five unknowns, run once per
// target, on a function with corners where the hull's edge changes its vertex.
template <typename Prior>
std::optional<Params> Minimize(const FitProblem<Prior>& problem, Params x) {
  auto r = problem.Evaluate(x);
  if (!r) return std::nullopt;
  double lambda = 1e-3;
  for (int i = 0; i < kMaxIterations; ++i) {
    const auto jacobian = problem.Jacobian(x, *r);
    if (!jacobian) return std::nullopt;
    Eigen::Matrix<double, 5, 5> normal = jacobian->transpose() * *jacobian;
    normal.diagonal() *= 1.0 + lambda;
    const Params step = normal.ldlt().solve(-jacobian->transpose() * *r);
    const auto next = problem.Evaluate(x + step);
    if (next && next->squaredNorm() < r->squaredNorm()) {
      const bool done = step.norm() < 1e-9;
      x += step;
      r = next;
      lambda = std::max(0.1 * lambda, 1e-9);
      if (done) break;
    } else {
      lambda *= 10.0;
      if (lambda > 1e9) break;
    }
  }
  if (r->template head<4>().cwiseAbs().maxCoeff() > kMaxEdgeError) {
    return std::nullopt;
  }
  return x;
}

struct ShapeFit {
  Box3 box;
  double cost = 0.0;  // squared residuals
};

// The first that fits of starts at several heights: a target seen from above
// starts flat, a person tall, and the hull's corners make the function's basin
// narrow in between.
std::optional<ShapeFit> FitAlongHeading(const FitProblem<ByShape>& problem,
                                        double length_over_width) {
  const double aspect = problem.box_px->height() / problem.box_px->width();
  for (const double tallness : {0.7 * aspect, 0.3 * aspect, 0.1, 1.0}) {
    Params start = Params::Zero();
    start[2] = std::log(length_over_width);
    start[4] = std::log(tallness);
    if (const auto x = Minimize(problem, start)) {
      return ShapeFit{problem.BoxOf(*x), problem.Evaluate(*x)->squaredNorm()};
    }
  }
  return std::nullopt;
}

// Calls `add` with each corner of a body, in the object frame of its box, and
// where it is in the image. False: one is not in front of the camera.
template <typename Add>
bool ProjectCorners(const GroundView& view,
                    const Box3& box,
                    const BodyShape& shape,
                    const Add& add) {
  const geometry::Rigid3 camera_from_object =
      view.world_from_camera.Inverse() * box.world_from_object;
  // In half sizes; with all signs of x and y.
  const auto add_all = [&](double x, double y, double z) {
    for (const double sign_x : {-1.0, 1.0}) {
      for (const double sign_y : {-1.0, 1.0}) {
        const Eigen::Vector3d p_object =
            0.5 *
            box.size_m.cwiseProduct(Eigen::Vector3d(sign_x * x, sign_y * y, z));
        const auto pixel_px =
            view.camera->ImageFromCamera(camera_from_object * p_object);
        if (!pixel_px) return false;
        add(p_object, *pixel_px);
      }
    }
    return true;
  };
  for (const auto& [z, side] : {std::pair{2.0 * shape.clearance - 1.0, 1.0},
                                std::pair{kWaist, 1.0},
                                std::pair{1.0, shape.roof}}) {
    if (!add_all(side, side * shape.plan, z) ||
        !add_all(side * shape.plan, side, z)) {
      return false;
    }
  }
  return !(shape.clearance > 0.0) || add_all(kAxle, 1.0, -1.0);
}

}  // namespace

Eigen::Vector3d AwayOnGround(const GroundView& view,
                             const Eigen::Vector3d& p_world) {
  const Eigen::Vector3d away =
      view.ground_world.Project(p_world) -
      view.ground_world.Project(view.world_from_camera.translation);
  // Right below the camera, "away" is as good as any direction of the image.
  return away.norm() > 0.1 * CameraHeight_m(view) ? away.normalized().eval()
                                                  : ForwardOnGround(view);
}

Eigen::Vector4d SeenOutline::OffBy_px(const Box2& outline_px) const {
  Eigen::Vector4d off_px;
  off_px << outline_px.min_px - outline_px.min_px.cwiseMin(sure_px.min_px)
                                    .cwiseMax(possible_px.min_px),
      outline_px.max_px - outline_px.max_px.cwiseMax(sure_px.max_px)
                              .cwiseMin(possible_px.max_px);
  return off_px;
}

Eigen::Vector2d SeenOutline::SizeOffBy_px(const Box2& outline_px) const {
  const Eigen::Vector2d size_px = outline_px.size_px();
  return size_px -
         size_px.cwiseMax(sure_px.size_px()).cwiseMin(possible_px.size_px());
}

std::optional<Box2> ProjectBodyHull(const GroundView& view,
                                    const Box3& box,
                                    const BodyShape& shape) {
  const auto hull = ProjectBodyEdges(view, box, shape);
  if (!hull) return std::nullopt;
  return hull->box_px;
}

std::optional<BodyHull> ProjectBodyEdges(const GroundView& view,
                                         const Box3& box,
                                         const BodyShape& shape) {
  std::optional<BodyHull> hull;
  const auto add = [&](const Eigen::Vector3d& p_object,
                       const Eigen::Vector2d& pixel_px) {
    if (!hull) {
      hull = BodyHull{{pixel_px, pixel_px},
                      {p_object, p_object, p_object, p_object}};
    }
    for (const int axis : {0, 1}) {
      double& least_px = hull->box_px.min_px[axis];
      double& most_px = hull->box_px.max_px[axis];
      if (pixel_px[axis] < least_px) {
        least_px = pixel_px[axis];
        hull->edges_object[axis] = p_object;
      }
      if (pixel_px[axis] > most_px) {
        most_px = pixel_px[axis];
        hull->edges_object[2 + axis] = p_object;
      }
    }
  };
  if (!ProjectCorners(view, box, shape, add)) return std::nullopt;
  return hull;
}

std::optional<geometry::ConvexPolygon> ProjectBody(const GroundView& view,
                                                   const Box3& box,
                                                   const BodyShape& shape) {
  std::vector<Eigen::Vector2d> corners_px;
  const auto add = [&](const Eigen::Vector3d& /*p_object*/,
                       const Eigen::Vector2d& pixel_px) {
    corners_px.push_back(pixel_px);
  };
  if (!ProjectCorners(view, box, shape, add)) return std::nullopt;
  return geometry::ConvexHull(std::move(corners_px));
}

absl::StatusOr<Box3> FitBox(const GroundView& view,
                            const Box2& box_px,
                            const std::optional<Eigen::Vector3d>& heading_world,
                            const ShapePrior& prior) {
  ASSIGN_OR_RETURN(auto problem,
                   StartFit(view, box_px, heading_world, ByShape{&prior}));
  auto best = FitAlongHeading(problem, prior.length_over_width);
  if (!heading_world && (!best || best->cost > kUnlikelyShape)) {
    const Eigen::Vector3d away = problem.heading;
    for (int k = 0; k < kHeadings; ++k) {
      problem.heading = Eigen::AngleAxisd(std::numbers::pi * k / kHeadings,
                                          view.ground_world.normal) *
                        away;
      const auto fit = FitAlongHeading(problem, kLongShape);
      if (fit && (!best || fit->cost < best->cost)) best = fit;
    }
  }
  if (best) return best->box;
  return absl::OutOfRangeError(
      "no box on the ground fits the box in the image");
}

SizePrior SizePriorOf(const ShapePrior& shape) {
  const double length = std::sqrt(shape.length_over_width);
  SizePrior prior;
  prior.size_m = {length, 1.0 / length, shape.tallness};
  const double ratio = 1.0 / shape.length_over_width_sigma;
  const double tall = 1.0 / shape.tallness_sigma;
  prior.whitening_log << ratio, -ratio, 0.0, -0.5 * tall, -0.5 * tall, tall,
      0.0, 0.0, 0.0;
  return prior;
}

std::optional<BoxFit> FitBoxOfSize(const GroundView& view,
                                   const Box2& box_px,
                                   const Eigen::Vector3d& heading_world,
                                   const SizePrior& prior) {
  const auto problem = StartFit(view, box_px, heading_world, BySize{&prior});
  if (!problem.ok()) return std::nullopt;
  Params start = Params::Zero();
  start.tail<3>() =
      (prior.size_m.array().log() - std::log(problem->start_width)).matrix();
  const auto x = Minimize(*problem, start);
  if (!x) return std::nullopt;
  const auto r = problem->Evaluate(*x);
  const auto jacobian = problem->Jacobian(*x, *r);
  if (!jacobian) return std::nullopt;
  const Eigen::Matrix<double, 5, 5> information =
      jacobian->transpose() * *jacobian;
  const Eigen::Matrix<double, 5, 5> covariance = information.inverse();
  BoxFit fit;
  fit.box = problem->BoxOf(*x);
  fit.log_evidence = -0.5 * r->squaredNorm() +
                     std::log(std::abs(prior.whitening_log.determinant())) -
                     0.5 * std::log(information.determinant());
  fit.log_size_covariance = covariance.bottomRightCorner<3, 3>();
  if (!std::isfinite(fit.log_evidence) || !covariance.allFinite()) {
    return std::nullopt;
  }
  return fit;
}

std::optional<PlacedBox> PlaceBoxByCenter(
    const GroundView& view,
    const Eigen::Vector2d& center_px,
    const Eigen::Vector3d& heading_world,
    const Eigen::Vector3d& size_m,
    const Eigen::Vector3d& p_guess_world) {
  if (!(CameraHeight_m(view) > 0.0)) return std::nullopt;
  const geometry::PlaneAxes axes(view.ground_world);
  const auto center_of =
      [&](const Eigen::Vector2d& place) -> std::optional<Eigen::Vector2d> {
    const auto hull = ProjectBodyHull(
        view,
        UprightBox(
            view.ground_world, axes.ToWorld(place), heading_world, size_m));
    if (!hull) return std::nullopt;
    return hull->center_px();
  };
  const Eigen::Vector2d below =
      axes.FromWorld(view.world_from_camera.translation);
  const auto newton = [&](Eigen::Vector2d place) -> std::optional<PlacedBox> {
    for (int i = 0; i < 30; ++i) {
      const auto center = center_of(place);
      if (!center) return std::nullopt;
      const double step = 1e-4 * size_m.norm();
      Eigen::Matrix2d jacobian;
      for (int k = 0; k < 2; ++k) {
        const auto moved = center_of(place + step * Eigen::Vector2d::Unit(k));
        if (!moved) return std::nullopt;
        jacobian.col(k) = (*moved - *center) / step;
      }
      if (!(std::abs(jacobian.determinant()) > 1e-12)) return std::nullopt;
      const Eigen::Matrix2d inverse = jacobian.inverse();
      Eigen::Vector2d change = inverse * (center_px - *center);
      if (!change.allFinite()) return std::nullopt;
      if ((center_px - *center).norm() < 1e-6) {
        return PlacedBox{
            UprightBox(
                view.ground_world, axes.ToWorld(place), heading_world, size_m),
            inverse};
      }
      // Perspective bends away from Newton's line: half the distance at most.
      const double limit =
          0.5 * std::max((place - below).norm(), CameraHeight_m(view));
      if (change.norm() > limit) change *= limit / change.norm();
      place += change;
      if ((place - below).norm() > kMaxRangeOverHeight * CameraHeight_m(view)) {
        return std::nullopt;
      }
    }
    return std::nullopt;
  };
  if (p_guess_world.allFinite()) {
    if (auto placed = newton(axes.FromWorld(p_guess_world))) return placed;
  }
  const auto p_ground = GroundFromImage(view, center_px);
  if (!p_ground) return std::nullopt;
  return newton(axes.FromWorld(*p_ground));
}

std::optional<PlacedBox> PlaceBoxByPoint(const GroundView& view,
                                         const Eigen::Vector2d& pixel_px,
                                         const Eigen::Vector3d& heading_world,
                                         const Eigen::Vector3d& size_m,
                                         const Eigen::Vector3d& p_object) {
  // The point stands this high over the ground, wherever the box is.
  const Box3 box = UprightBox(
      view.ground_world, Eigen::Vector3d::Zero(), heading_world, size_m);
  const Eigen::Vector3d from_bottom =
      box.world_from_object.rotation *
      (p_object + Eigen::Vector3d(0.0, 0.0, 0.5 * size_m.z()));
  GroundView raised = view;
  raised.ground_world.d -= view.ground_world.normal.dot(from_bottom);
  const geometry::PlaneAxes axes(view.ground_world);
  const auto place_of =
      [&](const Eigen::Vector2d& pixel) -> std::optional<Eigen::Vector2d> {
    const auto p = GroundFromImage(raised, pixel);
    if (!p) return std::nullopt;
    return axes.FromWorld(*p - from_bottom);
  };
  const auto place = place_of(pixel_px);
  if (!place) return std::nullopt;
  PlacedBox placed;
  for (int k = 0; k < 2; ++k) {
    // Downwards in the image, away from the horizon, or sideways.
    const auto moved = place_of(pixel_px + 0.01 * Eigen::Vector2d::Unit(k));
    if (!moved) return std::nullopt;
    placed.place_by_center_m_px.col(k) = (*moved - *place) / 0.01;
  }
  placed.box = UprightBox(
      view.ground_world, axes.ToWorld(*place), heading_world, size_m);
  return placed;
}

Eigen::Vector3d PointOnRay(const GroundView& view,
                           const Box3& box,
                           const Eigen::Vector2d& pixel_px,
                           double depth) {
  const auto ray_camera = view.camera->RayFromImage(pixel_px);
  if (!ray_camera) return Eigen::Vector3d::Zero();
  const geometry::Rigid3 object_from_camera =
      box.world_from_object.Inverse() * view.world_from_camera;
  const Eigen::Vector3d origin = object_from_camera.translation;
  const Eigen::Vector3d ray = object_from_camera.rotation * *ray_camera;
  double enter = 0.0;
  double leave = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 3; ++k) {
    const double half = 0.5 * box.size_m[k];
    if (std::abs(ray[k]) < 1e-12) {
      if (std::abs(origin[k]) > half) return Eigen::Vector3d::Zero();
      continue;
    }
    const double a = (-half - origin[k]) / ray[k];
    const double b = (half - origin[k]) / ray[k];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  if (!(enter < leave)) return Eigen::Vector3d::Zero();
  const double middle = std::clamp(-origin.dot(ray), enter, leave);
  return origin + (middle + depth * (enter - middle)) * ray;
}

Eigen::Matrix2d GroundCovarianceFromPose(const GroundView& view,
                                         const Eigen::Vector3d& p_world,
                                         const geometry::Matrix6d& covariance) {
  // X = C + s r on n.X + d = 0, so dX = (I - r n^T / (n.r)) (dC + dtheta x (X -
  // C)).
  const Eigen::Vector3d& n = view.ground_world.normal;
  const Eigen::Vector3d ray = p_world - view.world_from_camera.translation;
  double cosine = n.dot(ray);
  // A point on the horizon has no bound; this one is finite and useless.
  if (std::abs(cosine) < 1e-6 * ray.norm()) cosine = -1e-6 * ray.norm();
  Eigen::Matrix<double, 3, 6> jacobian;
  jacobian << Eigen::Matrix3d::Identity(), -geometry::Skew(ray);
  jacobian = (Eigen::Matrix3d::Identity() - ray * n.transpose() / cosine) *
             jacobian.eval();
  const Eigen::Matrix<double, 2, 6> on_ground =
      geometry::PlaneAxes(view.ground_world).axes_world.transpose() * jacobian;
  return on_ground * covariance * on_ground.transpose();
}

}  // namespace groundlock::ground
