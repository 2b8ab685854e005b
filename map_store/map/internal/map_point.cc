// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/map_point.h"

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <optional>

#include "map_store/base/status.h"

namespace groundlock::map::internal {
namespace {

// A click is good to some pixels; beyond this a wrong image was named.
constexpr double kMaxError_px = 20.0;
constexpr double kWarnError_px = 5.0;
constexpr int kIterations = 10;

struct Sighting {
  const MapViewData* view = nullptr;
  const geometry::CameraModel* camera = nullptr;
  Eigen::Vector2d xy_px;
  Eigen::Vector3d center_world;
  Eigen::Vector3d ray_world;  // unit
};

// The point nearest to all rays.
std::optional<Eigen::Vector3d> MeetingPoint(
    const std::vector<Sighting>& sightings) {
  Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Sighting& s : sightings) {
    const Eigen::Matrix3d across =
        Eigen::Matrix3d::Identity() - s.ray_world * s.ray_world.transpose();
    a += across;
    b += across * s.center_world;
  }
  const Eigen::FullPivLU<Eigen::Matrix3d> solver(a);
  if (!solver.isInvertible()) return std::nullopt;
  return solver.solve(b);
}

// Gauss-Newton on the reprojection error; keeps the last point that projects
// into all images.
Eigen::Vector3d Refine(const std::vector<Sighting>& sightings,
                       Eigen::Vector3d point) {
  for (int i = 0; i < kIterations; ++i) {
    Eigen::Matrix3d hessian = Eigen::Matrix3d::Zero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    for (const Sighting& s : sightings) {
      Eigen::Matrix<double, 2, 3> jacobian;
      const auto pixel = s.camera->ImageFromCamera(
          s.view->camera_from_world * point, &jacobian);
      if (!pixel) return point;
      const Eigen::Matrix<double, 2, 3> j =
          jacobian * s.view->camera_from_world.rotation.toRotationMatrix();
      hessian += j.transpose() * j;
      gradient += j.transpose() * (*pixel - s.xy_px);
    }
    const Eigen::Vector3d step = hessian.ldlt().solve(gradient);
    if (!step.allFinite()) return point;
    point -= step;
    if (step.norm() < 1e-9 * (point - sightings[0].center_world).norm()) break;
  }
  return point;
}

double MaxParallax(const std::vector<Sighting>& sightings) {
  double smallest_cosine = 1.0;
  for (const Sighting& a : sightings) {
    for (const Sighting& b : sightings) {
      smallest_cosine = std::min(smallest_cosine, a.ray_world.dot(b.ray_world));
    }
  }
  return std::acos(std::clamp(smallest_cosine, -1.0, 1.0)) * 180.0 /
         std::numbers::pi;
}

// What follows the last separator, of whatever system.
std::string_view FileName(std::string_view path) {
  const std::size_t separator = path.find_last_of("/\\");
  return separator == std::string_view::npos ? path
                                             : path.substr(separator + 1);
}

}  // namespace

absl::StatusOr<std::size_t> FindView(const MapData& data,
                                     std::string_view name) {
  // Tools name images by paths of their own; file names tell them apart, too.
  for (const bool whole : {true, false}) {
    const std::string_view wanted = whole ? name : FileName(name);
    std::optional<std::size_t> found;
    for (std::size_t i = 0; i < data.views.size(); ++i) {
      const std::string_view own = data.views[i].name;
      if ((whole ? own : FileName(own)) != wanted) continue;
      if (found) {
        return absl::InvalidArgumentError(absl::StrCat(
            "the map has several images named ", base::Abseil(wanted)));
      }
      found = i;
    }
    if (found) return *found;
  }
  return absl::InvalidArgumentError(
      absl::StrCat("the map has no image named ", base::Abseil(name)));
}

absl::StatusOr<Eigen::Vector3d> LocateMapPoint(
    const MapData& data,
    const MapPoint& point,
    std::string_view name,
    std::vector<std::string>& warnings) {
  if (point.p_world) {
    if (!point.p_world->allFinite()) {
      return absl::InvalidArgumentError(
          absl::StrCat(base::Abseil(name), ": its position is not finite"));
    }
    return *point.p_world;
  }
  if (point.pixels.size() < 2) {
    return absl::InvalidArgumentError(
        absl::StrCat(base::Abseil(name),
                     ": needs a position or pixels in two images, has ",
                     point.pixels.size()));
  }
  std::vector<Sighting> sightings;
  for (const MapPoint::Pixel& pixel : point.pixels) {
    auto index = FindView(data, pixel.image);
    if (!index.ok()) return base::Annotate(index.status(), name);
    Sighting& s = sightings.emplace_back();
    s.view = &data.views[*index];
    s.camera = &data.cameras[s.view->camera];
    s.xy_px = pixel.xy_px;
    const auto ray = pixel.xy_px.allFinite()
                         ? s.camera->RayFromImage(pixel.xy_px)
                         : std::nullopt;
    if (!ray || !s.camera->IsInsideImage(pixel.xy_px)) {
      return absl::InvalidArgumentError(absl::StrCat(base::Abseil(name),
                                                     ": pixel (",
                                                     pixel.xy_px.x(),
                                                     ", ",
                                                     pixel.xy_px.y(),
                                                     ") is outside of ",
                                                     pixel.image));
    }
    const geometry::Rigid3 world_from_camera =
        s.view->camera_from_world.Inverse();
    s.center_world = world_from_camera.translation;
    s.ray_world = world_from_camera.rotation * *ray;
  }
  const double parallax_deg = MaxParallax(sightings);
  if (parallax_deg < kMinParallax_deg) {
    return absl::FailedPreconditionError(
        absl::StrCat(base::Abseil(name),
                     ": its images see it from directions only ",
                     parallax_deg,
                     " degrees apart; take images from farther apart"));
  }
  const auto meeting = MeetingPoint(sightings);
  if (!meeting) {
    return absl::FailedPreconditionError(
        absl::StrCat(base::Abseil(name), ": its rays are parallel"));
  }
  const Eigen::Vector3d located = Refine(sightings, *meeting);
  double worst_px = 0.0;
  for (const Sighting& s : sightings) {
    const auto pixel =
        s.camera->ImageFromCamera(s.view->camera_from_world * located);
    if (!pixel || (*pixel - s.xy_px).norm() > kMaxError_px) {
      return absl::FailedPreconditionError(
          absl::StrCat(base::Abseil(name),
                       ": the pixels in its images are not of one point (see ",
                       s.view->name,
                       ")"));
    }
    worst_px = std::max(worst_px, (*pixel - s.xy_px).norm());
  }
  if (worst_px > kWarnError_px) {
    warnings.push_back(absl::StrCat(base::Abseil(name),
                                    ": its pixels contradict each other by ",
                                    worst_px,
                                    " px"));
  }
  return located;
}

}  // namespace groundlock::map::internal
