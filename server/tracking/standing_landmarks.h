// SPDX-License-Identifier: Apache-2.0
// What the map knows to stand between the camera and a target: a wall, a tree,
// a parked car.
#ifndef GROUNDLOCK_SERVER_TRACKING_STANDING_LANDMARKS_H_
#define GROUNDLOCK_SERVER_TRACKING_STANDING_LANDMARKS_H_

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "map_store/map/map.h"
#include "server/ground/ground_model.h"
#include "server/ground/ground_surface.h"
#include "server/tracking/occlusion.h"

namespace groundlock::tracking {

// The landmarks of a region around the camera that lie above the ground. Which
// views saw them does not matter: the views near the camera need not be those
// that look at what is before it. The region is gathered from the map a bounded
// number of landmarks per frame, so that a frame's cost does not depend on the
// map; in a large one it is complete after some seconds. Lengths in metres or
// map units. Not thread-safe.
class StandingLandmarks {
 public:
  // Landmarks read from the map per frame, and kept at most: of more, every
  // second, fourth, ... one is.
  static constexpr std::size_t kReadPerFrame = 8'192;
  static constexpr std::size_t kMaxKept = 16'384;

  //   min_landmark_views  landmarks seen by fewer are not used.
  StandingLandmarks(std::shared_ptr<const map::Map> map,
                    int min_landmark_views);

  // The camera is there now, and targets are no farther away than `range_m`:
  // once a frame.
  void Follow(const ground::GroundView& view, double range_m);
  // Landmarks that project to the body's outline, or near it, and are nearer to
  // the camera than the body by more than its size and what is not known of
  // either's place: spread evenly, at most BoxCover::kMaxPoints.
  std::vector<FrontPoint> Before(const ground::GroundView& view,
                                 const ExpectedBody& body) const;

 private:
  friend struct StateFields;

  struct Point {
    Eigen::Vector3f p_region;  // from the region's middle
    std::uint32_t landmark;
  };
  struct Region {
    bool Contains(const Eigen::Vector3d& eye_world, double range_m) const;

    Eigen::Vector3d middle_world = Eigen::Vector3d::Zero();
    double radius_m = 0.0;
    std::size_t next = 0;    // landmark of the map
    std::size_t stride = 1;  // of those that are kept
    std::size_t found = 0;
    std::vector<Point> points;
  };

  void Gather(const ground::GroundView& view, Region& region) const;

  std::shared_ptr<const map::Map> map_;
  std::shared_ptr<const ground::GroundSurface> ground_;
  int min_landmark_views_;
  Region known_;    // in use; complete unless it is the first
  Region growing_;  // takes its place once it is complete
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_STANDING_LANDMARKS_H_
