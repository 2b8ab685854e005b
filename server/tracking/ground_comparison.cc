// SPDX-License-Identifier: Apache-2.0
#include "server/tracking/ground_comparison.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "map_store/base/order_statistics.h"
#include "server/ground/ground_model.h"

namespace groundlock::tracking {
namespace {

using geometry::Box2;
using Bgr = GroundComparison::Bgr;

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
// Shade leaves so much of the light, alike in all colours but for so much; dark
// pixels say nothing of their colour.
constexpr float kDarkest = 0.15F;
constexpr float kLightest = 0.98F;
constexpr float kAlike = 0.25F;
constexpr float kDark = 5.0F;
// What lies in it is darker than so much of the ground's median.
constexpr float kShaded = 0.8F;
// Which earlier picture shows the same ground as now is told in a window of so
// many pixels. Ground shows its texture there, shaded or not: the covariance is
// so many times the noise's variance (a Gaussian's log-likelihood ratio of
// twice that is 20), and the correlation so much.
constexpr int kWindow_px = 2;  // on each side of the middle
constexpr double kTextured = 20.0;
constexpr double kShowsTexture = 0.6;

float Luma(const Bgr& p) { return 0.25F * (p[0] + 2.0F * p[1] + p[2]); }

Bgr PixelAt(const cv::Mat& bgr, int x, int y) {
  const std::uint8_t* p = bgr.ptr<std::uint8_t>(y) + 3 * x;
  return {static_cast<float>(p[0]),
          static_cast<float>(p[1]),
          static_cast<float>(p[2])};
}

// In the picture's own pixels, the first one's centre at (0, 0).
Bgr Sample(const cv::Mat& bgr, double u, double v) {
  if (!(u >= 0.0 && v >= 0.0 && u < bgr.cols - 1.0 && v < bgr.rows - 1.0)) {
    return GroundComparison::kNotShown;
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

// Of the window about each pixel.
cv::Mat_<float> SumsAbout(const cv::Mat_<float>& values) {
  constexpr int kSide_px = 2 * kWindow_px + 1;
  cv::Mat_<float> sums;
  cv::boxFilter(values,
                sums,
                CV_32F,
                {kSide_px, kSide_px},
                {-1, -1},
                /*normalize=*/false,
                cv::BORDER_CONSTANT);
  return sums;
}

// The one as the other would look in the shade.
bool IsAsInShade(const Bgr& dark, const Bgr& light) {
  float least = std::numeric_limits<float>::infinity();
  float most = 0.0F;
  float sum = 0.0F;
  for (int c = 0; c < 3; ++c) {
    const float left = (dark[c] + kDark) / (light[c] + kDark);
    least = std::min(least, left);
    most = std::max(most, left);
    sum += left;
  }
  const float mean = sum / 3.0F;
  return mean > kDarkest && mean < kLightest && most - least < kAlike;
}

// Where a pixel shows the ground.
std::optional<Eigen::Vector3d> PlaceOf(ground::GroundView view,
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

}  // namespace

GroundComparison::GroundComparison(const GroundPicture& now,
                                   const geometry::Plane& ground_world,
                                   const ground::GroundSurface* surface,
                                   const Box2& body)
    : now_(now),
      body_(body),
      luma_(now.bgr.size()),
      steepness_(now.bgr.size(), 0.0F),
      least_about_(now.bgr.size(), std::numeric_limits<float>::infinity()),
      score_(now.bgr.size(), std::numeric_limits<float>::infinity()),
      before_(now.bgr.rows * now.bgr.cols),
      luma_before_(now.bgr.size(), 0.0F),
      times_(now.bgr.size(), 0) {
  const ground::GroundView view{
      &now.camera, now.world_from_camera, ground_world};
  node_columns_ = (now.bgr.cols + kNode_px - 1) / kNode_px + 1;
  const int rows = (now.bgr.rows + kNode_px - 1) / kNode_px + 1;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < node_columns_; ++i) {
      node_places_world_.push_back(PlaceOf(
          view,
          surface,
          now.origin_px + kNode_px / now.scale * Eigen::Vector2d(i, j)));
    }
  }
  for (int y = 0; y < now.bgr.rows; ++y) {
    for (int x = 0; x < now.bgr.cols; ++x) {
      luma_(y, x) = Luma(PixelAt(now.bgr, x, y));
    }
  }
  std::vector<double> ground;
  for (int y = 0; y < now.bgr.rows; y += kNoiseStep) {
    for (int x = 0; x < now.bgr.cols; x += kNoiseStep) {
      if (!body_.Contains(CenterOfPixel(x, y))) ground.push_back(luma_(y, x));
    }
  }
  if (!ground.empty()) usual_luma_ = static_cast<float>(base::Median(ground));
  for (int y = 1; y + 1 < now.bgr.rows; ++y) {
    for (int x = 1; x + 1 < now.bgr.cols; ++x) {
      const float gx = 0.5F * (luma_(y, x + 1) - luma_(y, x - 1));
      const float gy = 0.5F * (luma_(y + 1, x) - luma_(y - 1, x));
      steepness_(y, x) = gx * gx + gy * gy;
    }
  }
}

void GroundComparison::Add(const GroundPicture& earlier,
                           const Box2& blind_px,
                           const Box2& shaded_px) {
  Compare(AsShownBy(earlier, blind_px, shaded_px));
}

std::vector<GroundComparison::Shown> GroundComparison::AsShownBy(
    const GroundPicture& earlier,
    const Box2& blind_px,
    const Box2& shaded_px) const {
  const geometry::Rigid3 camera_from_world =
      earlier.world_from_camera.Inverse();
  std::vector<std::optional<Eigen::Vector2d>> nodes_px;
  for (const auto& p_world : node_places_world_) {
    nodes_px.push_back(
        p_world ? earlier.camera.ImageFromCamera(camera_from_world * *p_world)
                : std::nullopt);
  }
  const int columns = now_.bgr.cols;
  std::vector<Shown> before(now_.bgr.rows * columns);
  for (int y = 0; y < now_.bgr.rows; ++y) {
    for (int x = 0; x < columns; ++x) {
      const auto* upper =
          &nodes_px[y / kNode_px * node_columns_ + x / kNode_px];
      const auto* lower = upper + node_columns_;
      if (!upper[0] || !upper[1] || !lower[0] || !lower[1]) continue;
      const double a = (x % kNode_px + image::kPixelCenter) / kNode_px;
      const double b = (y % kNode_px + image::kPixelCenter) / kNode_px;
      const Eigen::Vector2d there_px =
          (1.0 - b) * ((1.0 - a) * *upper[0] + a * *upper[1]) +
          b * ((1.0 - a) * *lower[0] + a * *lower[1]);
      if (blind_px.Contains(there_px)) continue;
      const Eigen::Vector2d sample =
          (earlier.scale * (there_px - earlier.origin_px)).array() -
          image::kPixelCenter;
      before[y * columns + x] = {Sample(earlier.bgr, sample.x(), sample.y()),
                                 shaded_px.Contains(there_px)};
    }
  }
  return before;
}

void GroundComparison::Compare(std::vector<Shown> before) {
  std::array<std::vector<double>, 3> brighter;
  for (int y = 0; y < now_.bgr.rows; y += kNoiseStep) {
    for (int x = 0; x < now_.bgr.cols; x += kNoiseStep) {
      const Bgr& then = before[y * now_.bgr.cols + x].bgr;
      if (std::isnan(then[0]) || body_.Contains(CenterOfPixel(x, y))) continue;
      const Bgr now = PixelAt(now_.bgr, x, y);
      for (int c = 0; c < 3; ++c) brighter[c].push_back(now[c] - then[c]);
    }
  }
  if (std::ssize(brighter[0]) * kNoiseStep * kNoiseStep <
      kLeastValid * now_.bgr.rows * now_.bgr.cols) {
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
  const auto variance = static_cast<float>(noise * noise);
  constexpr auto kOff = static_cast<float>(kOff_px * kOff_px);
  cv::Mat_<float> scores(now_.bgr.size(), 0.0F);
  cv::Mat_<float> shown(now_.bgr.size(), 0.0F);
  for (int y = 0; y < now_.bgr.rows; ++y) {
    for (int x = 0; x < now_.bgr.cols; ++x) {
      Bgr& then = before[y * now_.bgr.cols + x].bgr;
      if (std::isnan(then[0])) continue;
      const Bgr now = PixelAt(now_.bgr, x, y);
      float most = 0.0F;
      for (int c = 0; c < 3; ++c) {
        then[c] += offset[c];
        most = std::max(most, std::abs(now[c] - then[c]));
      }
      ++times_(y, x);
      scores(y, x) = most * most / (variance + kOff * steepness_(y, x));
      shown(y, x) = 1.0F;
    }
  }
  const cv::Mat_<float> sums = SumsAbout(scores);
  const cv::Mat_<float> counts = SumsAbout(shown);
  for (int y = 0; y < now_.bgr.rows; ++y) {
    for (int x = 0; x < now_.bgr.cols; ++x) {
      if (shown(y, x) == 0.0F) continue;
      const float about = sums(y, x) / counts(y, x);
      if (!(about < least_about_(y, x))) continue;
      least_about_(y, x) = about;
      score_(y, x) = scores(y, x);
      const Shown& then = before[y * now_.bgr.cols + x];
      before_[y * now_.bgr.cols + x] = then;
      luma_before_(y, x) = Luma(then.bgr);
    }
  }
}

GroundLabels GroundComparison::Label() const {
  GroundLabels labels(now_.bgr.size(), kUnknown);
  constexpr auto kLeast = static_cast<float>(kDiffers * kDiffers);
  // First what differs, what may be shade, and what is the same as before.
  for (int y = 0; y < now_.bgr.rows; ++y) {
    for (int x = 0; x < now_.bgr.cols; ++x) {
      if (times_(y, x) == 0) continue;
      if (score_(y, x) >= kLeast && times_(y, x) < kLeastPictures) continue;
      labels(y, x) = score_(y, x) < kLeast ? kGround
                     : MayBeShade(x, y)    ? kEither
                                           : kBody;
    }
  }
  // A body may look as the ground does, but has not its texture.
  GroundLabels sure = labels.clone();
  for (int y = 0; y < now_.bgr.rows; ++y) {
    for (int x = 0; x < now_.bgr.cols; ++x) {
      if (labels(y, x) == kGround || labels(y, x) == kEither) {
        sure(y, x) = ShowsTexture(labels, x, y) ? kGround : kEither;
      }
    }
  }
  return sure;
}

bool GroundComparison::MayBeShade(int x, int y) const {
  const Bgr now = PixelAt(now_.bgr, x, y);
  const Shown& then = before_[y * now_.bgr.cols + x];
  return IsAsInShade(now, then.bgr) ||
         (then.may_be_shaded && IsAsInShade(then.bgr, now) &&
          Luma(then.bgr) < kShaded * usual_luma_);
}

bool GroundComparison::ShowsTexture(const GroundLabels& labels,
                                    int x,
                                    int y) const {
  double n = 0.0, a = 0.0, b = 0.0, aa = 0.0, ab = 0.0, bb = 0.0;
  for (int v = std::max(0, y - kWindow_px);
       v <= std::min(now_.bgr.rows - 1, y + kWindow_px);
       ++v) {
    for (int u = std::max(0, x - kWindow_px);
         u <= std::min(now_.bgr.cols - 1, x + kWindow_px);
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

}  // namespace groundlock::tracking
