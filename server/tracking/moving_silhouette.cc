// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/moving_silhouette.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "map_store/base/order_statistics.h"
#include "server/image/colour_picture.h"
#include "server/tracking/picture_difference.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

using Bgr = std::array<float, 3>;

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
constexpr double kBlindRim = 0.2;
// A pixel is not the ground's from so many standard deviations of noise on.
// Noise is what most of a picture shows, and a picture that was brought here by
// the ground is off by so much of its pixels.
constexpr double kDiffers = 5.0;
// One picture may show the body itself, off where it was taken to be.
constexpr int kLeastPictures = 2;
constexpr double kLeastNoise = 1.5;  // 8-bit levels
constexpr double kOff_px = 0.5;
constexpr double kSigmaOfMedian = 1.4826;
constexpr int kNoiseStep = 2;  // every so many pixels tell it, either way
constexpr double kLeastValid = 0.15;
// Where each place of a picture is in another is reckoned for every so many
// pixels, and linear between these.
constexpr int kNode_px = 8;
// The surface is met to less than a pixel by then, from a plane that touches it
// nearby.
constexpr int kRounds = 2;
// The ground of the map, and the camera, are off by so much there.
constexpr double kMoved_px = 2.0;
constexpr int kAlignSteps = 5;
constexpr double kAligned = 1.2;  // the expected box, which is left out of it
// Shade leaves so much of the light, alike in all colours but for so much; dark
// pixels say nothing of their colour.
constexpr float kDarkest = 0.15F;
constexpr float kLightest = 0.98F;
constexpr float kAlike = 0.25F;
constexpr float kDark = 5.0F;
// Ground shows its texture, shaded or not: in a window of so many pixels the
// covariance is so many times the noise's variance (a Gaussian's log-likelihood
// ratio of twice that is 20), and the correlation so much.
constexpr int kWindow_px = 2;  // on each side of the middle
constexpr double kTextured = 20.0;
constexpr double kShowsTexture = 0.6;
// Parts of a silhouette: half of each is where the body is expected, but for a
// rim. Those no farther apart than so much of the side are one.
constexpr double kPartRim = 0.25;
constexpr double kSamePart = 0.06;
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
// It is not another thing: of the expected size, so many times or less.
constexpr double kMostTimes = 2.2;

// What a pixel is; kEither: of the body, or ground that it shades.
enum Label : std::uint8_t { kUnknown, kGround, kBody, kEither };
using Labels = cv::Mat_<std::uint8_t>;

Eigen::Vector2d MiddleOf(int x, int y) {
  return {x + image::kPixelCenter, y + image::kPixelCenter};
}

float Luma(const Bgr& p) { return 0.25F * (p[0] + 2.0F * p[1] + p[2]); }

Bgr PixelAt(const cv::Mat& bgr, int x, int y) {
  const std::uint8_t* p = bgr.ptr<std::uint8_t>(y) + 3 * x;
  return {static_cast<float>(p[0]),
          static_cast<float>(p[1]),
          static_cast<float>(p[2])};
}

// In the picture's own pixels, the first one's centre at (0, 0). NaN outside.
Bgr Sample(const cv::Mat& bgr, double u, double v) {
  if (!(u >= 0.0 && v >= 0.0 && u < bgr.cols - 1.0 && v < bgr.rows - 1.0)) {
    constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
    return {kNone, kNone, kNone};
  }
  const int x = static_cast<int>(u);
  const int y = static_cast<int>(v);
  const auto a = static_cast<float>(u - x);
  const auto b = static_cast<float>(v - y);
  const Bgr p00 = PixelAt(bgr, x, y);
  const Bgr p10 = PixelAt(bgr, x + 1, y);
  const Bgr p01 = PixelAt(bgr, x, y + 1);
  const Bgr p11 = PixelAt(bgr, x + 1, y + 1);
  Bgr result;
  for (int c = 0; c < 3; ++c) {
    result[c] = (1.0F - b) * ((1.0F - a) * p00[c] + a * p10[c]) +
                b * ((1.0F - a) * p01[c] + a * p11[c]);
  }
  return result;
}

// Where the ground that pixels of a picture show is in others.
class GroundWarp {
 public:
  //   origin_px, scale  of a picture of so many pixels, seen by `view`, whose
  //     plane touches the surface about there; null: is the surface.
  GroundWarp(const ground::GroundView& view,
             const ground::GroundSurface* surface,
             const Eigen::Vector2d& origin_px,
             double scale,
             cv::Size size)
      : columns_((size.width + kNode_px - 1) / kNode_px + 1),
        rows_((size.height + kNode_px - 1) / kNode_px + 1) {
    for (int j = 0; j < rows_; ++j) {
      for (int i = 0; i < columns_; ++i) {
        places_world_.push_back(
            PlaceOf(view,
                    surface,
                    origin_px + kNode_px / scale * Eigen::Vector2d(i, j)));
      }
    }
    pixels_px_.resize(places_world_.size());
  }

  static std::optional<Eigen::Vector3d> PlaceOf(
      ground::GroundView view,
      const ground::GroundSurface* surface,
      const Eigen::Vector2d& pixel_px) {
    auto p_world = ground::GroundFromImage(view, pixel_px);
    for (int round = 0; round < kRounds && surface && p_world; ++round) {
      const auto height_m = surface->HeightOf(*p_world);
      if (!height_m) break;
      view.ground_world.d += *height_m * view.ground_world.normal.dot(
                                             surface->reference_world().normal);
      p_world = ground::GroundFromImage(view, pixel_px);
    }
    return p_world;
  }

  void To(const geometry::CameraModel& camera,
          const geometry::Rigid3& world_from_camera) {
    const geometry::Rigid3 camera_from_world = world_from_camera.Inverse();
    for (std::size_t k = 0; k < places_world_.size(); ++k) {
      pixels_px_[k] =
          places_world_[k]
              ? camera.ImageFromCamera(camera_from_world * *places_world_[k])
              : std::nullopt;
    }
  }

  // Of a pixel's middle, in the image; nullopt if it is not seen there.
  std::optional<Eigen::Vector2d> operator()(int x, int y) const {
    const int i = x / kNode_px;
    const int j = y / kNode_px;
    const auto* upper = &pixels_px_[j * columns_ + i];
    const auto* lower = upper + columns_;
    if (!upper[0] || !upper[1] || !lower[0] || !lower[1]) return std::nullopt;
    const double a = (x + image::kPixelCenter) / kNode_px - i;
    const double b = (y + image::kPixelCenter) / kNode_px - j;
    return Eigen::Vector2d((1.0 - b) * ((1.0 - a) * *upper[0] + a * *upper[1]) +
                           b * ((1.0 - a) * *lower[0] + a * *lower[1]));
  }

 private:
  int columns_;
  int rows_;
  std::vector<std::optional<Eigen::Vector3d>> places_world_;
  std::vector<std::optional<Eigen::Vector2d>> pixels_px_;
};

const Eigen::Vector2d kNowhere =
    Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());

// The ground is not quite where it is said to be: moves what pixels of `now`
// were in `then` to where it fits best, an affinity, by Gauss-Newton steps
// (Baker & Matthews 2004, "Lucas-Kanade 20 years on", §3.2).
//   there  of each pixel of `now`, row by row; kNowhere: not seen.
//   body  where `now` does not show the ground.
void Align(const cv::Mat& now,
           const cv::Mat& then,
           const Box2& body,
           std::vector<Eigen::Vector2d>& there) {
  struct Place {
    std::size_t index;
    float luma;
    Eigen::Matrix<double, 6, 1> slope;
  };
  std::vector<Place> places;
  const Eigen::Vector2d middle(0.5 * now.cols, 0.5 * now.rows);
  const auto basis = [&](std::size_t index) -> Eigen::Vector3d {
    const auto x = static_cast<double>(index % now.cols);
    const auto y = static_cast<double>(index / now.cols);
    return {1.0, x / middle.x() - 1.0, y / middle.y() - 1.0};
  };
  const auto luma = [&](int x, int y) { return Luma(PixelAt(now, x, y)); };
  for (int y = 1; y + 1 < now.rows; y += kNoiseStep) {
    for (int x = 1; x + 1 < now.cols; x += kNoiseStep) {
      const std::size_t index = y * now.cols + x;
      if (std::isnan(there[index].x()) || body.Contains(MiddleOf(x, y))) {
        continue;
      }
      const double gx = 0.5 * (luma(x + 1, y) - luma(x - 1, y));
      const double gy = 0.5 * (luma(x, y + 1) - luma(x, y - 1));
      Place place{index, luma(x, y), {}};
      place.slope << gx * basis(index), gy * basis(index);
      places.push_back(place);
    }
  }
  Eigen::Matrix<double, 6, 1> moved = Eigen::Matrix<double, 6, 1>::Zero();
  const auto at = [&](std::size_t index) -> Eigen::Vector2d {
    const Eigen::Vector3d b = basis(index);
    return there[index] +
           Eigen::Vector2d(moved.head<3>().dot(b), moved.tail<3>().dot(b));
  };
  for (int step = 0; step < kAlignSteps; ++step) {
    std::vector<double> errors;
    std::vector<const Place*> seen;
    for (const Place& place : places) {
      const Eigen::Vector2d p = at(place.index);
      const Bgr sample = Sample(then, p.x(), p.y());
      if (std::isnan(sample[0])) continue;
      errors.push_back(Luma(sample) - place.luma);
      seen.push_back(&place);
    }
    const double offset = base::Median(errors);
    std::vector<double> sizes = errors;
    for (double& size : sizes) size = std::abs(size - offset);
    const double noise =
        std::max(kLeastNoise, kSigmaOfMedian * base::Median(sizes));
    Eigen::Matrix<double, 6, 6> normal =
        Eigen::Matrix<double, 6, 6>::Identity() / (kMoved_px * kMoved_px);
    Eigen::Matrix<double, 6, 1> gradient = moved / (kMoved_px * kMoved_px);
    for (std::size_t i = 0; i < seen.size(); ++i) {
      const double sigmas = (errors[i] - offset) / noise;
      const double weight = 1.0 / (1.0 + 0.25 * sigmas * sigmas);
      const auto& J = seen[i]->slope;
      normal += weight / (noise * noise) * J * J.transpose();
      gradient += weight * sigmas / noise * J;
    }
    moved -= normal.ldlt().solve(gradient);
  }
  for (std::size_t i = 0; i < there.size(); ++i) {
    if (!std::isnan(there[i].x())) there[i] = at(i);
  }
}

// A picture of the ground, compared pixel by pixel with what it looked like.
class GroundComparison {
 public:
  //   body  where the body is expected: what differs there is no noise.
  GroundComparison(const cv::Mat& bgr, const Box2& body)
      : bgr_(bgr),
        body_(body),
        luma_(bgr.size()),
        steepness_(bgr.size(), 0.0F),
        least_(bgr.size(), std::numeric_limits<float>::infinity()),
        times_(bgr.size(), 0),
        before_(bgr.rows * bgr.cols),
        luma_before_(bgr.size(), 0.0F) {
    for (int y = 0; y < bgr.rows; ++y) {
      for (int x = 0; x < bgr.cols; ++x) luma_(y, x) = Luma(PixelAt(bgr, x, y));
    }
    for (int y = 1; y + 1 < bgr.rows; ++y) {
      for (int x = 1; x + 1 < bgr.cols; ++x) {
        const float gx = 0.5F * (luma_(y, x + 1) - luma_(y, x - 1));
        const float gy = 0.5F * (luma_(y + 1, x) - luma_(y - 1, x));
        steepness_(y, x) = gx * gx + gy * gy;
      }
    }
  }

  // One way that it looked, pixel by pixel; NaN where that is not known.
  void Add(std::vector<Bgr> before) {
    std::array<std::vector<double>, 3> brighter;
    for (int y = 0; y < bgr_.rows; y += kNoiseStep) {
      for (int x = 0; x < bgr_.cols; x += kNoiseStep) {
        const Bgr& then = before[y * bgr_.cols + x];
        if (std::isnan(then[0]) || body_.Contains(MiddleOf(x, y))) continue;
        const Bgr now = PixelAt(bgr_, x, y);
        for (int c = 0; c < 3; ++c) brighter[c].push_back(now[c] - then[c]);
      }
    }
    if (std::ssize(brighter[0]) * kNoiseStep * kNoiseStep <
        kLeastValid * bgr_.rows * bgr_.cols) {
      return;
    }
    // The picture as a whole may have become brighter.
    Bgr offset;
    double noise = kLeastNoise;
    for (int c = 0; c < 3; ++c) {
      const double median = base::Median(brighter[c]);
      offset[c] = static_cast<float>(median);
      for (double& value : brighter[c]) value = std::abs(value - median);
      noise = std::max(noise, kSigmaOfMedian * base::Median(brighter[c]));
    }
    noise_ = std::min(noise_, noise);
    if (getenv("GL_DBG"))
      fprintf(stderr, "NOISE %.1f n %zu\n", noise, brighter[0].size());
    const auto variance = static_cast<float>(noise * noise);
    constexpr auto kOff = static_cast<float>(kOff_px * kOff_px);
    for (int y = 0; y < bgr_.rows; ++y) {
      for (int x = 0; x < bgr_.cols; ++x) {
        Bgr& then = before[y * bgr_.cols + x];
        if (std::isnan(then[0])) continue;
        const Bgr now = PixelAt(bgr_, x, y);
        float most = 0.0F;
        for (int c = 0; c < 3; ++c) {
          then[c] += offset[c];
          most = std::max(most, std::abs(now[c] - then[c]));
        }
        ++times_(y, x);
        const float score = most * most / (variance + kOff * steepness_(y, x));
        if (!(score < least_(y, x))) continue;
        least_(y, x) = score;
        before_[y * bgr_.cols + x] = then;
        luma_before_(y, x) = Luma(then);
      }
    }
  }

  Labels LabelPixels() const {
    Labels labels(bgr_.size(), kUnknown);
    constexpr auto kLeast = static_cast<float>(kDiffers * kDiffers);
    // First what differs, what may be shade, and what is the same as before.
    for (int y = 0; y < bgr_.rows; ++y) {
      for (int x = 0; x < bgr_.cols; ++x) {
        if (times_(y, x) == 0) continue;
        if (least_(y, x) >= kLeast && times_(y, x) < kLeastPictures) continue;
        labels(y, x) = least_(y, x) < kLeast ? kGround
                       : MayBeShade(x, y)    ? kEither
                                             : kBody;
      }
    }
    // A body may look as the ground does, but has not its texture.
    Labels sure = labels.clone();
    for (int y = 0; y < bgr_.rows; ++y) {
      for (int x = 0; x < bgr_.cols; ++x) {
        if (labels(y, x) == kGround || labels(y, x) == kEither) {
          sure(y, x) = ShowsTexture(labels, x, y) ? kGround : kEither;
        }
      }
    }
    return sure;
  }

 private:
  bool MayBeShade(int x, int y) const {
    const Bgr now = PixelAt(bgr_, x, y);
    const Bgr& then = before_[y * bgr_.cols + x];
    float least = std::numeric_limits<float>::infinity();
    float most = 0.0F;
    float sum = 0.0F;
    for (int c = 0; c < 3; ++c) {
      const float left = (now[c] + kDark) / (then[c] + kDark);
      least = std::min(least, left);
      most = std::max(most, left);
      sum += left;
    }
    const float mean = sum / 3.0F;
    return mean > kDarkest && mean < kLightest && most - least < kAlike;
  }

  // Is the ground's texture there, and has it any? Of pixels with the same
  // label.
  bool ShowsTexture(const Labels& labels, int x, int y) const {
    double n = 0.0, a = 0.0, b = 0.0, aa = 0.0, ab = 0.0, bb = 0.0;
    for (int v = std::max(0, y - kWindow_px);
         v <= std::min(bgr_.rows - 1, y + kWindow_px);
         ++v) {
      for (int u = std::max(0, x - kWindow_px);
           u <= std::min(bgr_.cols - 1, x + kWindow_px);
           ++u) {
        if (labels(v, u) != labels(y, x)) continue;
        const double now = luma_(v, u);
        const double then = luma_before_(v, u);
        n += 1.0;
        a += now;
        b += then;
        aa += now * now;
        ab += now * then;
        bb += then * then;
      }
    }
    const double now_variance = aa - a * a / n;
    const double then_variance = bb - b * b / n;
    const double covariance = ab - a * b / n;
    return covariance > kTextured * noise_ * noise_ &&
           covariance > kShowsTexture * std::sqrt(std::max(
                                            0.0, now_variance * then_variance));
  }

  const cv::Mat& bgr_;
  Box2 body_;
  cv::Mat_<float> luma_;
  cv::Mat_<float> steepness_;  // squared
  cv::Mat_<float> least_;      // in variances of noise; infinite: not known
  cv::Mat_<int> times_;        // so many pictures show it
  std::vector<Bgr> before_;
  cv::Mat_<float> luma_before_;
  double noise_ = std::numeric_limits<double>::infinity();  // the least
};

// Those pixels, without what is thinner than two of them: an opening.
cv::Mat_<std::uint8_t> Opened(const Labels& labels,
                              std::initializer_list<Label> those) {
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
    part += about.Contains(MiddleOf(x, y)) ? 1 : -1;
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

// The box about those parts of a mask that have pixels of another one.
cv::Rect BoxOfPartsWith(const cv::Mat_<std::uint8_t>& pixels,
                        const cv::Mat_<std::uint8_t>& mask) {
  cv::Mat_<int> numbers;
  const int count = cv::connectedComponents(mask, numbers);
  std::vector<bool> belongs(count, false);
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (pixels(y, x) != 0) belongs[numbers(y, x)] = true;
    }
  }
  cv::Rect box;
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) {
      if (numbers(y, x) != 0 && belongs[numbers(y, x)]) {
        box |= cv::Rect(x, y, 1, 1);
      }
    }
  }
  return box;
}

// The silhouette in labelled pixels: its box, and with what may be of it.
struct Silhouette {
  cv::Rect sure;
  cv::Rect possible;
};
std::optional<Silhouette> FindSilhouette(const Labels& labels,
                                         const Box2& expected) {
  cv::Mat_<std::uint8_t> body = Opened(labels, {kBody});
  const cv::Rect sure = KeepExpected(expected, body);
  if (sure.empty()) return std::nullopt;
  if (cv::countNonZero(body) < kFilled * sure.area()) return std::nullopt;
  return Silhouette{
      sure,
      sure | BoxOfPartsWith(body, Opened(labels, {kBody, kEither, kUnknown}))};
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
  const Eigen::Vector2d from = picture.scale * (box_px.min_px - about);
  const Eigen::Vector2d to = picture.scale * (box_px.max_px + about);
  const auto within = [](double px, int most) {
    return static_cast<int>(std::lround(std::clamp(px, 0.0, 1.0 * most)));
  };
  const cv::Rect part(
      cv::Point(within(from.x(), whole.width), within(from.y(), whole.height)),
      cv::Point(within(to.x(), whole.width), within(to.y(), whole.height)));
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
    Forget();
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
  picture.body_px = EnlargedTimes(body_px, 1.0 + 2.0 * kBlindRim);
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
  if (size.width < 2 * kNode_px || size.height < 2 * kNode_px) {
    return std::nullopt;
  }
  ground::GroundView view = camera.view;
  view.ground_world = ground_world;
  const bool is_plane = !camera.surface || camera.surface->IsPlane();
  GroundWarp warp(view,
                  is_plane ? nullptr : camera.surface.get(),
                  now.origin_px,
                  now.scale,
                  size);
  const Box2 expected{now.scale * (expected_px.min_px - now.origin_px),
                      now.scale * (expected_px.max_px - now.origin_px)};
  GroundComparison comparison(now.bgr, EnlargedTimes(expected, kAligned));
  for (const Picture& picture : pictures_) {
    if (picture.reset_count != camera.reset_count ||
        frame.capture_time - picture.time > kOldest) {
      continue;
    }
    if (getenv("GL_DBG"))
      fprintf(stderr,
              "AGE %.2f at %.2f \n",
              std::chrono::duration<double>(frame.capture_time - picture.time)
                  .count(),
              std::chrono::duration<double>(frame.capture_time).count());
    warp.To(picture.camera, picture.world_from_camera);
    std::vector<Eigen::Vector2d> there(size.area(), kNowhere);
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        const auto there_px = warp(x, y);
        if (!there_px || picture.body_px.Contains(*there_px)) continue;
        there[y * size.width + x] =
            (picture.scale * (*there_px - picture.origin_px)).array() -
            image::kPixelCenter;
      }
    }
    Align(now.bgr, picture.bgr, EnlargedTimes(expected, kAligned), there);
    std::vector<Bgr> before(there.size());
    for (std::size_t i = 0; i < there.size(); ++i) {
      before[i] = Sample(picture.bgr, there[i].x(), there[i].y());
    }
    comparison.Add(std::move(before));
  }
  const Labels labels = comparison.LabelPixels();
  const auto found = FindSilhouette(labels, expected);
  if (const char* dir = getenv("GL_DBG_DIR")) {
    cv::Mat v(size.height, 2 * size.width, CV_8UC3);
    now.bgr.copyTo(v(cv::Rect(0, 0, size.width, size.height)));
    for (int y = 0; y < size.height; ++y)
      for (int x = 0; x < size.width; ++x) {
        static const cv::Vec3b C[4] = {
            {90, 0, 0}, {0, 0, 0}, {255, 255, 255}, {0, 120, 120}};
        v.at<cv::Vec3b>(y, x + size.width) = C[labels(y, x)];
      }
    cv::resize(v, v, cv::Size(), 3, 3, cv::INTER_NEAREST);
    auto R = [&](double a, double b, double c, double d, cv::Scalar k) {
      for (int o : {0, size.width})
        cv::rectangle(v,
                      cv::Point(3 * (a + o), 3 * b),
                      cv::Point(3 * (c + o), 3 * d),
                      k,
                      1);
    };
    R(expected.min_px.x(),
      expected.min_px.y(),
      expected.max_px.x(),
      expected.max_px.y(),
      {0, 0, 255});
    if (found) {
      R(found->sure.x,
        found->sure.y,
        found->sure.br().x,
        found->sure.br().y,
        {0, 255, 0});
      R(found->possible.x,
        found->possible.y,
        found->possible.br().x,
        found->possible.br().y,
        {0, 255, 255});
    }
    cv::imwrite(
        std::string(dir) + "/" +
            std::to_string((int)std::lround(
                std::chrono::duration<double>(frame.capture_time).count() *
                1000)) +
            ".png",
        v);
  }
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
  // What reaches the picture's edge may go on beyond it.
  const cv::Rect& possible = found->possible;
  const double room_px = kRoom * std::sqrt(outline.sure_px.Area());
  const Box2& within_px = outline.possible_px;
  const Eigen::Array2d before = outline.sure_px.min_px - within_px.min_px;
  const Eigen::Array2d after = within_px.max_px - outline.sure_px.max_px;
  outline.is_seen = {
      before.x() <= room_px && possible.x > kBorder_px,
      before.y() <= room_px && possible.y > kBorder_px,
      after.x() <= room_px && possible.br().x < size.width - kBorder_px,
      after.y() <= room_px && possible.br().y < size.height - kBorder_px};
  return outline;
}

}  // namespace groundlock::tracking
