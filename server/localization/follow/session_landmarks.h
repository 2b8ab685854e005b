// SPDX-License-Identifier: Apache-2.0
// Landmarks of a session's own, where the map has none: image corners,
// triangulated from the poses of the last seconds. By them the camera is
// followed past the map's end (odometry).
#ifndef GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_SESSION_LANDMARKS_H_
#define GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_SESSION_LANDMARKS_H_

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <unordered_map>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "server/image/luma_pyramid.h"
#include "server/localization/localizer.h"

namespace groundlock::localization {

// A landmark lies on the ray of the pixel in which it was first seen; how far
// away is known as an inverse depth, which is Gaussian even for what is hardly
// known, and zero for what is at infinity (Civera, Davison & Montiel 2008). It
// is estimated from all frames in which the landmark was observed, whose poses
// are taken as they were. Ids begin where those of the map's landmarks end.
// Not thread-safe.
class SessionLandmarks {
 public:
  explicit SessionLandmarks(std::uint32_t first_id)
      : first_id_(first_id), next_id_(first_id) {}

  bool Owns(std::uint32_t id) const { return id >= first_id_; }
  bool Has(std::uint32_t id) const { return landmarks_.contains(id); }
  std::size_t size() const { return landmarks_.size(); }
  // Of one that it has.
  const Eigen::Vector3d& Position(std::uint32_t id) const {
    return landmarks_.at(id).p_world;
  }

  struct Sighting {
    Eigen::Vector2d pixel_px;
    double depth = 1.0;           // along the optical axis, roughly
    double relative_sigma = 1.0;  // of its inverse
  };
  // Observed in a frame for the first time.
  std::vector<LandmarkMatch> Add(const geometry::CameraModel& camera,
                                 const geometry::Rigid3& world_from_camera,
                                 std::span<const Sighting> sightings);
  // Observed in another frame: triangulates anew. What was not where a thing at
  // rest would be is removed.
  void Observe(const geometry::CameraModel& camera,
               const geometry::Rigid3& world_from_camera,
               std::span<const LandmarkMatch> seen);
  // Variance per axis, px^2, of how far the landmark moves in the image between
  // two places of the camera, for what is not known of its depth; nullopt if it
  // is behind either.
  std::optional<double> ParallaxVariance_px2(
      const geometry::CameraModel& camera,
      const geometry::Rigid3& a_from_world,
      const geometry::Rigid3& b_from_world,
      std::uint32_t id) const;
  // Of the inverse depth of one that it has, over itself.
  double RelativeSigma(std::uint32_t id) const;
  // Forgets all but these.
  void Keep(std::span<const LandmarkMatch> kept);
  // The frames were elsewhere, all by the same motion, and with them the
  // landmarks.
  void Move(const geometry::Rigid3& moved_from_before);
  void Clear();

 private:
  friend struct StateFields;

  struct Observation {
    std::uint64_t frame = 0;
    Eigen::Vector2d pixel_px;
  };
  struct Landmark {
    geometry::Rigid3 world_from_host;  // the frame in which it was first seen
    // (x, y, 1) / inverse_depth in the host's axes.
    Eigen::Vector2d normalized = Eigen::Vector2d::Zero();
    double inverse_depth = 1.0;
    double prior_inverse_depth = 1.0;
    double prior_sigma = 1.0;
    double inverse_depth_sigma = 1.0;
    Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
    std::vector<Observation> observations;

    Eigen::Vector3d At(double its_inverse_depth) const;
  };

  // False if it does not rest.
  bool Triangulate(const geometry::CameraModel& camera, Landmark& landmark);

  std::uint32_t first_id_;
  std::uint32_t next_id_;
  std::unordered_map<std::uint32_t, Landmark> landmarks_;
  // world_from_camera of the frames from `first_frame_` on.
  std::deque<geometry::Rigid3> frames_;
  std::uint64_t first_frame_ = 0;
};

// The landmarks of the map, and the session's beyond them.
class LandmarkTable {
 public:
  // NOLINTNEXTLINE(google-explicit-constructor): a map is a table.
  LandmarkTable(const map::Map& map, const SessionLandmarks* own = nullptr)
      : map_(&map), own_(own) {}

  Eigen::Vector3d Position(std::uint32_t id) const {
    return own_ != nullptr && own_->Owns(id) ? own_->Position(id)
                                             : map_->landmarks()[id].Position();
  }
  // 0: not the map's.
  std::uint32_t NumViews(std::uint32_t id) const {
    return own_ != nullptr && own_->Owns(id)
               ? 0
               : map_->landmarks()[id].num_observations;
  }

 private:
  const map::Map* map_;
  const SessionLandmarks* own_;
};

// Corners of the image where none of `known` is, outside `masks_px`: the best
// ones of each cell of a grid, best first, at most `max_corners`. Thread-safe.
std::vector<Eigen::Vector2d> FindFreeCorners_px(
    const image::LumaPyramid& pyramid,
    std::span<const geometry::Box2> masks_px,
    std::span<const LandmarkMatch> known,
    int max_corners);

}  // namespace groundlock::localization

#endif  // GROUNDLOCK_SERVER_LOCALIZATION_FOLLOW_SESSION_LANDMARKS_H_
