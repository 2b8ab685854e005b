// SPDX-License-Identifier: Apache-2.0
// The silhouette of a body that goes along the ground, told from the ground
// that it goes over.
#ifndef GROUNDLOCK_SERVER_TRACKING_MOVING_SILHOUETTE_H_
#define GROUNDLOCK_SERVER_TRACKING_MOVING_SILHOUETTE_H_

#include <Eigen/Core>
#include <chrono>
#include <cstdint>
#include <deque>
#include <optional>

#include "map_store/geometry/box.h"
#include "map_store/geometry/plane.h"
#include "server/ground/box_fit.h"
#include "server/image/frame.h"
#include "server/tracking/camera_view.h"
#include "server/tracking/ground_comparison.h"

namespace groundlock::tracking {

// Background subtraction (Piccardi 2004, "Background subtraction techniques: a
// review") for a camera that moves: earlier pictures, in which the body stood
// elsewhere, show how the ground looks without it (GroundComparison). Neither
// its looks nor points of it are asked, so that nothing drifts.
//
// Pixels of the whole image, the first one's centre at (0.5, 0.5). Not
// thread-safe. Holds at most ten pictures, of 0.5 MB each for a square body of
// up to 512 px, and of no more than 3 bytes per 64 pixels of the frame for a
// larger one.
class MovingSilhouette {
 public:
  // The body is in that frame, at `body_px`. The frame is kept if the body has
  // gone on since the last one that was.
  //   p_world  where it stands; `side_m`, its size.
  void Keep(const image::Frame& frame,
            const CameraView& camera,
            const geometry::Box2& body_px,
            const Eigen::Vector3d& p_world,
            double side_m);
  // The body is not in that frame. The frame is kept if none was for a while.
  //   about_px  where it was, or may come back.
  void KeepWithout(const image::Frame& frame,
                   const CameraView& camera,
                   const geometry::Box2& about_px);
  struct Silhouette {
    ground::SeenOutline outline;
    // It stands beside the expected box, and what of that it leaves shows the
    // ground: the body is not where it was expected, if this is the body.
    bool stands_beside = false;
  };
  // The silhouette of what is expected at `expected_px`, in a frame that is not
  // older than those kept.
  //   ground_world  touches the ground where the body is.
  // nullopt: earlier pictures do not show the ground there, or too little
  // stands out from it.
  std::optional<Silhouette> Measure(const image::Frame& frame,
                                    const CameraView& camera,
                                    const geometry::Plane& ground_world,
                                    const geometry::Box2& expected_px) const;

 private:
  friend struct StateFields;

  struct Picture : GroundPicture {
    geometry::Box2 blind_px;   // what the body, or its rim, may be in
    geometry::Box2 shaded_px;  // and its shade
    std::optional<Eigen::Vector3d> p_world;  // nullopt: it is not in there
    std::chrono::nanoseconds time{0};
    std::uint64_t reset_count = 0;
  };
  // What is about a box, by what it shows.
  struct Labelled {
    Picture now;
    GroundLabels labels;
    geometry::Box2 expected;  // that box, in the picture's own pixels
  };
  Labelled LabelAbout(const image::Frame& frame,
                      const CameraView& camera,
                      const geometry::Plane& ground_world,
                      const geometry::Box2& expected_px) const;
  static std::optional<ground::SeenOutline> OutlineIn(
      const Labelled& about, const geometry::Box2& expected_px);
  // About the box, `reach` of its sides farther on each side.
  static Picture Take(const image::Frame& frame,
                      const CameraView& camera,
                      const geometry::Box2& box_px,
                      double reach);

  // Those of another camera's world, and too old ones.
  void Forget(const image::Frame& frame, const CameraView& camera);
  void Add(Picture picture);

  std::deque<Picture> pictures_;  // the oldest first
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_MOVING_SILHOUETTE_H_
