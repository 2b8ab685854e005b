// SPDX-License-Identifier: Apache-2.0
// Patches of a body, by which it is known again after an absence.
#ifndef GROUNDLOCK_SERVER_TRACKING_PATCH_MEMORY_H_
#define GROUNDLOCK_SERVER_TRACKING_PATCH_MEMORY_H_

#include <Eigen/Core>
#include <array>
#include <chrono>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "server/image/frame.h"
#include "server/tracking/camera_view.h"

namespace groundlock::tracking {

// A correlation filter tells whether a target as a whole looks as before, and
// is unsure where a part of it is hidden, or it is seen from another side.
// Corners of it that are all where one body has them are another witness, and
// tell to a pixel where it is (Kölsch & Turk 2004, "Fast 2D hand tracking with
// flocks of features"; Philbin et al. 2007, §4, for what geometry verifies).
// Each face of the body's box is drawn as it would be seen now, and its corners
// are followed from there.
//
// Pixels of the whole image, the first one's centre at (0.5, 0.5). Not
// thread-safe. Holds at most twelve pictures, each of no more than some 150 by
// 150 pixels for a square body, 60 corners.
class PatchMemory {
 public:
  // The body is seen in that frame, whole and surely.
  //   outline_px  of it.
  //   unturned_rad  by how much its frame has been turned by what was learnt of
  //     its heading: corners are known in that frame, and forgotten in another.
  void Keep(const image::Frame& frame,
            const CameraView& camera,
            const geometry::Box3& body_world,
            const geometry::Box2& outline_px,
            double unturned_rad);
  // Are they known in a frame that is turned like that?
  bool AreKnownIn(double unturned_rad) const;

  struct Patch {
    Eigen::Vector2d then_px;
    Eigen::Vector2d now_px;
    // About where it is in the frame of the body, whose origin is the middle of
    // its base.
    Eigen::Vector3d p_body;
  };
  struct Match {
    std::vector<Patch> patches;  // those that agree
    // By which they are seen beside where `body_world` has them, on average.
    Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();
  };
  // The patches that are seen in that frame, if the body is about there, from
  // the picture that has most of them. nullopt: too few to be its own.
  //   rests  it is where it was when it was kept: each patch is where two views
  //     of one point in space have it. Else they are so as one, in the image.
  std::optional<Match> Find(const image::Frame& frame,
                            const CameraView& camera,
                            const geometry::Box3& body_world,
                            bool rests) const;

 private:
  friend struct StateFields;

  struct Corner {
    Eigen::Vector2d picture_px;  // in the picture's own pixels
    Eigen::Vector3d share;       // from the body's middle, of its extents
    int face = 0;
  };
  // How a face of the box lies in a picture: its two axes, of the length of its
  // sides, and its middle; nullopt: it is not seen.
  using Affinity = Eigen::Matrix<double, 2, 3>;
  using Faces = std::array<std::optional<Affinity>, 6>;
  struct Picture {
    cv::Mat luma;
    Eigen::Vector2d origin_px;
    double scale = 1.0;    // its pixels per pixel of the image
    double side_px = 0.0;  // the body's, in the image
    std::vector<Corner> corners;
    Faces picture_from_face;
    geometry::CameraModel camera;
    geometry::Rigid3 world_from_camera;
    Eigen::Vector3d direction_body;  // to the camera
    std::chrono::nanoseconds time{0};
    std::uint64_t reset_count = 0;
  };

  static Faces FacesOf(const CameraView& camera,
                       const geometry::Box3& body_world,
                       const Eigen::Vector2d& origin_px,
                       double scale);
  static std::optional<Match> FindAsIn(const Picture& picture,
                                       const image::Frame& frame,
                                       const CameraView& camera,
                                       const geometry::Box3& body_world,
                                       bool rests);

  std::vector<Picture> pictures_;
  double unturned_rad_ = 0.0;
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_PATCH_MEMORY_H_
