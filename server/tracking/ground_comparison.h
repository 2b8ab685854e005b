// SPDX-License-Identifier: Apache-2.0
// Which pixels of a picture show the ground, told from how it looked before.
#ifndef GROUNDLOCK_SERVER_TRACKING_GROUND_COMPARISON_H_
#define GROUNDLOCK_SERVER_TRACKING_GROUND_COMPARISON_H_

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <limits>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <vector>

#include "map_store/geometry/box.h"
#include "map_store/geometry/camera_model.h"
#include "map_store/geometry/plane.h"
#include "map_store/geometry/rigid3.h"
#include "server/ground/ground_surface.h"
#include "server/image/frame.h"

namespace groundlock::tracking {

// A part of a frame, and the camera that saw it.
struct GroundPicture {
  cv::Mat bgr;                                          // CV_8UC3
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();  // its first corner
  double scale = 1.0;  // its pixels per pixel of the image
  geometry::CameraModel camera;
  geometry::Rigid3 world_from_camera;
};

// kEither: it may be the ground, shaded or not, or something that looks alike.
enum GroundLabel : std::uint8_t { kUnknown, kGround, kBody, kEither };
using GroundLabels = cv::Mat_<std::uint8_t>;

// The middle of a picture's pixel.
inline Eigen::Vector2d CenterOfPixel(int x, int y) {
  return {x + image::kPixelCenter, y + image::kPixelCenter};
}

// Where the ground is known, and the cameras, so is where each of its places
// was in earlier pictures. A pixel that differs from the one that looks most
// alike about it, of two at least, shows a body; one that does not, the ground,
// if that has a texture and it is there: a body may have the ground's colour.
// What is darker than before, about alike in all colours, is shade in which the
// same holds (Prati, Mikic, Trivedi, Cucchiara 2003, "Detecting moving
// shadows"; the sun's is deep and blue). Not thread-safe.
class GroundComparison {
 public:
  using Bgr = std::array<float, 3>;
  static constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
  static constexpr Bgr kNotShown = {kNone, kNone, kNone};

  //   now  outlives this.
  //   ground_world  touches the ground about there; surface  null: is it.
  //   body  where a body is expected, in the picture's own pixels: what differs
  //     there is no noise.
  GroundComparison(const GroundPicture& now,
                   const geometry::Plane& ground_world,
                   const ground::GroundSurface* surface,
                   const geometry::Box2& body);
  // An earlier picture, of which the pixels in `blind_px` of the image do not
  // show the ground, and those in `shaded_px` may show it in the body's shade:
  // what is brighter now may be the ground without it.
  void Add(const GroundPicture& earlier,
           const geometry::Box2& blind_px,
           const geometry::Box2& shaded_px);
  // Of each pixel of the picture.
  GroundLabels Label() const;

 private:
  // By an earlier picture.
  struct Shown {
    Bgr bgr = kNotShown;
    bool may_be_shaded = false;
  };
  using Places = std::vector<std::optional<Eigen::Vector3d>>;

  // What each pixel showed in an earlier picture.
  std::vector<Shown> AsShownBy(const GroundPicture& earlier,
                               const geometry::Box2& blind_px,
                               const geometry::Box2& shaded_px) const;
  void Compare(std::vector<Shown> before);
  bool MayBeShade(int x, int y) const;
  bool ShowsTexture(const GroundLabels& labels, int x, int y) const;

  const GroundPicture& now_;
  geometry::Box2 body_;
  int node_columns_ = 0;
  Places node_places_world_;  // on the ground, of every few pixels
  cv::Mat_<float> luma_;
  cv::Mat_<float> steepness_;  // squared
  float usual_luma_ = 0.0F;    // where no body is expected
  // Of the picture whose window about the pixel differs least: by how much that
  // does in the mean, and the pixel, in variances of noise (infinite: not
  // known); and what it showed.
  cv::Mat_<float> least_about_;
  cv::Mat_<float> score_;
  std::vector<Shown> before_;
  cv::Mat_<float> luma_before_;
  cv::Mat_<int> times_;  // so many pictures show it
  double noise_ = std::numeric_limits<double>::infinity();  // the least
};

}  // namespace groundlock::tracking

#endif  // GROUNDLOCK_SERVER_TRACKING_GROUND_COMPARISON_H_
