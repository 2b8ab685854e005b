// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/measured_up.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <string_view>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "map_store/base/order_statistics.h"
#include "map_store/geometry/robust_similarity.h"
#include "map_store/map/internal/camera_position_fit.h"
#include "map_store/map/internal/up_evidence.h"

namespace groundlock::map {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::size_t kMinPhotos = 3;
// What is less sure than that tells nothing that pictures do not.
constexpr double kMaxSigma_rad = 5.0 * kDegree;
constexpr double kLeastAgreeing = 2.0 / 3.0;
// What all photos of a gimbal may have in common: makers promise some tenths of
// a degree for how still it holds, and nothing for its zero.
constexpr double kGimbalSigma_rad = 1.0 * kDegree;
// Attitudes agree that are so near to the one in their middle, or within three
// of their own sigmas, up to the second figure.
constexpr double kAgree_rad = 3.0 * kDegree;
constexpr double kMaxAgree_rad = 10.0 * kDegree;
// The attitude in the middle is sought among so many.
constexpr std::size_t kMaxCandidates = 300;
// From the median of angles in the plane to a sigma per axis (Rayleigh).
constexpr double kSigmaOfMedianAngle = 1.0 / 1.1774;
// Of a satellite receiver's position per axis, and what the heights of a
// flight's positions drift by against each other without that their scatter
// about the map shows it.
constexpr double kAccuracy_m = 3.0;
constexpr double kHeightDrift_m = 1.0;
// Walls and posts are upright to half a degree, trees in the mean, and lenses
// turn edges at the border of an image: flights' edges were off by 0.5 to 1.2
// degrees from their horizons, rendered and laser-scanned places by up to 0.4.
constexpr double kEdgesSigma_rad = 1.0 * kDegree;
// Level edges are as parallel as upright ones. From a camera that looks steeply
// down, those along its way may be nearer to where up would be in a level
// image: then cameras would climb (log of UpEvidence, as of a ground that is
// not level), or look up by more than 24 degrees in the mean.
constexpr double kLeastEvidence = -3.0;
constexpr double kMaxLooksUp = 0.4;
// Two measurements contradict each other beyond so many sigmas.
constexpr double kMaxSigmasApart = 3.0;

double AngleBetween_rad(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

std::string_view FileName(std::string_view image) {
  return image.substr(image.rfind('/') + 1);
}

// The direction with the least median angle to the others, and that angle.
struct Middle {
  Eigen::Vector3d direction;
  double median_rad = std::numbers::pi;
};
Middle MiddleOf(const std::vector<Eigen::Vector3d>& directions) {
  Middle middle;
  const std::size_t step = directions.size() / kMaxCandidates + 1;
  for (std::size_t i = 0; i < directions.size(); i += step) {
    std::vector<double> angles_rad;
    angles_rad.reserve(directions.size());
    for (const Eigen::Vector3d& other : directions) {
      angles_rad.push_back(AngleBetween_rad(directions[i], other));
    }
    const double median_rad = base::Median(std::move(angles_rad));
    if (median_rad < middle.median_rad) middle = {directions[i], median_rad};
  }
  return middle;
}

std::optional<MeasuredUp> ByAttitudes(const std::vector<Eigen::Vector3d>& ups,
                                      std::vector<std::string>& warnings) {
  if (ups.size() < kMinPhotos) return std::nullopt;
  const Middle middle = MiddleOf(ups);
  const double agree_rad = std::clamp(
      3.0 * kSigmaOfMedianAngle * middle.median_rad, kAgree_rad, kMaxAgree_rad);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> agreeing;
  for (const Eigen::Vector3d& up : ups) {
    if (AngleBetween_rad(up, middle.direction) > agree_rad) continue;
    agreeing.push_back(up);
    sum += up;
  }
  MeasuredUp measured;
  if (sum.norm() > 0.0) measured.up_world = sum.normalized();
  double squares = 0.0;
  for (const Eigen::Vector3d& up : agreeing) {
    squares += std::pow(AngleBetween_rad(up, measured.up_world), 2.0);
  }
  // Angles from the mean have two axes.
  const double scatter_rad =
      std::sqrt(0.5 * squares / static_cast<double>(agreeing.size()));
  measured.sigma_rad = std::hypot(scatter_rad, kGimbalSigma_rad);
  if (static_cast<double>(agreeing.size()) <
          kLeastAgreeing * static_cast<double>(ups.size()) ||
      measured.sigma_rad > kMaxSigma_rad) {
    warnings.push_back(absl::StrFormat(
        "the photos' attitudes contradict the map: only %d of %d tell the same "
        "up, to within %.0f degrees; they were left out",
        agreeing.size(),
        ups.size(),
        agree_rad / kDegree));
    return std::nullopt;
  }
  measured.basis =
      absl::StrFormat("the attitudes of %d photos, which agree to %.1f degrees",
                      agreeing.size(),
                      scatter_rad / kDegree);
  return measured;
}

std::optional<MeasuredUp> ByPositions(
    const std::vector<Eigen::Vector3d>& p_world,
    const std::vector<Eigen::Vector3d>& p_local_m) {
  if (p_world.size() < kMinPhotos) return std::nullopt;
  const auto fit =
      internal::FitCameraPositions(p_world, p_local_m, kAccuracy_m, 0);
  // Its warnings are that up was taken from the map, or that the positions are
  // worse than they should be.
  if (!fit.ok() || !fit->warnings.empty()) return std::nullopt;
  std::vector<Eigen::Vector3d> used;
  double squares = 0.0;
  for (std::size_t i = 0; i < p_world.size(); ++i) {
    if (!fit->used[i]) continue;
    used.push_back(p_local_m[i]);
    squares += std::pow(
        (fit->measured_from_world * p_world[i] - p_local_m[i]).z(), 2.0);
  }
  if (static_cast<double>(used.size()) <
      kLeastAgreeing * static_cast<double>(p_world.size())) {
    return std::nullopt;
  }
  const double scatter_m =
      std::sqrt(squares / static_cast<double>(used.size()));
  const double across_m = geometry::PrincipalSpread(used)(1);
  MeasuredUp measured;
  measured.up_world =
      fit->measured_from_world.rotation.conjugate() * Eigen::Vector3d::UnitZ();
  measured.sigma_rad = std::hypot(scatter_m, kHeightDrift_m) / across_m;
  if (!(measured.sigma_rad <= kMaxSigma_rad)) return std::nullopt;
  measured.basis = absl::StrFormat(
      "the GPS positions of %d photos, whose heights agree to %.1f m",
      used.size(),
      scatter_m);
  return measured;
}

std::vector<geometry::Rigid3> PosesOf(const MapData& data) {
  std::vector<geometry::Rigid3> poses;
  for (const MapViewData& view : data.views) {
    poses.push_back(view.camera_from_world);
  }
  return poses;
}

std::optional<MeasuredUp> ByEdges(const UprightEdges& edges,
                                  const MapData& data) {
  double looks_up = 0.0;
  for (const MapViewData& view : data.views) {
    looks_up += (view.camera_from_world.rotation * edges.up_world).z();
  }
  if (looks_up > kMaxLooksUp * static_cast<double>(data.views.size()) ||
      internal::UpEvidence(PosesOf(data)).LogOf(edges.up_world) <
          kLeastEvidence) {
    return std::nullopt;
  }
  return MeasuredUp{edges.up_world,
                    kEdgesSigma_rad,
                    absl::StrCat(edges.count, " edges of what stands upright")};
}

}  // namespace

std::optional<MeasuredUp> MeasureUp(const UpReadings& readings,
                                    const MapData& data,
                                    std::vector<std::string>& warnings) {
  std::map<std::string_view, const PhotoReading*> by_name;
  for (const PhotoReading& reading : readings.photos) {
    by_name[FileName(reading.image)] = &reading;
  }
  std::vector<Eigen::Vector3d> ups;
  std::vector<Eigen::Vector3d> p_world;
  std::vector<Eigen::Vector3d> p_local_m;
  for (const MapViewData& view : data.views) {
    const auto found = by_name.find(FileName(view.name));
    if (found == by_name.end()) continue;
    const PhotoReading& reading = *found->second;
    if (reading.up_camera) {
      ups.push_back(view.camera_from_world.rotation.conjugate() *
                    *reading.up_camera);
    }
    if (reading.p_local_m) {
      p_world.push_back(view.camera_from_world.Inverse().translation);
      p_local_m.push_back(*reading.p_local_m);
    }
  }
  std::vector<MeasuredUp> measured;
  if (auto up = ByAttitudes(ups, warnings)) measured.push_back(*std::move(up));
  if (auto up = ByPositions(p_world, p_local_m)) {
    measured.push_back(*std::move(up));
  }
  if (readings.edges) {
    if (auto up = ByEdges(*readings.edges, data)) {
      measured.push_back(*std::move(up));
    }
  }
  if (measured.empty()) return std::nullopt;
  MeasuredUp all = measured.front();
  for (std::size_t i = 1; i < measured.size(); ++i) {
    const MeasuredUp& up = measured[i];
    for (std::size_t j = 0; j < i; ++j) {
      const double apart_rad =
          AngleBetween_rad(up.up_world, measured[j].up_world);
      if (apart_rad <=
          kMaxSigmasApart * std::hypot(up.sigma_rad, measured[j].sigma_rad)) {
        continue;
      }
      warnings.push_back(absl::StrFormat(
          "which way is up is in doubt, and left to the ways that cameras are "
          "held: %s and %s are %.0f degrees apart",
          measured[j].basis,
          up.basis,
          apart_rad / kDegree));
      return std::nullopt;
    }
    if (up.sigma_rad < all.sigma_rad) {
      all.up_world = up.up_world;
      all.sigma_rad = up.sigma_rad;
    }
    absl::StrAppend(&all.basis, ", and ", up.basis);
  }
  return all;
}

Eigen::Vector3d UpByCameras(const MapData& data) {
  return internal::UpEvidence(PosesOf(data)).Best();
}

}  // namespace groundlock::map
