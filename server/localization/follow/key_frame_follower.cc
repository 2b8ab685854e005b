// SPDX-License-Identifier: Apache-2.0
#include "server/localization/follow/key_frame_follower.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <optional>

#include "server/image/frame.h"
#include "server/image/patch_flow.h"
#include "server/localization/follow/blurred_patch.h"
#include "server/localization/solvers/pose_estimate.h"
#include "server/localization/solvers/robust_pose.h"

namespace groundlock::localization {
namespace {

constexpr int kNearMaxLevel = 3;
// Landmarks that tell where the others are, if this share of them agrees; the
// others then are found without the coarser levels.
constexpr std::size_t kSketchLandmarks = 32;
constexpr double kMinSketchShare = 0.4;
constexpr int kSketchedMaxLevel = 0;
constexpr std::size_t kFarLandmarks = 64;
constexpr int kMaxIterations = 12;
constexpr double kEpsilonPx = 0.02;
// Mean absolute difference of the patches, 8-bit levels: above it the patch
// shows something else (an occluder), though Lucas-Kanade converged.
constexpr double kMaxPatchDifference = 24.0;
constexpr int kBorderPx = 4;
constexpr int kGridColumns = 16;
constexpr int kGridRows = 9;
// Pixels that a landmark moves while a frame is exposed, below which
// Lucas-Kanade is as good.
constexpr double kMinBlurPx = 2.0;
// Patches that are looked at for the exposure time.
constexpr std::size_t kExposurePatches = 8;

Eigen::Vector2d ToOpenCv(const Eigen::Vector2d& pixel_px) {
  return pixel_px.array() - static_cast<double>(image::kPixelCenter);
}

Eigen::Vector2d FromOpenCv(const Eigen::Vector2d& point) {
  return point.array() + static_cast<double>(image::kPixelCenter);
}

cv::Point2d ToPoint(const Eigen::Vector2d& pixel_px) {
  return {pixel_px.x(), pixel_px.y()};
}

// How landmarks are seen from two places by a camera that moves.
class PairBuilder {
 public:
  // Blurs are those of `exposure_s`.
  PairBuilder(const geometry::CameraModel& camera,
              const KeyFrame& key_frame,
              const MovingCamera& current,
              double exposure_s)
      : camera_(camera),
        key_(PlaceOf(key_frame.world_from_camera, key_frame.velocity_s)),
        current_(PlaceOf(current.world_from_camera, current.velocity_s)),
        exposure_s_(exposure_s) {}

  std::optional<PatchPair> Pair(const LandmarkMatch& in_key,
                                const Eigen::Vector3d& p_world) const {
    PatchPair pair;
    pair.key_point = ToOpenCv(in_key.pixel_px);
    const auto key_velocity = Velocity_px_s(key_, p_world);
    const auto current_velocity = Velocity_px_s(current_, p_world);
    const auto axes = KeyFromCurrent(p_world);
    if (!key_velocity || !current_velocity || !axes) return std::nullopt;
    pair.key_from_current = *axes;
    pair.key_blur = exposure_s_ * *key_velocity;
    pair.current_blur = exposure_s_ * *current_velocity;
    return pair;
  }

 private:
  static constexpr double kHalfStep_s = 1e-3;

  struct Place {
    geometry::Rigid3 world_from_camera;
    geometry::Rigid3 camera_from_world;
    geometry::Rigid3 before_from_world;
    geometry::Rigid3 after_from_world;
  };

  static Place PlaceOf(const geometry::Rigid3& pose,
                       const geometry::Vector6d& velocity_s) {
    return {pose,
            pose.Inverse(),
            MovePose(pose, -kHalfStep_s * velocity_s).Inverse(),
            MovePose(pose, kHalfStep_s * velocity_s).Inverse()};
  }

  std::optional<Eigen::Vector2d> Velocity_px_s(
      const Place& place, const Eigen::Vector3d& p_world) const {
    const auto before =
        camera_.ImageFromCamera(place.before_from_world * p_world);
    const auto after =
        camera_.ImageFromCamera(place.after_from_world * p_world);
    if (!before || !after) return std::nullopt;
    return (*after - *before) / (2.0 * kHalfStep_s);
  }

  // A surface that faces the camera.
  std::optional<Eigen::Matrix2d> KeyFromCurrent(
      const Eigen::Vector3d& p_world) const {
    const Eigen::Vector3d p_current = current_.camera_from_world * p_world;
    const Eigen::Vector3d forward = p_current.normalized();
    const Eigen::Vector3d right =
        Eigen::Vector3d::UnitY().cross(forward).normalized();
    const Eigen::Vector3d down = forward.cross(right);
    // About the width of a patch.
    const double step = 6.0 / camera_.mean_focal_px() * p_current.norm();
    Eigen::Matrix2d in_current;
    Eigen::Matrix2d in_key;
    for (int i = 0; i < 2; ++i) {
      const Eigen::Vector3d aside = step * (i == 0 ? right : down);
      for (const double sign : {-1.0, 1.0}) {
        const Eigen::Vector3d point = p_current + sign * aside;
        const auto here = camera_.ImageFromCamera(point);
        const auto there = camera_.ImageFromCamera(
            key_.camera_from_world * (current_.world_from_camera * point));
        if (!here || !there) return std::nullopt;
        if (sign < 0.0) {
          in_current.col(i) = -*here;
          in_key.col(i) = -*there;
        } else {
          in_current.col(i) += *here;
          in_key.col(i) += *there;
        }
      }
    }
    if (!(std::abs(in_current.determinant()) > 1.0)) return std::nullopt;
    return in_key * in_current.inverse();
  }

  const geometry::CameraModel& camera_;
  Place key_;
  Place current_;
  double exposure_s_;
};

// The image itself.
const cv::Mat& Finest(const image::LumaPyramid& pyramid) {
  return pyramid.levels.front();
}

// Looks for the key frame's landmarks in the current frame.
struct LandmarkSearch {
  const LandmarkTable& table;
  const KeyFrame& key_frame;
  const image::LumaPyramid& current;
  const geometry::CameraModel& camera;

  // A few of the landmarks that should be in view, spread as they are.
  std::vector<FollowedLandmark> Sample(const MovingCamera& predicted,
                                       std::size_t count) const {
    const geometry::Rigid3 camera_from_world =
        predicted.world_from_camera.Inverse();
    std::vector<FollowedLandmark> sample;
    for (const FollowedLandmark& landmark : key_frame.landmarks) {
      if (sample.size() == count) break;
      if (PixelOf(landmark, camera_from_world)) sample.push_back(landmark);
    }
    return sample;
  }

  // From where `predicted` projects them, down from level `max_level`.
  std::vector<FollowedLandmark> Follow(
      std::span<const FollowedLandmark> landmarks,
      const MovingCamera& predicted,
      int max_level) const {
    const geometry::Rigid3 camera_from_world =
        predicted.world_from_camera.Inverse();
    image::PatchFlowOptions options;
    options.coarsest_level = max_level;
    options.max_iterations = kMaxIterations;
    options.epsilon_px = kEpsilonPx;
    std::vector<FollowedLandmark> found;
    found.reserve(landmarks.size());
    const PairBuilder pairs(camera, key_frame, predicted, predicted.exposure_s);
    for (const FollowedLandmark& landmark : landmarks) {
      const LandmarkMatch& match = landmark.match;
      const auto guess_px = PixelOf(landmark, camera_from_world);
      if (!guess_px) continue;
      const auto flow = image::FollowPatch(*key_frame.pyramid,
                                           current,
                                           ToPoint(match.pixel_px),
                                           ToPoint(*guess_px),
                                           options);
      if (!flow || flow->difference > kMaxPatchDifference) continue;
      Eigen::Vector2d pixel_px(flow->point_px.x, flow->point_px.y);
      if (predicted.exposure_s > 0.0) {
        const auto pair = pairs.Pair(match, table.Position(match.landmark));
        if (!pair) continue;
        if (std::max(pair->key_blur.norm(), pair->current_blur.norm()) >
            kMinBlurPx) {
          const auto aligned = AlignPatch(Finest(*key_frame.pyramid),
                                          Finest(current),
                                          *pair,
                                          ToOpenCv(pixel_px));
          if (!aligned) continue;
          pixel_px = FromOpenCv(*aligned);
        }
      }
      if (!camera.IsInsideImage(pixel_px, kBorderPx)) continue;
      found.push_back({{match.landmark, pixel_px}, landmark.is_anchored});
    }
    return found;
  }

  // The camera where a few landmarks see it; nullopt if they do not agree.
  std::optional<MovingCamera> Sketch(const MovingCamera& predicted) const {
    const std::vector<FollowedLandmark> sample =
        Sample(predicted, kSketchLandmarks);
    // Good enough to start from without a look at the blur.
    MovingCamera sketched = predicted;
    sketched.exposure_s = 0.0;
    std::vector<PoseObservation> observations;
    observations.reserve(sample.size());
    for (const FollowedLandmark& landmark :
         Follow(sample, sketched, kNearMaxLevel)) {
      observations.push_back({table.Position(landmark.match.landmark),
                              landmark.match.pixel_px,
                              1.0});
    }
    RobustPoseOptions refinement;
    refinement.expected = predicted.Expected();
    const auto pose = RefinePoseRobustly(
        camera, observations, predicted.world_from_camera, refinement);
    if (!pose || pose->num_inliers <
                     kMinSketchShare * static_cast<double>(sample.size())) {
      return std::nullopt;
    }
    sketched.exposure_s = predicted.exposure_s;
    sketched.world_from_camera = pose->world_from_camera;
    return sketched;
  }

 private:
  std::optional<Eigen::Vector2d> PixelOf(
      const FollowedLandmark& landmark,
      const geometry::Rigid3& camera_from_world) const {
    const auto pixel_px = camera.ImageFromCamera(
        camera_from_world * table.Position(landmark.match.landmark));
    if (!pixel_px || !camera.IsInsideImage(*pixel_px, kBorderPx)) {
      return std::nullopt;
    }
    return pixel_px;
  }
};

}  // namespace

std::vector<LandmarkMatch> MatchesOf(
    std::span<const FollowedLandmark> landmarks) {
  std::vector<LandmarkMatch> matches;
  matches.reserve(landmarks.size());
  for (const FollowedLandmark& landmark : landmarks) {
    matches.push_back(landmark.match);
  }
  return matches;
}

std::vector<FollowedLandmark> SpreadOverImage(
    const LandmarkTable& table,
    std::span<const FollowedLandmark> followed,
    cv::Size size_px,
    int max_landmarks) {
  std::vector<std::vector<const FollowedLandmark*>> cells(kGridColumns *
                                                          kGridRows);
  for (const FollowedLandmark& landmark : followed) {
    const Eigen::Vector2d& pixel_px = landmark.match.pixel_px;
    const int column = std::clamp(
        static_cast<int>(pixel_px.x() * kGridColumns / size_px.width),
        0,
        kGridColumns - 1);
    const int row =
        std::clamp(static_cast<int>(pixel_px.y() * kGridRows / size_px.height),
                   0,
                   kGridRows - 1);
    cells[row * kGridColumns + column].push_back(&landmark);
  }
  std::size_t deepest = 0;
  for (auto& cell : cells) {
    std::sort(cell.begin(), cell.end(), [&](const auto* a, const auto* b) {
      if (a->is_anchored != b->is_anchored) return a->is_anchored;
      const auto views_a = table.NumViews(a->match.landmark);
      const auto views_b = table.NumViews(b->match.landmark);
      return views_a != views_b ? views_a > views_b
                                : a->match.landmark < b->match.landmark;
    });
    deepest = std::max(deepest, cell.size());
  }
  std::vector<FollowedLandmark> chosen;
  const auto limit = static_cast<std::size_t>(max_landmarks);
  for (std::size_t depth = 0; depth < deepest; ++depth) {
    for (const auto& cell : cells) {
      if (depth < cell.size() && chosen.size() < limit) {
        chosen.push_back(*cell[depth]);
      }
    }
  }
  return chosen;
}

std::vector<FollowedLandmark> FollowLandmarks(
    const LandmarkTable& table,
    const KeyFrame& key_frame,
    const image::LumaPyramid& current,
    const geometry::CameraModel& camera,
    const MovingCamera& predicted,
    Reach reach) {
  const LandmarkSearch search{table, key_frame, current, camera};
  if (reach == Reach::kFar) {
    return search.Follow(search.Sample(predicted, kFarLandmarks),
                         predicted,
                         image::LumaPyramid::kMaxLevel);
  }
  if (reach == Reach::kUncertain) {
    return search.Follow(key_frame.landmarks, predicted, kNearMaxLevel);
  }
  const auto sketched = search.Sketch(predicted);
  if (!sketched) return {};
  return search.Follow(key_frame.landmarks, *sketched, kSketchedMaxLevel);
}

void ObserveExposure(const LandmarkTable& table,
                     const KeyFrame& key_frame,
                     const image::LumaPyramid& current,
                     const geometry::CameraModel& camera,
                     const MovingCamera& moving,
                     std::span<const FollowedLandmark> followed,
                     ExposureEstimate& exposure) {
  if (followed.empty() || key_frame.landmarks.empty()) return;
  const PairBuilder pairs(camera, key_frame, moving, /*exposure_s=*/1.0);
  const geometry::Rigid3 camera_from_world = moving.world_from_camera.Inverse();
  const std::size_t stride =
      (followed.size() + kExposurePatches - 1) / kExposurePatches;
  std::vector<MovingPatch> patches;
  for (std::size_t i = 0; i < followed.size(); i += stride) {
    const std::uint32_t id = followed[i].match.landmark;
    const auto in_key = std::find_if(
        key_frame.landmarks.begin(),
        key_frame.landmarks.end(),
        [&](const FollowedLandmark& one) { return one.match.landmark == id; });
    if (in_key == key_frame.landmarks.end()) continue;
    const Eigen::Vector3d p_world = table.Position(id);
    const auto pair = pairs.Pair(in_key->match, p_world);
    // Where all landmarks together put it: its own place may be what the blur
    // has shifted.
    const auto pixel_px = camera.ImageFromCamera(camera_from_world * p_world);
    if (!pair || !pixel_px || !ExposureEstimate::Tells(*pair)) continue;
    patches.push_back({*pair, ToOpenCv(*pixel_px)});
  }
  exposure.Observe(Finest(*key_frame.pyramid), Finest(current), patches);
}

}  // namespace groundlock::localization
