// SPDX-License-Identifier: Apache-2.0
// A made-up place with real pixels: textured panels at several depths, rendered
// exactly (one homography per panel), and the map that its views make. For
// tests of localisation end to end, without data files.
#ifndef GROUNDLOCK_TESTS_SUPPORT_RENDERED_PLANE_MAP_H_
#define GROUNDLOCK_TESTS_SUPPORT_RENDERED_PLANE_MAP_H_

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <span>
#include <vector>

#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/rigid3.h"
#include "map_store/map/map.h"
#include "map_store/map/map_data.h"

namespace groundlock::test_support {

// Cameras stand about the origin at 1.6 m and look along +y: a wall 9 m away,
// in front of it a strip of ground and four panels, two of them oblique.
class RenderedPlace {
 public:
  // Another seed is another place: the same panels with other textures.
  explicit RenderedPlace(std::uint64_t seed);

  // SIMPLE_PINHOLE, 640x360, f = 520 px.
  const geometry::CameraModel& camera() const { return camera_; }
  // CV_8UC1. Whatever no panel covers is gray.
  cv::Mat Render(const geometry::Rigid3& world_from_camera) const;

  struct Hit {
    std::size_t panel = 0;
    Eigen::Vector3d p_world = Eigen::Vector3d::Zero();
  };
  // What the pixel (first pixel's centre (0.5, 0.5)) shows.
  std::optional<Hit> Intersect(const geometry::Rigid3& world_from_camera,
                               const Eigen::Vector2d& pixel_px) const;

 private:
  struct Panel {
    Eigen::Vector3d corner_world;  // of the texture's first pixel
    Eigen::Vector3d u_world;       // unit, along the texture's rows
    Eigen::Vector3d v_world;       // unit, along its columns
    double pixels_per_m = 1.0;
    cv::Mat texture;
  };

  geometry::CameraModel camera_;
  std::vector<Panel> panels_;  // far to near
};

// Level, then turned left by `yaw_rad` and up by `pitch_rad`.
geometry::Rigid3 LookAlongY(const Eigen::Vector3d& center_world,
                            double yaw_rad,
                            double pitch_rad);

// Seven views, 0.6 m apart.
std::vector<geometry::Rigid3> MappingViews();

// SIFT features of the views; those at one place of a panel that look alike are
// one landmark.
map::MapData MapFromViews(const RenderedPlace& place,
                          std::span<const geometry::Rigid3> world_from_camera);

// Writes the map to a temporary file and opens it; the file is gone afterwards.
std::shared_ptr<const map::Map> OpenTemporaryMap(const map::MapData& data);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_RENDERED_PLANE_MAP_H_
