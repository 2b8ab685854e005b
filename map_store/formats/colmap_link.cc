// SPDX-License-Identifier: Apache-2.0
// From COLMAP's ids to our indices.
#include <algorithm>
#include <cmath>

#include "absl/container/flat_hash_map.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/colmap_model.h"

namespace groundlock::formats::internal {
namespace {

using base::Abseil;

constexpr std::size_t kMaxNameBytes = 4'096;

template <typename Id>
using IndexById = absl::flat_hash_map<Id, std::uint32_t>;

// Sorts `items` by id, which makes the result independent of the file's order
// (COLMAP writes hash maps as they come), and indexes them.
template <typename Item, typename Id>
absl::Status SortAndIndex(std::string_view what,
                          std::vector<Item>* items,
                          IndexById<Id>* index_by_id) {
  std::sort(items->begin(), items->end(), [](const Item& a, const Item& b) {
    return a.id < b.id;
  });
  index_by_id->reserve(items->size());
  for (std::uint32_t i = 0; i < items->size(); ++i) {
    if (!index_by_id->emplace((*items)[i].id, i).second) {
      return absl::InvalidArgumentError(absl::StrCat(
          Abseil(what), " ", (*items)[i].id, " is there more than once"));
    }
  }
  return absl::OkStatus();
}

// Tracks (points3D) and features (images) state the same relation. Every
// element must point into the model; where the two disagree the images win, as
// they do when COLMAP reads a model, and the user is told.
absl::Status CheckTracks(const std::vector<ColmapPoint>& points,
                         const std::vector<ColmapTrackElement>& tracks,
                         const std::vector<ColmapImage>& images,
                         const IndexById<std::uint32_t>& image_by_id,
                         std::vector<std::string>* warnings) {
  std::uint64_t num_features = 0;
  for (const ColmapImage& image : images) num_features += image.features.size();
  std::uint64_t num_agreeing = 0;
  std::size_t next = 0;
  for (const ColmapPoint& point : points) {
    for (std::uint64_t i = 0; i < point.track_length; ++i, ++next) {
      const ColmapTrackElement& element = tracks[next];
      const auto found = image_by_id.find(element.image_id);
      if (found == image_by_id.end() ||
          element.index >= images[found->second].num_points2d) {
        return absl::InvalidArgumentError(
            absl::StrCat("point ",
                         point.id,
                         " is observed by 2D point ",
                         element.index,
                         " of image ",
                         element.image_id,
                         ", which is not in the model"));
      }
      const std::vector<ColmapFeature>& features =
          images[found->second].features;
      const auto feature =
          std::lower_bound(features.begin(),
                           features.end(),
                           element.index,
                           [](const ColmapFeature& f, std::uint32_t at) {
                             return f.index < at;
                           });
      if (feature != features.end() && feature->index == element.index &&
          feature->point_id == point.id) {
        ++num_agreeing;
      }
    }
  }
  if (num_agreeing != num_features || tracks.size() != num_features) {
    warnings->push_back(
        absl::StrCat("the model contradicts itself: its images hold ",
                     num_features,
                     " observations, the tracks of its points ",
                     tracks.size(),
                     ", and ",
                     num_agreeing,
                     " agree; those of the images were taken"));
  }
  return absl::OkStatus();
}

absl::Status LinkView(ColmapImage image,
                      const IndexById<std::uint32_t>& camera_by_id,
                      const IndexById<std::uint64_t>& point_by_id,
                      map::MapViewData* view,
                      FeatureOrigin* origin) {
  const auto camera = camera_by_id.find(image.camera_id);
  if (camera == camera_by_id.end()) {
    return absl::InvalidArgumentError(absl::StrCat("image ",
                                                   image.name,
                                                   ": camera ",
                                                   image.camera_id,
                                                   " is not in the model"));
  }
  view->name = std::move(image.name);
  view->camera = camera->second;
  view->camera_from_world = image.camera_from_world;
  origin->num_features = image.num_points2d;
  view->keypoints_px.reserve(image.features.size());
  view->landmarks.reserve(image.features.size());
  origin->index.reserve(image.features.size());
  for (const ColmapFeature& feature : image.features) {
    const auto point = point_by_id.find(feature.point_id);
    if (point == point_by_id.end()) {
      return absl::InvalidArgumentError(absl::StrCat("image ",
                                                     view->name,
                                                     ": 2D point ",
                                                     feature.index,
                                                     " observes point ",
                                                     feature.point_id,
                                                     ", which is not there"));
    }
    view->keypoints_px.push_back(feature.xy_px);
    view->landmarks.push_back(point->second);
    origin->index.push_back(feature.index);
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<geometry::Rigid3> RigidFromFile(
    const std::array<double, 4>& q_wxyz, const std::array<double, 3>& t) {
  geometry::Rigid3 rigid;
  rigid.rotation =
      Eigen::Quaterniond(q_wxyz[0], q_wxyz[1], q_wxyz[2], q_wxyz[3]);
  rigid.translation = Eigen::Vector3d(t[0], t[1], t[2]);
  if (!rigid.IsFinite()) {
    return absl::InvalidArgumentError("the pose is not finite");
  }
  // Files hold unit quaternions to their printed digits; far off is damage.
  const double norm = rigid.rotation.norm();
  if (!(norm > 1e-3 && norm < 1e3)) {
    return absl::InvalidArgumentError(
        absl::StrCat("the rotation is no quaternion: its norm is ", norm));
  }
  rigid.rotation.normalize();
  return rigid;
}

absl::Status CheckImageName(std::string_view name) {
  if (name.empty()) return absl::InvalidArgumentError("the name is empty");
  if (name.size() > kMaxNameBytes) {
    return absl::InvalidArgumentError("the name is too long");
  }
  for (const char c : name) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) {
      return absl::InvalidArgumentError("the name has control characters");
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<LinkedModel> LinkColmapModel(
    ColmapModel model, std::vector<std::string>* warnings) {
  constexpr auto kMaxIndex = std::numeric_limits<std::uint32_t>::max();
  if (model.points.size() >= kMaxIndex || model.images.size() >= kMaxIndex) {
    return absl::InvalidArgumentError("the model has more than 2^32 items");
  }
  // Tracks lie in the order of the points as read: check them before sorting.
  IndexById<std::uint32_t> camera_by_id;
  IndexById<std::uint32_t> image_by_id;
  IndexById<std::uint64_t> point_by_id;
  RETURN_IF_ERROR(SortAndIndex("camera", &model.cameras, &camera_by_id));
  RETURN_IF_ERROR(SortAndIndex("image", &model.images, &image_by_id));
  RETURN_IF_ERROR(CheckTracks(
      model.points, model.tracks, model.images, image_by_id, warnings));
  std::vector<ColmapTrackElement>().swap(model.tracks);
  RETURN_IF_ERROR(SortAndIndex("point", &model.points, &point_by_id));

  LinkedModel linked;
  linked.data.source_format = "colmap";
  for (const ColmapCamera& camera : model.cameras) {
    linked.data.cameras.push_back(camera.camera);
  }
  linked.data.landmarks.reserve(model.points.size());
  for (const ColmapPoint& point : model.points) {
    linked.data.landmarks.push_back(point.landmark);
  }
  linked.data.views.resize(model.images.size());
  linked.origins.resize(model.images.size());
  for (std::size_t i = 0; i < model.images.size(); ++i) {
    RETURN_IF_ERROR(LinkView(std::move(model.images[i]),
                             camera_by_id,
                             point_by_id,
                             &linked.data.views[i],
                             &linked.origins[i]));
  }
  return linked;
}

}  // namespace groundlock::formats::internal
