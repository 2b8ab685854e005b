// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/video_landmarks.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/epipolar_matching.h"
#include "map_store/build/internal/image_pairs.h"
#include "map_store/build/internal/landmark_matching.h"
#include "map_store/build/internal/track_motion.h"
#include "map_store/build/internal/track_turn.h"
#include "map_store/map/landmark_index.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::uint64_t kMaxJsonBytes = std::uint64_t{64} << 20;
// Keyframes ahead that each is matched with: near ones give sure matches, far
// ones hold the way together.
constexpr std::array<std::uint32_t, 6> kSteps = {1, 2, 4, 8, 16, 32};
constexpr std::size_t kRevisits = 3;  // per image, of those farther than that
constexpr double kMinOverlap = 0.2;
// Off an epipolar line: features themselves, and what poses drift per keyframe
// between the two.
constexpr double kFeatureGate_px = 2.5;
constexpr double kDriftGate_px = 0.1;
constexpr double kMaxGate_px = 8.0;
// Features of an image that must agree on its place, as in extending a map.
constexpr int kMinRejoined = 30;
// What was found may show more.
constexpr int kMaxRejoins = 3;

struct FeatureId {
  std::uint32_t image = 0;
  std::uint32_t feature = 0;
};

// Which images to match: by their distance in time, and those that came back.
std::vector<ImagePair> PairsOf(std::span<const PosedFeatures> posed,
                               const std::vector<std::uint32_t>& images) {
  std::set<std::pair<std::uint32_t, std::uint32_t>> overlapping;
  for (const ImagePair& pair :
       ChoosePairsByOverlap(posed, posed.size(), kMinOverlap)) {
    overlapping.emplace(images[pair.first], images[pair.second]);
  }
  std::vector<ImagePair> pairs;
  for (const auto& [first, second] : overlapping) {
    const std::uint32_t apart = second - first;
    if (std::find(kSteps.begin(), kSteps.end(), apart) != kSteps.end()) {
      pairs.push_back({first, second});
    }
  }
  // Spread over those that see the same again.
  for (const std::uint32_t image : images) {
    std::vector<std::uint32_t> again;
    for (const auto& [first, second] : overlapping) {
      if (first == image && second - first > kSteps.back()) {
        again.push_back(second);
      }
    }
    const std::size_t count = std::min(kRevisits, again.size());
    for (std::size_t i = 0; i < count; ++i) {
      pairs.push_back({image, again[i * again.size() / count]});
    }
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  return pairs;
}

// Matches to tracks with at most one feature per image: the pairs nearest in
// time join first, and what would give an image two features does not join.
std::vector<std::vector<FeatureId>> JoinMatches(
    std::span<const ImageFeatures> features, std::vector<PairMatches> matches) {
  std::stable_sort(matches.begin(),
                   matches.end(),
                   [](const PairMatches& a, const PairMatches& b) {
                     return a.pair.second - a.pair.first <
                            b.pair.second - b.pair.first;
                   });
  std::vector<std::size_t> first_of(features.size() + 1);
  for (std::size_t i = 0; i < features.size(); ++i) {
    first_of[i + 1] = first_of[i] + features[i].keypoints_px.size();
  }
  std::vector<std::size_t> track_of(first_of.back());
  std::iota(track_of.begin(), track_of.end(), std::size_t{0});
  std::vector<std::vector<FeatureId>> tracks(first_of.back());
  for (std::uint32_t i = 0; i < features.size(); ++i) {
    for (std::uint32_t f = 0; f < features[i].keypoints_px.size(); ++f) {
      tracks[first_of[i] + f] = {{i, f}};
    }
  }
  for (const PairMatches& pair : matches) {
    for (const auto& [a, b] : pair.features) {
      std::size_t to = track_of[first_of[pair.pair.first] + a];
      std::size_t from = track_of[first_of[pair.pair.second] + b];
      if (to == from) continue;
      if (tracks[to].size() < tracks[from].size()) std::swap(to, from);
      const bool collides = std::any_of(
          tracks[from].begin(), tracks[from].end(), [&](const FeatureId& id) {
            return std::any_of(tracks[to].begin(),
                               tracks[to].end(),
                               [&](const FeatureId& other) {
                                 return other.image == id.image;
                               });
          });
      if (collides) continue;
      for (const FeatureId& id : tracks[from]) {
        track_of[first_of[id.image] + id.feature] = to;
        tracks[to].push_back(id);
      }
      tracks[from].clear();
    }
  }
  std::erase_if(tracks, [](const auto& track) { return track.size() < 2; });
  for (auto& track : tracks) {
    std::sort(track.begin(), track.end(), [](const auto& a, const auto& b) {
      return a.image < b.image;
    });
  }
  return tracks;
}

class LandmarkPlacer {
 public:
  LandmarkPlacer(const FeatureTracks& tracks,
                 std::span<const ImageFeatures> features,
                 const LandmarkOptions& options,
                 VideoMotion* motion)
      : tracks_(tracks),
        features_(features),
        options_(options),
        motion_(motion) {}

  absl::StatusOr<map::MapData> Run() {
    RETURN_IF_ERROR(Match());
    RETURN_IF_ERROR(Adjust());
    for (int round = 0; round < kMaxRejoins; ++round) {
      ASSIGN_OR_RETURN(const bool has_grown, Rejoin());
      if (!has_grown) break;
      RETURN_IF_ERROR(Match());
      RETURN_IF_ERROR(Adjust());
    }
    return MakeMap();
  }

 private:
  absl::Status Progress(double fraction) const {
    if (options_.progress && !options_.progress(fraction)) {
      return absl::CancelledError("cancelled");
    }
    return absl::OkStatus();
  }
  absl::Status Match();
  absl::Status Adjust();
  // Images to which no track leads (behind a cut, a fast turn, something that
  // covered the picture) may still show places of the map: they are looked up
  // by their features, and tracks go on from there. False: none was found.
  absl::StatusOr<bool> Rejoin();
  map::MapData MakeMap() const;

  const FeatureTracks& tracks_;
  const std::span<const ImageFeatures> features_;
  const LandmarkOptions& options_;
  VideoMotion* const motion_;
  std::vector<std::vector<FeatureId>> feature_tracks_;
  std::optional<TrackScene> scene_;
};

absl::Status LandmarkPlacer::Match() {
  std::vector<PosedFeatures> posed;
  std::vector<std::uint32_t> images;
  std::vector<std::size_t> place(features_.size());
  for (std::uint32_t i = 0; i < features_.size(); ++i) {
    if (!motion_->camera_from_world[i]) continue;
    place[i] = posed.size();
    images.push_back(i);
    posed.push_back(
        {&features_[i], &motion_->camera, *motion_->camera_from_world[i]});
  }
  const std::vector<ImagePair> pairs = PairsOf(posed, images);
  std::vector<PairMatches> matches(pairs.size());
  RETURN_IF_ERROR(ForEachInParallel(
      pairs.size(),
      options_.threads,
      [&](std::size_t i) {
        const ImagePair& pair = pairs[i];
        EpipolarOptions matching;
        matching.max_distance_px = std::min(
            kMaxGate_px,
            kFeatureGate_px + kDriftGate_px * (pair.second - pair.first));
        matches[i] = {
            pair,
            MatchAlongEpipolarLines(
                posed[place[pair.first]], posed[place[pair.second]], matching)};
        return absl::OkStatus();
      },
      [&](std::size_t done) {
        return Progress(
                   0.6 * static_cast<double>(done) /
                   static_cast<double>(std::max<std::size_t>(1, pairs.size())))
            .ok();
      }));
  feature_tracks_ = JoinMatches(features_, std::move(matches));
  return absl::OkStatus();
}

absl::Status LandmarkPlacer::Adjust() {
  FeatureTracks all = tracks_;
  for (const std::vector<FeatureId>& ids : feature_tracks_) {
    FeatureTrack& track = all.tracks.emplace_back();
    for (const FeatureId& id : ids) {
      track.push_back({id.image, features_[id.image].keypoints_px[id.feature]});
    }
  }
  scene_.emplace(
      all,
      options_.lens_is_known ? std::optional(motion_->camera) : std::nullopt);
  TrackScene& scene = *scene_;
  if (!options_.lens_is_known) {
    scene.lens = {motion_->camera.mean_focal_px(),
                  motion_->camera.params().back()};
  }
  scene.camera_from_world = motion_->camera_from_world;
  scene.turn_of = FindTurns(scene);
  TrackScene::Adjustment adjustment;
  adjustment.focal = true;
  adjustment.distortion = true;
  adjustment.threads = options_.threads;
  adjustment.max_iterations = 15;
  adjustment.is_cancelled = [this] { return !Progress(0.8).ok(); };
  scene.Triangulate(std::nullopt, 3);
  for (int round = 0; round < 2; ++round) {
    if (round == 1 && !options_.lens_is_known) {
      motion_->focal_sigma_px = scene.SettleLens(adjustment);
      if (!motion_->focal_sigma_px) return absl::CancelledError("cancelled");
    } else if (!scene.Adjust(adjustment)) {
      return absl::CancelledError("cancelled");
    }
    scene.Filter(3);
    scene.Triangulate(std::nullopt, 3);
    // What the tracks alone did not place.
    for (std::uint32_t i = 0; i < scene.num_images(); ++i) {
      if (!scene.camera_from_world[i] && scene.Resect(i)) {
        scene.Triangulate(i, 3);
      }
    }
  }
  scene.Filter(3);
  motion_->camera_from_world = scene.camera_from_world;
  if (!options_.lens_is_known) {
    ASSIGN_OR_RETURN(motion_->camera,
                     geometry::CameraModel::Create(
                         geometry::CameraModelId::kSimpleRadial,
                         tracks_.width_px,
                         tracks_.height_px,
                         std::array<double, 4>{scene.lens.focal_px,
                                               0.5 * tracks_.width_px,
                                               0.5 * tracks_.height_px,
                                               scene.lens.k}));
  }
  return Progress(1.0);
}

absl::StatusOr<bool> LandmarkPlacer::Rejoin() {
  std::vector<std::uint32_t> lost;
  for (std::uint32_t i = 0; i < features_.size(); ++i) {
    if (!scene_->camera_from_world[i]) lost.push_back(i);
  }
  if (lost.empty()) return false;
  const map::MapData data = MakeMap();
  if (data.landmarks.empty()) return false;
  const map::LandmarkIndexData index_data =
      map::BuildLandmarkIndex(data, options_.min_views);
  const map::LandmarkIndex index = map::ViewOf(index_data);
  std::vector<std::optional<FoundPose>> found(lost.size());
  RETURN_IF_ERROR(ForEachInParallel(
      lost.size(),
      options_.threads,
      [&](std::size_t i) {
        found[i] = FindPose(
            features_[lost[i]], motion_->camera, data, index, kMinRejoined);
        return absl::OkStatus();
      },
      [this](std::size_t /*done*/) { return Progress(0.9).ok(); }));
  bool has_grown = false;
  for (std::size_t i = 0; i < lost.size(); ++i) {
    if (!found[i]) continue;
    scene_->camera_from_world[lost[i]] = found[i]->camera_from_world;
    has_grown = true;
  }
  if (!has_grown) return false;
  scene_->Triangulate(std::nullopt, 3);
  RETURN_IF_ERROR(GrowScene(
      options_.threads,
      [this](const std::string& /*what*/) { return Progress(0.9).ok(); },
      *scene_));
  motion_->camera_from_world = scene_->camera_from_world;
  return true;
}

map::MapData LandmarkPlacer::MakeMap() const {
  const TrackScene& scene = *scene_;
  map::MapData data;
  data.source_format = "video";
  data.cameras = {motion_->camera};
  std::vector<std::size_t> view_of(features_.size());
  for (std::uint32_t i = 0; i < features_.size(); ++i) {
    if (!scene.camera_from_world[i]) continue;
    view_of[i] = data.views.size();
    map::MapViewData& view = data.views.emplace_back();
    view.name = features_[i].name;
    view.camera_from_world = *scene.camera_from_world[i];
  }
  for (std::size_t t = 0; t < feature_tracks_.size(); ++t) {
    const TrackScene::Point& point = scene.points[tracks_.tracks.size() + t];
    if (!point.p_world) continue;
    std::vector<FeatureId> seen;
    for (const TrackScene::Sight& sight : point.sights) {
      if (!sight.fits || !scene.camera_from_world[sight.image]) continue;
      for (const FeatureId& id : feature_tracks_[t]) {
        if (id.image == sight.image) seen.push_back(id);
      }
    }
    if (static_cast<int>(seen.size()) < options_.min_views) continue;
    const auto index = static_cast<std::uint32_t>(data.landmarks.size());
    map::MapLandmarkData& landmark = data.landmarks.emplace_back();
    landmark.p_world = *point.p_world;
    Eigen::Vector3d colour = Eigen::Vector3d::Zero();
    double error_px = 0.0;
    for (const FeatureId& id : seen) {
      const ImageFeatures& image = features_[id.image];
      map::MapViewData& view = data.views[view_of[id.image]];
      view.keypoints_px.push_back(image.keypoints_px[id.feature]);
      view.descriptors.push_back(image.descriptors[id.feature]);
      view.landmarks.push_back(index);
      for (int c = 0; c < 3; ++c) {
        colour[c] += image.rgb[id.feature][static_cast<std::size_t>(c)];
      }
      if (const auto pixel = motion_->camera.ImageFromCamera(
              view.camera_from_world * landmark.p_world)) {
        error_px +=
            (*pixel - image.keypoints_px[id.feature].cast<double>()).norm();
      }
    }
    colour /= static_cast<double>(seen.size());
    landmark.error_px =
        static_cast<float>(error_px / static_cast<double>(seen.size()));
    for (std::size_t c = 0; c < 3; ++c) {
      landmark.rgb[c] = static_cast<std::uint8_t>(
          std::lround(colour[static_cast<Eigen::Index>(c)]));
    }
  }
  return data;
}

}  // namespace

absl::Status WriteMotion(const VideoMotion& motion, const fs::path& path) {
  json images = json::array();
  for (const auto& pose : motion.camera_from_world) {
    if (!pose) {
      images.push_back(nullptr);
      continue;
    }
    const Eigen::Quaterniond& q = pose->rotation;
    const Eigen::Vector3d& t = pose->translation;
    images.push_back({q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()});
  }
  const json object = {
      {"camera", json::parse(geometry::CameraModelToJson(motion.camera))},
      {"focal_sigma_px",
       motion.focal_sigma_px ? json(*motion.focal_sigma_px) : json()},
      {"camera_from_world", images},
      {"notes", motion.notes},
      {"lens_doubt", motion.lens_doubt}};
  return base::WriteFileAtomically(path, object.dump());
}

absl::StatusOr<VideoMotion> ReadMotion(const fs::path& path) {
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(path, kMaxJsonBytes));
  const json object = json::parse(text, nullptr, /*allow_exceptions=*/false);
  const auto damaged = [&path](const char* what) {
    return absl::DataLossError(
        absl::StrCat(path.string(), ": damaged (", what, ")"));
  };
  if (!object.is_object() || !object.contains("camera") ||
      !object.contains("camera_from_world") ||
      !object["camera_from_world"].is_array()) {
    return damaged("not what a build wrote");
  }
  VideoMotion motion;
  ASSIGN_OR_RETURN(motion.camera,
                   geometry::CameraModelFromJson(object["camera"].dump()));
  if (const json sigma = object.value("focal_sigma_px", json());
      sigma.is_number()) {
    motion.focal_sigma_px = sigma.get<double>();
  }
  for (const json& note : object.value("notes", json::array())) {
    if (!note.is_string()) return damaged("a note");
    motion.notes.push_back(note.get<std::string>());
  }
  if (const json doubt = object.value("lens_doubt", json(""));
      doubt.is_string()) {
    motion.lens_doubt = doubt.get<std::string>();
  } else {
    return damaged("what is said of the lens");
  }
  for (const json& pose : object["camera_from_world"]) {
    auto& target = motion.camera_from_world.emplace_back();
    if (pose.is_null()) continue;
    if (!pose.is_array() || pose.size() != 7) return damaged("a pose");
    std::array<double, 7> v{};
    for (std::size_t i = 0; i < 7; ++i) {
      if (!pose[i].is_number()) return damaged("a pose");
      v[i] = pose[i].get<double>();
    }
    const Eigen::Quaterniond q(v[0], v[1], v[2], v[3]);
    if (!(q.norm() > 0.5)) return damaged("a pose");
    target = geometry::Rigid3{q.normalized(), {v[4], v[5], v[6]}};
  }
  return motion;
}

absl::StatusOr<map::MapData> PlaceLandmarks(
    const FeatureTracks& tracks,
    std::span<const ImageFeatures> features,
    const LandmarkOptions& options,
    VideoMotion* motion) {
  if (features.size() != tracks.num_images ||
      motion->camera_from_world.size() != features.size()) {
    return absl::DataLossError(
        "tracks, motion and images of the build differ in number");
  }
  return LandmarkPlacer(tracks, features, options, motion).Run();
}

}  // namespace groundlock::build::internal
