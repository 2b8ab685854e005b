// SPDX-License-Identifier: Apache-2.0
// What moves by itself over the ground, seen from a camera that moves too: no
// detector of classes, no weights, only what the map knows of the camera and of
// the ground.
//
// Corners are followed from frame to frame. Each is asked whether one place at
// rest, not under the ground, explains all its sightings: the epipolar
// constraint and the plane-induced motion with parallax (Irani & Anandan 1998,
// "A unified approach to moving object detection in 2D and 3D scenes"; Sawhney,
// Guo & Kumar 2000, "Independent motion detection in 3D scenes"), over more
// views than two. If none does and one that goes steadily over the ground does,
// it moves. Neighbours that move alike are one thing; what exists is told by
// integrated probabilistic data association (Musicki, Evans & Stankovic 1994).
//
// What it cannot tell: a thing that comes straight towards a camera, which
// itself goes straight and steadily, looks like something tall at rest.
#ifndef GROUNDLOCK_SERVER_MOVERS_MOVERS_H_
#define GROUNDLOCK_SERVER_MOVERS_MOVERS_H_

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/ground_surface.h"
#include "server/image/luma_pyramid.h"

namespace groundlock::movers {

// Metres are map units if the map is not metric.
struct Mover {
  std::uint64_t id = 0;   // from 1 on; the same thing's from frame to frame
  geometry::Box2 box_px;  // around what is seen to move
  // Where it stands, and how it goes there; covariances in world x and y.
  Eigen::Vector3d ground_world = Eigen::Vector3d::Zero();
  Eigen::Matrix2d ground_covariance_m2 = Eigen::Matrix2d::Zero();
  Eigen::Vector3d velocity_world_m_s = Eigen::Vector3d::Zero();
  Eigen::Matrix2d velocity_covariance_m2_s2 = Eigen::Matrix2d::Zero();
  double confidence = 0.0;  // the probability that it exists
};

enum class MoversState {
  kNotAsked,
  kWatching,
  kStarting,  // too little seen since the first frame, or a pause
  kNoMap,
  kNoGround,          // unknown, or the camera is not above it
  kNoPose,            // not verified in this frame
  kPoseContradicted,  // by so much of the picture that the pose is doubted
};

struct MoversReport {
  MoversState state = MoversState::kNotAsked;
  std::vector<Mover> movers;  // the surest first; empty unless kWatching
};

struct MoversFrame {
  std::shared_ptr<const image::LumaPyramid> pyramid;
  std::chrono::nanoseconds time{0};
  const geometry::CameraModel* camera = nullptr;  // of the frame's size
  geometry::Rigid3 world_from_camera;
  // As rigid3.h says. Of a pose by odometry, its growth is what counts.
  geometry::Matrix6d pose_covariance = geometry::Matrix6d::Zero();
  bool by_odometry = false;
  // Changes whenever the pose does not continue from the one before.
  std::uint64_t pose_epoch = 0;
  const ground::GroundSurface* ground = nullptr;
  // Not looked at, and never suggested: where targets are.
  std::span<const geometry::Box2> targets_px;
};

// Not thread-safe. Deterministic. Holds the last frame's pyramid and, whatever
// the frames' size, less than 1 MB beside it.
class MoverFinder {
 public:
  static constexpr std::size_t kMaxMovers = 32;

  MoverFinder();
  ~MoverFinder();

  // Frames with a verified pose, in the order of their times. A frame of
  // another size or lens, a jump of the pose or a pause of more than a second
  // starts anew.
  MoversReport Process(const MoversFrame& frame);
  // The frame has no such pose, or nothing to hold it against. Its report names
  // `reason`; after kNoPose what was followed may go on.
  MoversReport Skip(MoversState reason);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace groundlock::movers

#endif  // GROUNDLOCK_SERVER_MOVERS_MOVERS_H_
