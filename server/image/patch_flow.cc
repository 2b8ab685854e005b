// SPDX-License-Identifier: Apache-2.0
#include "server/image/patch_flow.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "server/image/frame.h"
#include "server/image/vectors.h"

namespace groundlock::image {
namespace {

constexpr int kSide = LumaPyramid::kWindowPx;
constexpr int kHalf = kSide / 2;
constexpr int kPitchFloats = 2 * kVectorFloats;
// A texture's least squared slope, mean over the patch: (8-bit levels / px)^2.
constexpr double kMinSlopeSquared = 0.1;
// Two steps that cancel each other so nearly will go on to.
constexpr double kOscillationPx = 0.01;

// What is looked for, kSide rows of kPitchFloats.
struct Patch {
  alignas(32) float value[kSide * kPitchFloats];
  alignas(32) float dx[kSide * kPitchFloats];
  alignas(32) float dy[kSide * kPitchFloats];
};

}  // namespace
}  // namespace groundlock::image

#define GROUNDLOCK_KERNELS_NAMESPACE groundlock::image
#define GROUNDLOCK_KERNELS "server/image/patch_flow_kernels.inc"
#include "server/image/at_both_widths.inc"

namespace groundlock::image {
namespace {

double Sum(const float* eight) {
  double sum = 0.0;
  for (int i = 0; i < kVectorFloats; ++i) sum += eight[i];
  return sum;
}

// Samples of a patch around a point of a level.
struct Samples {
  const std::uint8_t* top_left;
  std::ptrdiff_t step;
  float u, v;  // of the way to the next pixel

  // nullopt: the point is outside of the level. Patches of points within read
  // up to ten pixels of the border. `rim`: of samples around the patch.
  static std::optional<Samples> Around(const cv::Mat& level,
                                       const cv::Point2d& point_px,
                                       int rim) {
    if (!(point_px.x >= 0.0 && point_px.y >= 0.0 && point_px.x <= level.cols &&
          point_px.y <= level.rows)) {
      return std::nullopt;
    }
    const double x = point_px.x - kPixelCenter - kHalf - rim;
    const double y = point_px.y - kPixelCenter - kHalf - rim;
    const double left = std::floor(x);
    const double top = std::floor(y);
    const auto step = static_cast<std::ptrdiff_t>(level.step[0]);
    return Samples{level.data + static_cast<std::ptrdiff_t>(top) * step +
                       static_cast<std::ptrdiff_t>(left),
                   step,
                   static_cast<float>(x - left),
                   static_cast<float>(y - top)};
  }
};

// One level's search. False: the patch leaves the image or tells nothing; what
// `point_px` is then means nothing either.
bool FollowOnLevel(const cv::Mat& from,
                   const cv::Mat& to,
                   const cv::Point2d& from_px,
                   const PatchFlowOptions& options,
                   Patch& patch,
                   cv::Point2d& point_px) {
  const auto taken = Samples::Around(from, from_px, /*rim=*/1);
  if (!taken) return false;
  alignas(32) float sums[3 * kVectorFloats];
  GROUNDLOCK_WIDEST(TakePatch)
  (taken->top_left, taken->step, taken->u, taken->v, patch, sums);
  const double xx = Sum(sums);
  const double xy = Sum(sums + kVectorFloats);
  const double yy = Sum(sums + 2 * kVectorFloats);
  const double least = 0.5 * (xx + yy - std::hypot(xx - yy, 2.0 * xy));
  const double determinant = xx * yy - xy * xy;
  if (!(least > kMinSlopeSquared * kSide * kSide) || !(determinant > 0.0)) {
    return false;
  }
  cv::Point2d last_step;
  for (int i = 0; i < options.max_iterations; ++i) {
    const auto samples = Samples::Around(to, point_px, /*rim=*/0);
    if (!samples) return false;
    GROUNDLOCK_WIDEST(CompareSlopes)
    (samples->top_left, samples->step, samples->u, samples->v, patch, sums);
    const double bx = Sum(sums);
    const double by = Sum(sums + kVectorFloats);
    const cv::Point2d step((yy * bx - xy * by) / determinant,
                           (xx * by - xy * bx) / determinant);
    point_px += step;
    if (step.dot(step) <= options.epsilon_px * options.epsilon_px) break;
    const cv::Point2d both = step + last_step;
    if (i > 0 && std::abs(both.x) < kOscillationPx &&
        std::abs(both.y) < kOscillationPx) {
      point_px -= 0.5 * step;
      break;
    }
    last_step = step;
  }
  return true;
}

}  // namespace

std::optional<PatchFlow> FollowPatch(const LumaPyramid& from,
                                     const LumaPyramid& to,
                                     const cv::Point2d& from_px,
                                     const cv::Point2d& start_px,
                                     const PatchFlowOptions& options) {
  const int num_levels =
      static_cast<int>(std::min(from.levels.size(), to.levels.size()));
  if (options.finest_level >= num_levels) return std::nullopt;
  Patch patch;
  cv::Point2d point_px = start_px;
  for (int level = std::clamp(
           options.coarsest_level, options.finest_level, num_levels - 1);
       level >= options.finest_level;
       --level) {
    const double scale = 1 << level;
    cv::Point2d on_level = point_px / scale;
    const bool found = FollowOnLevel(from.levels[level],
                                     to.levels[level],
                                     from_px / scale,
                                     options,
                                     patch,
                                     on_level);
    if (found) {
      point_px = on_level * scale;
    } else if (level == options.finest_level) {
      return std::nullopt;
    }
  }
  const cv::Point2d on_finest = point_px / (1 << options.finest_level);
  const auto samples =
      Samples::Around(to.levels[options.finest_level], on_finest, /*rim=*/0);
  if (!samples) return std::nullopt;
  alignas(32) float sums[kVectorFloats];
  GROUNDLOCK_WIDEST(CompareValues)
  (samples->top_left, samples->step, samples->u, samples->v, patch, sums);
  return PatchFlow{point_px, Sum(sums) / (kSide * kSide)};
}

}  // namespace groundlock::image
