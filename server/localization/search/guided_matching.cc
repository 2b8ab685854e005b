// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/guided_matching.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <unordered_map>

#include "map_store/map/landmark_index.h"

namespace groundlock::localization {
namespace {

// Views that look more than this away from the camera's direction share little
// with it and show other sides of things.
constexpr double kMinCosViewAngle = 0.5;

// Features in square cells of the search radius: candidates lie in 3 x 3 cells.
class FeatureGrid {
 public:
  FeatureGrid(const features::SiftFeatures& features,
              const geometry::CameraModel& camera,
              double cell_px)
      : cell_px_(cell_px),
        columns_(static_cast<int>(camera.width_px() / cell_px) + 1),
        rows_(static_cast<int>(camera.height_px() / cell_px) + 1),
        cells_(static_cast<std::size_t>(columns_) * rows_) {
    for (std::size_t i = 0; i < features.keypoints_px.size(); ++i) {
      const Eigen::Vector2d& p = features.keypoints_px[i];
      const int column = static_cast<int>(p.x() / cell_px_);
      const int row = static_cast<int>(p.y() / cell_px_);
      if (column < 0 || row < 0 || column >= columns_ || row >= rows_) continue;
      cells_[row * columns_ + column].push_back(static_cast<int>(i));
    }
  }

  template <typename Visit>
  void ForEachNear(const Eigen::Vector2d& p, Visit&& visit) const {
    const int column = static_cast<int>(p.x() / cell_px_);
    const int row = static_cast<int>(p.y() / cell_px_);
    for (int r = std::max(0, row - 1); r <= std::min(rows_ - 1, row + 1); ++r) {
      for (int c = std::max(0, column - 1);
           c <= std::min(columns_ - 1, column + 1);
           ++c) {
        for (const int feature : cells_[r * columns_ + c]) visit(feature);
      }
    }
  }

 private:
  double cell_px_;
  int columns_;
  int rows_;
  std::vector<std::vector<int>> cells_;
};

struct Candidate {
  Eigen::Vector2d projection_px;
  std::vector<const map::Descriptor*> descriptors;
};

// Landmarks of the views that project into the image, with their descriptors in
// those views.
std::vector<std::pair<std::uint32_t, Candidate>> ProjectLandmarks(
    const map::Map& map,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const GuidedMatchingOptions& options) {
  const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
  std::vector<std::pair<std::uint32_t, Candidate>> candidates;
  std::unordered_map<std::uint32_t, std::size_t> slot_of;
  for (const std::size_t index :
       NearbyViews(map, world_from_camera, options.max_views)) {
    const map::MapView& view = map.view(index);
    const auto features = map.FeaturesOf(view);
    const auto descriptors = map.DescriptorsOf(view);
    for (std::size_t i = 0; i < features.size(); ++i) {
      const std::uint32_t id = features[i].landmark;
      const map::Landmark& landmark = map.landmarks()[id];
      if (static_cast<int>(landmark.num_observations) <
          options.min_landmark_views) {
        continue;
      }
      const auto [entry, is_new] = slot_of.try_emplace(id, candidates.size());
      if (is_new) {
        const auto pixel =
            camera.ImageFromCamera(camera_from_world * landmark.Position());
        if (!pixel || !camera.IsInsideImage(*pixel)) {
          entry->second = std::numeric_limits<std::size_t>::max();
          continue;
        }
        candidates.push_back({id, {*pixel, {}}});
      }
      if (entry->second == std::numeric_limits<std::size_t>::max()) continue;
      candidates[entry->second].second.descriptors.push_back(&descriptors[i]);
    }
  }
  return candidates;
}

}  // namespace

std::vector<std::size_t> NearbyViews(const map::Map& map,
                                     const geometry::Rigid3& world_from_camera,
                                     int max_views) {
  const Eigen::Vector3d forward =
      world_from_camera.rotation * Eigen::Vector3d::UnitZ();
  std::vector<std::pair<double, std::size_t>> scored;
  for (std::size_t i = 0; i < map.num_views(); ++i) {
    const map::MapView& view = map.view(i);
    const Eigen::Vector3d view_forward =
        view.camera_from_world.rotation.conjugate() * Eigen::Vector3d::UnitZ();
    const double cos_angle = forward.dot(view_forward);
    if (cos_angle < kMinCosViewAngle) continue;
    const double distance =
        (view.center_world - world_from_camera.translation).norm();
    // A view turned by 60 degrees counts as twice as far.
    scored.emplace_back(distance / cos_angle, i);
  }
  const auto count =
      std::min(scored.size(), static_cast<std::size_t>(max_views));
  std::partial_sort(scored.begin(), scored.begin() + count, scored.end());
  std::vector<std::size_t> views;
  for (std::size_t i = 0; i < count; ++i) views.push_back(scored[i].second);
  return views;
}

std::vector<LandmarkMatch> LandmarksInView(
    const map::Map& map,
    const geometry::CameraModel& camera,
    const geometry::Rigid3& world_from_camera,
    const GuidedMatchingOptions& options) {
  std::vector<LandmarkMatch> in_view;
  for (const auto& [landmark, candidate] :
       ProjectLandmarks(map, camera, world_from_camera, options)) {
    in_view.push_back({landmark, candidate.projection_px});
  }
  return in_view;
}

std::vector<GuidedMatch> MatchGuided(const map::Map& map,
                                     const features::SiftFeatures& features,
                                     const geometry::CameraModel& camera,
                                     const geometry::Rigid3& world_from_camera,
                                     const GuidedMatchingOptions& options) {
  const FeatureGrid grid(features, camera, options.radius_px);
  const double radius_squared = options.radius_px * options.radius_px;
  const double max_squared =
      options.max_descriptor_distance * options.max_descriptor_distance;
  const double ratio_squared = options.ratio_test * options.ratio_test;

  struct Best {
    std::uint32_t landmark = 0;
    int squared_distance = std::numeric_limits<int>::max();
  };
  std::vector<Best> best_of_feature(features.keypoints_px.size());
  for (const auto& [landmark, projected] :
       ProjectLandmarks(map, camera, world_from_camera, options)) {
    // clang 14 cannot capture a structured binding.
    const Candidate& candidate = projected;
    int best = std::numeric_limits<int>::max();
    int second = std::numeric_limits<int>::max();
    int best_feature = -1;
    grid.ForEachNear(candidate.projection_px, [&](int feature) {
      if ((features.keypoints_px[feature] - candidate.projection_px)
              .squaredNorm() > radius_squared) {
        return;
      }
      int distance = std::numeric_limits<int>::max();
      for (const map::Descriptor* descriptor : candidate.descriptors) {
        distance = std::min(
            distance,
            map::SquaredDistance(*descriptor, features.descriptors[feature]));
      }
      if (distance < best) {
        // The same spot can carry two features (two orientations): they do not
        // compete.
        if (best_feature >= 0 && (features.keypoints_px[best_feature] -
                                  features.keypoints_px[feature])
                                         .squaredNorm() > 1.0) {
          second = best;
        }
        best = distance;
        best_feature = feature;
      } else if (distance < second && (features.keypoints_px[best_feature] -
                                       features.keypoints_px[feature])
                                              .squaredNorm() > 1.0) {
        second = distance;
      }
    });
    if (best_feature < 0 || best > max_squared ||
        best > ratio_squared * second) {
      continue;
    }
    Best& of_feature = best_of_feature[best_feature];
    if (best < of_feature.squared_distance) of_feature = {landmark, best};
  }

  std::vector<GuidedMatch> matches;
  for (std::size_t i = 0; i < best_of_feature.size(); ++i) {
    if (best_of_feature[i].squared_distance ==
        std::numeric_limits<int>::max()) {
      continue;
    }
    matches.push_back({{best_of_feature[i].landmark, features.keypoints_px[i]},
                       best_of_feature[i].squared_distance});
  }
  return matches;
}

}  // namespace groundlock::localization
