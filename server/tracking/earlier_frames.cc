// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/earlier_frames.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <utility>

#include "server/ground/ground_model.h"
#include "server/image/colour_picture.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;

constexpr std::size_t kMostFrames = 3;
constexpr std::chrono::seconds kFramesApart{2};
// The largest frame that is taken, halved as often as frames can be.
constexpr double kMostPixels = 1 << 19;
// Shares of the way to the ground at which something may stand before it: so
// that the places of what is between are within a box of each other, as a
// tracker looks, for a camera that has gone a tenth of the way.
constexpr std::array<double, 4> kWays = {1.0, 0.75, 0.55, 0.4};
// What is nearer to where the target was than so many times its box may be the
// target.
constexpr double kAboutTarget = 2.0;
// A look-alike is seen as a whole, and not too small to be told.
constexpr double kInView = 0.9;
constexpr double kLeastSide_px = 6.0;

}  // namespace

void EarlierFrames::Keep(const image::Frame& frame,
                         const CameraView& camera,
                         const Box2& box_px) {
  if (!frames_.empty()) {
    const Earlier& last = frames_.back();
    if (last.reset_count != camera.reset_count) {
      frames_.clear();
    } else if (frame.capture_time - last.frame.capture_time < kFramesApart) {
      return;
    }
  }
  const cv::Size whole = frame.size_px();
  int halvings = 0;
  while (halvings < image::ColourPicture::kMaxHalvings &&
         std::ldexp(1.0 * whole.width * whole.height, -2 * halvings) >
             kMostPixels) {
    ++halvings;
  }
  const cv::Rect part(0, 0, whole.width >> halvings, whole.height >> halvings);
  Earlier earlier;
  earlier.frame =
      image::Frame::FromBgr(frame.Bgr(part, halvings)(part).clone());
  earlier.scale = std::ldexp(1.0, -halvings);
  earlier.camera = *camera.view.camera;
  earlier.world_from_camera = camera.view.world_from_camera;
  earlier.reset_count = camera.reset_count;
  earlier.frame.sequence = frame.sequence;
  earlier.frame.capture_time = frame.capture_time;
  earlier.target_px = box_px;
  frames_.push_back(std::move(earlier));
  if (frames_.size() > kMostFrames) frames_.pop_front();
}

std::vector<EarlierFrames::Place> EarlierFrames::PlacesOf(
    const CameraView& camera, const Box2& box_px, double distance) const {
  std::vector<Place> places;
  const auto ray_world = ground::RayWorld(camera.view, box_px.center_px());
  if (!ray_world) return places;
  const Eigen::Vector3d& eye_world = camera.view.world_from_camera.translation;
  for (const Earlier& earlier : frames_) {
    if (earlier.reset_count != camera.reset_count) continue;
    const cv::Size size = earlier.frame.size_px();
    const Box2 image_px = Box2::FromXywh(0.0, 0.0, size.width, size.height);
    const Box2 about_px =
        Box2::FromCenter(earlier.target_px.center_px(),
                         kAboutTarget * earlier.target_px.size_px());
    for (const double way : kWays) {
      const Eigen::Vector3d p_world =
          eye_world + way * distance * ray_world->normalized();
      const auto there_px = earlier.camera.ImageFromCamera(
          earlier.world_from_camera.Inverse() * p_world);
      if (!there_px) continue;
      const double nearer =
          way * distance /
          (p_world - earlier.world_from_camera.translation).norm();
      const Box2 then_px =
          Box2::FromCenter(*there_px, nearer * box_px.size_px());
      if (Intersection(then_px, about_px).Area() > 0.0) continue;
      const Box2 place_px{earlier.scale * then_px.min_px,
                          earlier.scale * then_px.max_px};
      if (Intersection(place_px, image_px).Area() < kInView * place_px.Area() ||
          place_px.size_px().minCoeff() < kLeastSide_px) {
        continue;
      }
      places.push_back({&earlier.frame, place_px});
    }
  }
  return places;
}

}  // namespace groundlock::tracking
