// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/moving_silhouette.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "server/image/colour_picture.h"
#include "server/tracking/picture_difference.h"

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
// Parts of a silhouette: half of each is where the body is expected, but for a
// rim. Those no farther apart than so much of the side are one.
constexpr double kPartRim = 0.25;
constexpr double kSamePart = 0.06;
// What may be the body beside what surely is, in a smaller share of its rows or
// columns than this, is the shade under it.
constexpr double kFewRows = 0.3;
// So much of the silhouette's box differs.
constexpr double kFilled = 0.3;
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
// It is not another thing: of the expected size, so many times or less.
constexpr double kMostTimes = 2.2;

// Those pixels, without what is thinner than two of them: an opening.
cv::Mat_<std::uint8_t> Opened(const GroundLabels& labels,
                              std::initializer_list<GroundLabel> those) {
  cv::Mat_<std::uint8_t> mask(labels.size(), 0);
  const auto is_in = [&](int y, int x) {
    return std::find(those.begin(), those.end(), labels(y, x)) != those.end();
  };
  for (int y = 0; y + 1 < labels.rows; ++y) {
    for (int x = 0; x + 1 < labels.cols; ++x) {
      if (is_in(y, x) && is_in(y, x + 1) && is_in(y + 1, x) &&
          is_in(y + 1, x + 1)) {
        mask(cv::Rect(x, y, 2, 2)) = 1;
      }
    }
  }
  return mask;
}

// Of those parts of a mask that are not where the body is expected, nothing is
// left. Returns the box about the others.
cv::Rect KeepExpected(const Box2& expected, cv::Mat_<std::uint8_t>& mask) {
  const int reach = std::max(
      1, static_cast<int>(0.5 * kSamePart * std::sqrt(expected.Area())));
  cv::Mat_<std::uint8_t> joined;
  cv::dilate(
      mask, joined, cv::Mat::ones(2 * reach + 1, 2 * reach + 1, CV_8UC1));
  cv::Mat_<int> numbers;
  const int count = cv::connectedComponents(joined, numbers);
  const Box2 about = EnlargedTimes(expected, 1.0 + 2.0 * kPartRim);
  std::vector<int> inside(count, 0);  // less what is outside
  const auto each = [&](const auto& look) {
    for (int y = 0; y < mask.rows; ++y) {
      for (int x = 0; x < mask.cols; ++x) {
        if (mask(y, x) != 0) look(y, x, inside[numbers(y, x)]);
      }
    }
  };
  each([&](int y, int x, int& part) {
    part += about.Contains(CenterOfPixel(x, y)) ? 1 : -1;
  });
  cv::Rect box;
  each([&](int y, int x, int part) {
    if (part > 0) {
      box |= cv::Rect(x, y, 1, 1);
    } else {
      mask(y, x) = 0;
    }
  });
  return box;
}

// Those parts of a mask that have pixels of another one.
cv::Mat_<std::uint8_t> PartsWith(const cv::Mat_<std::uint8_t>& pixels,
                                 const cv::Mat_<std::uint8_t>& mask) {
  cv::Mat_<int> numbers;
  const int count = cv::connectedComponents(mask, numbers);
  std::vector<bool> belongs(count, false);
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (pixels(y, x) != 0) belongs[numbers(y, x)] = true;
    }
  }
  belongs[0] = false;
  cv::Mat_<std::uint8_t> parts(mask.size(), 0);
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (belongs[numbers(y, x)]) parts(y, x) = 1;
    }
  }
  return parts;
}

// How far to the left a mask reaches in the rows of a box, but for those few
// in which it reaches farther; the box's edge if it does not reach that.
int LeftOf(const cv::Mat_<std::uint8_t>& mask, const cv::Rect& box) {
  std::vector<int> first(box.height);
  for (int i = 0; i < box.height; ++i) {
    const std::uint8_t* row = mask[box.y + i];
    first[i] = static_cast<int>(std::find(row, row + box.x, 1) - row);
  }
  const auto few = first.begin() + static_cast<int>(kFewRows * box.height);
  std::nth_element(first.begin(), few, first.end());
  return *few;
}

// The same on all sides.
cv::Rect ReachOf(const cv::Mat_<std::uint8_t>& mask, const cv::Rect& box) {
  const auto right_of = [](const cv::Mat_<std::uint8_t>& of, cv::Rect in) {
    cv::Mat_<std::uint8_t> flipped;
    cv::flip(of, flipped, 1);
    in.x = of.cols - in.br().x;
    return of.cols - LeftOf(flipped, in);
  };
  const cv::Mat_<std::uint8_t> across = mask.t();
  const cv::Rect box_across(box.y, box.x, box.height, box.width);
  return {cv::Point(LeftOf(mask, box), LeftOf(across, box_across)),
          cv::Point(right_of(mask, box), right_of(across, box_across))};
}

// The silhouette in labelled pixels: its box, and how far what may be of it
// reaches.
struct Silhouette {
  cv::Rect sure;
  cv::Rect possible;
};
std::optional<Silhouette> FindSilhouette(const GroundLabels& labels,
                                         const Box2& expected) {
  cv::Mat_<std::uint8_t> body = Opened(labels, {kBody});
  const cv::Rect sure = KeepExpected(expected, body);
  if (sure.empty()) return std::nullopt;
  if (cv::countNonZero(body) < kFilled * sure.area()) return std::nullopt;
  const cv::Mat_<std::uint8_t> possible =
      PartsWith(body, Opened(labels, {kBody, kEither, kUnknown}));
  return Silhouette{sure, ReachOf(possible, sure)};
}

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

void MovingSilhouette::Keep(const image::Frame& frame,
                            const CameraView& camera,
                            const Box2& body_px,
                            const Eigen::Vector3d& p_world,
                            double side_m) {
  if (!pictures_.empty() &&
      pictures_.back().reset_count != camera.reset_count) {
    pictures_.clear();
  }
  while (!pictures_.empty() &&
         frame.capture_time - pictures_.front().time > kOldest) {
    pictures_.pop_front();
  }
  if (!pictures_.empty() &&
      (p_world - pictures_.back().p_world).norm() < kApart * side_m) {
    return;
  }
  Picture picture = Take(frame, camera, body_px, kReach);
  if (picture.bgr.empty()) return;
  picture.blind_px = EnlargedTimes(body_px, 1.0 + 2.0 * kBlindRim);
  const Eigen::Vector2d shade_px =
      Eigen::Vector2d::Constant(kShade * SideOf(body_px));
  picture.shaded_px = {body_px.min_px - shade_px, body_px.max_px + shade_px};
  picture.p_world = p_world;
  pictures_.push_back(std::move(picture));
  if (pictures_.size() > kMostPictures) pictures_.pop_front();
}

std::optional<ground::SeenOutline> MovingSilhouette::Measure(
    const image::Frame& frame,
    const CameraView& camera,
    const geometry::Plane& ground_world,
    const Box2& expected_px) const {
  if (pictures_.empty()) return std::nullopt;
  const Picture now = Take(frame, camera, expected_px, kAbout);
  const cv::Size size = now.bgr.size();
  if (size.width < kLeastPicture_px || size.height < kLeastPicture_px) {
    return std::nullopt;
  }
  const Box2 expected{now.scale * (expected_px.min_px - now.origin_px),
                      now.scale * (expected_px.max_px - now.origin_px)};
  const bool is_plane = !camera.surface || camera.surface->IsPlane();
  GroundComparison comparison(now,
                              ground_world,
                              is_plane ? nullptr : camera.surface.get(),
                              EnlargedTimes(expected, kMayBeIn));
  for (const Picture& picture : pictures_) {
    if (picture.reset_count == camera.reset_count &&
        frame.capture_time - picture.time <= kOldest) {
      comparison.Add(picture, picture.blind_px, picture.shaded_px);
    }
  }
  const GroundLabels labels = comparison.Label();
  const auto found = FindSilhouette(labels, expected);
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
