// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/moving_silhouette.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "server/image/colour_picture.h"
#include "server/tracking/picture_difference.h"
#include "server/tracking/silhouette_parts.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

// Looked at in pictures in which the body's side is no longer, if these need no
// more halvings than are made: its edges are then known to a hundredth.
constexpr double kMostSide_px = 64.0;
// What is looked at about the expected box, and kept about the body, of its
// side, on each side.
constexpr double kAbout = 0.5;
constexpr double kReach = 2.5;
// A picture is kept where the body has gone on by so much of its side. All of
// the ground under it is seen once it has gone its length.
constexpr double kApart = 0.35;
constexpr std::size_t kMostPictures = 10;
// By then the light has changed, or what stands there.
constexpr nanoseconds kOldest = milliseconds(10'000);
// The body's box in a picture may be off by so much of its size.
constexpr double kBlindRim = 0.3;
// Its shade reaches so many of its sides, as that of one as high as its side
// where the sun is 42 degrees high.
constexpr double kShade = 1.1;
// About a body that may be off where it is expected: what differs there is no
// noise of the ground.
constexpr double kMayBeIn = 1.2;
constexpr int kLeastPicture_px = 16;
// Of an edge: of the silhouette's side, and pixels. The octagon that stands for
// a body is off by as much.
constexpr double kEdgeSigma = 0.03;
constexpr double kEdgeSigma_px = 0.7;
// An edge is seen that is known to so much of the side.
constexpr double kRoom = 0.1;
// An edge of the picture is none of the silhouette.
constexpr int kBorder_px = 2;
// The body may be so far from where it is expected, of its side (as
// BodyFollower takes it).
constexpr double kExpectedOff = 0.15;
// What stands out beside the expected box is looked about so often for all of
// it.
constexpr int kMostRounds = 2;
// Pictures without the body are so far apart.
constexpr nanoseconds kWithoutApart = milliseconds(1'000);
// It is not another thing: of the expected size, so many times or less.
constexpr double kMostTimes = 2.2;

}  // namespace

MovingSilhouette::Picture MovingSilhouette::Take(const image::Frame& frame,
                                                 const CameraView& camera,
                                                 const Box2& box_px,
                                                 double reach) {
  const double side_px = SideOf(box_px);
  int halvings = 0;
  while (halvings < image::ColourPicture::kMaxHalvings &&
         std::ldexp(side_px, -halvings) > kMostSide_px) {
    ++halvings;
  }
  Picture picture;
  picture.scale = std::ldexp(1.0, -halvings);
  picture.camera = *camera.view.camera;
  picture.world_from_camera = camera.view.world_from_camera;
  picture.time = frame.capture_time;
  picture.reset_count = camera.reset_count;
  const cv::Size whole(frame.size_px().width >> halvings,
                       frame.size_px().height >> halvings);
  const Eigen::Vector2d about = Eigen::Vector2d::Constant(reach * side_px);
  const cv::Rect part =
      PixelsWithin({box_px.min_px - about, box_px.max_px + about},
                   Eigen::Vector2d::Zero(),
                   picture.scale,
                   whole);
  picture.origin_px = Eigen::Vector2d(part.x, part.y) / picture.scale;
  if (!part.empty()) {
    cv::GaussianBlur(frame.Bgr(part, halvings)(part),
                     picture.bgr,
                     cv::Size(3, 3),
                     0.8,
                     0.8,
                     cv::BORDER_REPLICATE | cv::BORDER_ISOLATED);
  }
  return picture;
}

void MovingSilhouette::Forget(const image::Frame& frame,
                              const CameraView& camera) {
  if (!pictures_.empty() &&
      pictures_.back().reset_count != camera.reset_count) {
    pictures_.clear();
  }
  while (!pictures_.empty() &&
         frame.capture_time - pictures_.front().time > kOldest) {
    pictures_.pop_front();
  }
}

void MovingSilhouette::Add(Picture picture) {
  if (picture.bgr.empty()) return;
  pictures_.push_back(std::move(picture));
  if (pictures_.size() > kMostPictures) pictures_.pop_front();
}

void MovingSilhouette::Keep(const image::Frame& frame,
                            const CameraView& camera,
                            const Box2& body_px,
                            const Eigen::Vector3d& p_world,
                            double side_m) {
  Forget(frame, camera);
  if (!pictures_.empty() && pictures_.back().p_world &&
      (p_world - *pictures_.back().p_world).norm() < kApart * side_m) {
    return;
  }
  Picture picture = Take(frame, camera, body_px, kReach);
  picture.blind_px = EnlargedTimes(body_px, 1.0 + 2.0 * kBlindRim);
  const Eigen::Vector2d shade_px =
      Eigen::Vector2d::Constant(kShade * SideOf(body_px));
  picture.shaded_px = {body_px.min_px - shade_px, body_px.max_px + shade_px};
  picture.p_world = p_world;
  Add(std::move(picture));
}

void MovingSilhouette::KeepWithout(const image::Frame& frame,
                                   const CameraView& camera,
                                   const Box2& about_px) {
  Forget(frame, camera);
  if (!pictures_.empty() &&
      frame.capture_time - pictures_.back().time < kWithoutApart) {
    return;
  }
  Add(Take(frame, camera, about_px, kReach));
}

MovingSilhouette::Labelled MovingSilhouette::LabelAbout(
    const image::Frame& frame,
    const CameraView& camera,
    const geometry::Plane& ground_world,
    const Box2& expected_px) const {
  Labelled about;
  about.now = Take(frame, camera, expected_px, kAbout);
  const Picture& now = about.now;
  if (now.bgr.cols < kLeastPicture_px || now.bgr.rows < kLeastPicture_px) {
    return about;
  }
  about.expected = {now.scale * (expected_px.min_px - now.origin_px),
                    now.scale * (expected_px.max_px - now.origin_px)};
  const bool is_plane = !camera.surface || camera.surface->IsPlane();
  GroundComparison comparison(now,
                              ground_world,
                              is_plane ? nullptr : camera.surface.get(),
                              EnlargedTimes(about.expected, kMayBeIn));
  for (const Picture& picture : pictures_) {
    if (picture.reset_count == camera.reset_count &&
        frame.capture_time - picture.time <= kOldest) {
      comparison.Add(picture, picture.blind_px, picture.shaded_px);
    }
  }
  about.labels = comparison.Label();
  return about;
}

std::optional<MovingSilhouette::Silhouette> MovingSilhouette::Measure(
    const image::Frame& frame,
    const CameraView& camera,
    const geometry::Plane& ground_world,
    const Box2& expected_px) const {
  if (pictures_.empty()) return std::nullopt;
  const Labelled expected =
      LabelAbout(frame, camera, ground_world, expected_px);
  if (expected.labels.empty()) return std::nullopt;
  if (const auto outline = OutlineIn(expected, expected_px)) {
    return Silhouette{*outline};
  }
  // What stands out there may be all of it only about a place farther on.
  Box2 about_px = expected_px;
  Labelled about = expected;
  for (int round = 0; round < kMostRounds; ++round) {
    const auto middle = MiddleOfNextPart(about.labels, about.expected);
    if (!middle) return std::nullopt;
    about_px = Box2::FromCenter(about.now.origin_px + *middle / about.now.scale,
                                expected_px.size_px());
    about = LabelAbout(frame, camera, ground_world, about_px);
    if (about.labels.empty()) return std::nullopt;
    if (const auto outline = OutlineIn(about, about_px)) {
      const Box2 seen{expected.now.scale *
                          (outline->sure_px.min_px - expected.now.origin_px),
                      expected.now.scale *
                          (outline->sure_px.max_px - expected.now.origin_px)};
      if (!IsGroundBeside(expected.labels, expected.expected, seen)) {
        return std::nullopt;
      }
      return Silhouette{*outline, /*stands_beside=*/true};
    }
  }
  return std::nullopt;
}

std::optional<ground::SeenOutline> MovingSilhouette::OutlineIn(
    const Labelled& about, const Box2& expected_px) {
  const Picture& now = about.now;
  const Box2& expected = about.expected;
  const cv::Size size = now.bgr.size();
  const auto found = FindSilhouette(about.labels, expected);
  if (!found) return std::nullopt;
  const cv::Rect& sure = found->sure;
  // What comes into the picture is something else, or with something else.
  if (sure.x <= kBorder_px || sure.y <= kBorder_px ||
      sure.br().x >= size.width - kBorder_px ||
      sure.br().y >= size.height - kBorder_px) {
    return std::nullopt;
  }
  const Eigen::Vector2d times = Eigen::Vector2d(sure.width, sure.height)
                                    .cwiseQuotient(expected.size_px());
  if (times.minCoeff() < 1.0 / kMostTimes || times.maxCoeff() > kMostTimes) {
    return std::nullopt;
  }
  const auto in_image = [&](const cv::Rect& box) -> Box2 {
    return {
        now.origin_px + Eigen::Vector2d(box.x, box.y) / now.scale,
        now.origin_px + Eigen::Vector2d(box.br().x, box.br().y) / now.scale};
  };
  ground::SeenOutline outline{in_image(sure), in_image(found->possible)};
  outline.sigma_px =
      std::hypot(kEdgeSigma * std::sqrt(outline.sure_px.Area()), kEdgeSigma_px);
  // What reaches the picture's edge may go on beyond it, and be another thing
  // that passes: there the body surely ends no farther out than it may be.
  constexpr double kNoEnd = std::numeric_limits<double>::infinity();
  const cv::Rect& possible = found->possible;
  Box2& within_px = outline.possible_px;
  Box2& sure_px = outline.sure_px;
  const Eigen::Vector2d off_px =
      Eigen::Vector2d::Constant(kExpectedOff * SideOf(expected_px));
  const Box2 may_be_px{expected_px.min_px - off_px,
                       expected_px.max_px + off_px};
  for (int axis = 0; axis < 2; ++axis) {
    const int first = axis == 0 ? possible.x : possible.y;
    const int last = axis == 0 ? possible.br().x : possible.br().y;
    const int end = axis == 0 ? size.width : size.height;
    if (first <= kBorder_px) {
      within_px.min_px[axis] = -kNoEnd;
      sure_px.min_px[axis] =
          std::max(sure_px.min_px[axis], may_be_px.min_px[axis]);
    }
    if (last >= end - kBorder_px) {
      within_px.max_px[axis] = kNoEnd;
      sure_px.max_px[axis] =
          std::min(sure_px.max_px[axis], may_be_px.max_px[axis]);
    }
  }
  const double room_px = kRoom * std::sqrt(outline.sure_px.Area());
  const Eigen::Array2d before = outline.sure_px.min_px - within_px.min_px;
  const Eigen::Array2d after = within_px.max_px - outline.sure_px.max_px;
  outline.is_seen = {before.x() <= room_px,
                     before.y() <= room_px,
                     after.x() <= room_px,
                     after.y() <= room_px};
  return outline;
}

}  // namespace groundlock::tracking
