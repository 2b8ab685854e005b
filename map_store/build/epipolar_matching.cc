// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/epipolar_matching.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <utility>

#include "map_store/map/landmark_index.h"

namespace groundlock::build::internal {
namespace {

// Grid over an image, and depths in units of the neighbours' distance, at which
// views are compared.
constexpr int kGridX = 6;
constexpr int kGridY = 4;
constexpr std::array<double, 4> kDepths = {2.0, 6.0, 20.0, 100.0};
// Beyond, surfaces look too different from both sides.
constexpr double kMaxAngle_rad = 1.2;
// Keypoints nearer than this are one place, of other orientation or scale.
constexpr float kSamePlace_px = 2.0F;
constexpr int kMaxLandmarksPerTrack = 4;

// The median distance of a camera to its nearest neighbour.
double NeighbourDistance(std::span<const PosedFeatures> images) {
  std::vector<double> nearest;
  for (std::size_t i = 0; i < images.size(); ++i) {
    const Eigen::Vector3d center =
        images[i].camera_from_world.Inverse().translation;
    double best = std::numeric_limits<double>::infinity();
    for (std::size_t j = 0; j < images.size(); ++j) {
      if (i == j) continue;
      const double distance =
          (images[j].camera_from_world.Inverse().translation - center).norm();
      if (distance > 0.0) best = std::min(best, distance);
    }
    if (std::isfinite(best)) nearest.push_back(best);
  }
  if (nearest.empty()) return 1.0;
  std::nth_element(
      nearest.begin(),
      nearest.begin() + static_cast<std::ptrdiff_t>(nearest.size() / 2),
      nearest.end());
  return nearest[nearest.size() / 2];
}

// The share of the first image's grid that the second sees, at the best depth.
double Overlap(const PosedFeatures& first,
               const PosedFeatures& second,
               double unit) {
  const geometry::Rigid3 second_from_first =
      second.camera_from_world * first.camera_from_world.Inverse();
  if (geometry::AngleBetween_rad(second_from_first.rotation,
                                 Eigen::Quaterniond::Identity()) >
      2.0 * kMaxAngle_rad) {
    return 0.0;
  }
  const Eigen::Vector3d axis =
      second_from_first.rotation * Eigen::Vector3d::UnitZ();
  if (std::acos(std::clamp(axis.z(), -1.0, 1.0)) > kMaxAngle_rad) return 0.0;
  double best = 0.0;
  for (const double depth : kDepths) {
    int seen = 0;
    for (int y = 0; y < kGridY; ++y) {
      for (int x = 0; x < kGridX; ++x) {
        const Eigen::Vector2d pixel(
            (x + 0.5) * first.camera->width_px() / kGridX,
            (y + 0.5) * first.camera->height_px() / kGridY);
        const auto ray = first.camera->RayFromImage(pixel);
        if (!ray) continue;
        const auto projected = second.camera->ImageFromCamera(
            second_from_first * Eigen::Vector3d(depth * unit * *ray));
        seen += projected && second.camera->IsInsideImage(*projected) ? 1 : 0;
      }
    }
    best = std::max(best, static_cast<double>(seen) / (kGridX * kGridY));
  }
  return best;
}

// Normalised image points (z = 1); nullopt where the lens has none.
std::vector<std::optional<Eigen::Vector3d>> Rays(const PosedFeatures& image) {
  std::vector<std::optional<Eigen::Vector3d>> rays;
  for (const Eigen::Vector2f& keypoint : image.features->keypoints_px) {
    const auto xy = image.camera->NormalizedFromImage(keypoint.cast<double>());
    rays.push_back(xy ? std::optional(Eigen::Vector3d(xy->homogeneous()))
                      : std::nullopt);
  }
  return rays;
}

constexpr std::uint32_t kNoMatch = std::numeric_limits<std::uint32_t>::max();

// Points of an image in strips across one axis, sorted along the other: those
// near a line that crosses the strips are found without looking at the rest.
class Strips {
 public:
  // across, along: coordinates per point; NaN = no point.
  Strips(const std::vector<float>& across, const std::vector<float>& along)
      : points_(kStrips) {
    float high = -std::numeric_limits<float>::infinity();
    for (const float value : across) {
      if (!(std::abs(value) < kFar)) continue;
      low_ = std::min(low_, value);
      high = std::max(high, value);
    }
    width_ = std::max((high - low_) / kStrips, 1e-6F);
    for (std::uint32_t i = 0; i < across.size(); ++i) {
      if (!(std::abs(across[i]) < kFar)) continue;
      const auto strip = std::min<std::size_t>(
          kStrips - 1, static_cast<std::size_t>((across[i] - low_) / width_));
      points_[strip].emplace_back(along[i], i);
    }
    for (auto& strip : points_) std::sort(strip.begin(), strip.end());
  }

  // Appends the points whose `along` is within `reach` of slope * across +
  // offset, and some that are not.
  void FindNear(float slope,
                float offset,
                float reach,
                std::vector<std::uint32_t>& near) const {
    for (std::size_t s = 0; s < points_.size(); ++s) {
      const float from = low_ + static_cast<float>(s) * width_;
      const float a = slope * from + offset;
      const float b = slope * (from + width_) + offset;
      // Rounding: a strip's points may lie a little outside of it.
      const float rim = reach + 1e-4F;
      const auto first = std::lower_bound(
          points_[s].begin(),
          points_[s].end(),
          std::pair<float, std::uint32_t>(std::min(a, b) - rim, 0U));
      for (auto it = first;
           it != points_[s].end() && it->first <= std::max(a, b) + rim;
           ++it) {
        near.push_back(it->second);
      }
    }
  }

 private:
  static constexpr std::size_t kStrips = 64;
  static constexpr float kFar = 1e6F;  // of the normalised plane
  float low_ = std::numeric_limits<float>::infinity();
  float width_ = 1.0F;
  std::vector<std::vector<std::pair<float, std::uint32_t>>> points_;
};

// For each feature of `first` the best of `second` near its epipolar line.
std::vector<std::uint32_t> BestAlongLines(
    const PosedFeatures& first,
    const PosedFeatures& second,
    const std::vector<std::optional<Eigen::Vector3d>>& rays1,
    const std::vector<std::optional<Eigen::Vector3d>>& rays2,
    const EpipolarOptions& options) {
  const geometry::Rigid3 second_from_first =
      second.camera_from_world * first.camera_from_world.Inverse();
  const double focal = second.camera->mean_focal_px();
  const double max_distance = options.max_distance_px / focal;
  const auto max_squared = static_cast<int>(options.max_descriptor_distance *
                                            options.max_descriptor_distance);
  const double squared_ratio = options.ratio * options.ratio;
  std::vector<float> x2(rays2.size(), std::numeric_limits<float>::quiet_NaN());
  std::vector<float> y2(rays2.size(), std::numeric_limits<float>::quiet_NaN());
  for (std::size_t j = 0; j < rays2.size(); ++j) {
    if (!rays2[j]) continue;
    x2[j] = static_cast<float>(rays2[j]->x());
    y2[j] = static_cast<float>(rays2[j]->y());
  }
  const Strips columns(x2, y2);
  const Strips rows(y2, x2);
  std::vector<std::uint32_t> matches(rays1.size(), kNoMatch);
  std::vector<std::uint32_t> near;
  for (std::size_t i = 0; i < rays1.size(); ++i) {
    if (!rays1[i]) continue;
    const Eigen::Vector3d line = second_from_first.translation.cross(
        second_from_first.rotation * *rays1[i]);
    const double length = line.head<2>().norm();
    if (!(length > 0.0)) continue;
    const auto a = static_cast<float>(line.x() / length);
    const auto b = static_cast<float>(line.y() / length);
    const auto c = static_cast<float>(line.z() / length);
    const auto limit = static_cast<float>(max_distance);
    near.clear();
    if (std::abs(b) >= std::abs(a)) {
      columns.FindNear(-a / b, -c / b, limit / std::abs(b), near);
    } else {
      rows.FindNear(-b / a, -c / a, limit / std::abs(a), near);
    }
    std::erase_if(near, [&](std::uint32_t j) {
      return !(std::abs(a * x2[j] + b * y2[j] + c) <= limit);
    });
    std::sort(near.begin(), near.end());
    int best = std::numeric_limits<int>::max();
    std::uint32_t best_index = kNoMatch;
    std::vector<std::pair<int, std::uint32_t>> others;
    for (const std::uint32_t j : near) {
      const int distance = map::SquaredDistance(
          first.features->descriptors[i], second.features->descriptors[j]);
      others.emplace_back(distance, j);
      if (distance < best) {
        best = distance;
        best_index = j;
      }
    }
    if (best_index == kNoMatch || best > max_squared) continue;
    int second_best = std::numeric_limits<int>::max();
    const Eigen::Vector2f& at = second.features->keypoints_px[best_index];
    for (const auto& [distance, j] : others) {
      if ((second.features->keypoints_px[j] - at).norm() > kSamePlace_px) {
        second_best = std::min(second_best, distance);
      }
    }
    if (best <= squared_ratio * second_best) matches[i] = best_index;
  }
  return matches;
}

// Disjoint sets of features, numbered through all images.
class Tracks {
 public:
  explicit Tracks(std::size_t size) : parents_(size) {
    std::iota(parents_.begin(), parents_.end(), std::size_t{0});
  }
  std::size_t Find(std::size_t item) {
    while (parents_[item] != item) {
      parents_[item] = parents_[parents_[item]];
      item = parents_[item];
    }
    return item;
  }
  // The lower root wins: the result does not depend on the order.
  void Join(std::size_t a, std::size_t b) {
    a = Find(a);
    b = Find(b);
    parents_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::size_t> parents_;
};

struct FeatureId {
  std::uint32_t image = 0;
  std::uint32_t feature = 0;
};

}  // namespace

std::vector<ImagePair> ChoosePairsByOverlap(
    std::span<const PosedFeatures> images,
    std::size_t per_image,
    double min_overlap) {
  const double unit = NeighbourDistance(images);
  std::set<ImagePair> pairs;
  for (std::uint32_t i = 0; i < images.size(); ++i) {
    std::vector<std::pair<double, std::uint32_t>> overlaps;
    for (std::uint32_t j = 0; j < images.size(); ++j) {
      if (i == j) continue;
      const double overlap = std::min(Overlap(images[i], images[j], unit),
                                      Overlap(images[j], images[i], unit));
      if (overlap >= min_overlap) overlaps.emplace_back(-overlap, j);
    }
    std::sort(overlaps.begin(), overlaps.end());
    overlaps.resize(std::min(per_image, overlaps.size()));
    for (const auto& [overlap, j] : overlaps) {
      pairs.insert({std::min(i, j), std::max(i, j)});
    }
  }
  return {pairs.begin(), pairs.end()};
}

std::vector<std::array<std::uint32_t, 2>> MatchAlongEpipolarLines(
    const PosedFeatures& first,
    const PosedFeatures& second,
    const EpipolarOptions& options) {
  const auto rays1 = Rays(first);
  const auto rays2 = Rays(second);
  const std::vector<std::uint32_t> forward =
      BestAlongLines(first, second, rays1, rays2, options);
  const std::vector<std::uint32_t> back =
      BestAlongLines(second, first, rays2, rays1, options);
  std::vector<std::array<std::uint32_t, 2>> matches;
  for (std::uint32_t i = 0; i < forward.size(); ++i) {
    if (forward[i] != kNoMatch && back[forward[i]] == i) {
      matches.push_back({i, forward[i]});
    }
  }
  return matches;
}

std::size_t TriangulateTracks(std::span<const PosedFeatures> images,
                              std::span<const PairMatches> matches,
                              const TriangulationOptions& options,
                              map::MapData* data) {
  std::vector<std::size_t> first_of(images.size() + 1);
  for (std::size_t i = 0; i < images.size(); ++i) {
    first_of[i + 1] = first_of[i] + images[i].features->keypoints_px.size();
  }
  Tracks tracks(first_of.back());
  for (const PairMatches& pair : matches) {
    for (const auto& [a, b] : pair.features) {
      tracks.Join(first_of[pair.pair.first] + a,
                  first_of[pair.pair.second] + b);
    }
  }
  std::map<std::size_t, std::vector<FeatureId>> members;
  for (std::uint32_t i = 0; i < images.size(); ++i) {
    for (std::uint32_t f = 0; f < first_of[i + 1] - first_of[i]; ++f) {
      members[tracks.Find(first_of[i] + f)].push_back({i, f});
    }
  }
  std::size_t added = 0;
  for (auto& [root, track] : members) {
    for (int round = 0; round < kMaxLandmarksPerTrack && track.size() >= 2;
         ++round) {
      std::vector<Sight> sights;
      for (const FeatureId& id : track) {
        sights.push_back({images[id.image].camera,
                          images[id.image].camera_from_world,
                          images[id.image]
                              .features->keypoints_px[id.feature]
                              .cast<double>()});
      }
      const auto landmark = Triangulate(sights, options);
      if (!landmark) break;
      std::vector<FeatureId> rest;
      std::set<std::uint32_t> views;
      const auto index = static_cast<std::uint32_t>(data->landmarks.size());
      Eigen::Vector3d colour = Eigen::Vector3d::Zero();
      std::vector<FeatureId> observations;
      for (std::size_t k = 0; k < track.size(); ++k) {
        if (!landmark->is_inlier[k]) {
          rest.push_back(track[k]);
        } else if (views.insert(track[k].image).second) {
          observations.push_back(track[k]);
        }
      }
      track = std::move(rest);
      if (static_cast<int>(observations.size()) < options.min_sights) continue;
      for (const FeatureId& id : observations) {
        const ImageFeatures& features = *images[id.image].features;
        map::MapViewData& view = data->views[id.image];
        view.keypoints_px.push_back(features.keypoints_px[id.feature]);
        view.descriptors.push_back(features.descriptors[id.feature]);
        view.landmarks.push_back(index);
        for (int c = 0; c < 3; ++c) {
          colour[c] += features.rgb[id.feature][static_cast<std::size_t>(c)];
        }
      }
      colour /= static_cast<double>(observations.size());
      map::MapLandmarkData added_landmark;
      added_landmark.p_world = landmark->p_world;
      added_landmark.error_px = static_cast<float>(landmark->mean_error_px);
      for (std::size_t c = 0; c < 3; ++c) {
        added_landmark.rgb[c] = static_cast<std::uint8_t>(
            std::lround(colour[static_cast<Eigen::Index>(c)]));
      }
      data->landmarks.push_back(added_landmark);
      ++added;
    }
  }
  return added;
}

}  // namespace groundlock::build::internal
