// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/sensor.h"

#include <algorithm>
#include <cmath>

#include "client/simulator/internal/parallel.h"
#include "map_store/base/mix_seed.h"

namespace groundlock::simulator {
namespace {

constexpr float kCornerLoss = 0.10F;
constexpr double kExposureSwing = 0.035;
constexpr double kExposureRate = 0.9;  // rad/s
// Variance of the noise in 8-bit units: read noise and shot noise.
constexpr float kReadVariance = 0.9F;
constexpr float kShotVariance = 0.018F;
constexpr std::size_t kTableSize = 1U << 16U;

}  // namespace

Sensor::Sensor(cv::Size size_px, std::uint64_t seed, int threads)
    : seed_(seed),
      threads_(threads),
      vignette_(size_px, CV_32F),
      normal_(kTableSize) {
  cv::RNG rng(base::MixSeed(seed, 0));
  for (float& value : normal_) value = static_cast<float>(rng.gaussian(1.0));
  const cv::Point2f middle(0.5F * static_cast<float>(size_px.width),
                           0.5F * static_cast<float>(size_px.height));
  const float corner2 = middle.dot(middle);
  vignette_.forEach<float>([&](float& value, const int* at) {
    const cv::Point2f p(static_cast<float>(at[1]) + 0.5F - middle.x,
                        static_cast<float>(at[0]) + 0.5F - middle.y);
    value = 1.0F - kCornerLoss * p.dot(p) / corner2;
  });
}

cv::Mat Sensor::Expose(const cv::Mat& rendered, int frame, double t_s) const {
  cv::Mat image(rendered.size(), CV_8UC3);
  const auto gain =
      static_cast<float>(1.0 + kExposureSwing * std::sin(kExposureRate * t_s));
  const std::uint64_t frame_seed = base::MixSeed(seed_, frame + 1);
  ParallelFor(rendered.rows, threads_, [&](int y) {
    const float* in = rendered.ptr<float>(y);
    const float* shade = vignette_.ptr<float>(y);
    auto* out = image.ptr<uchar>(y);
    std::uint64_t state = base::MixSeed(frame_seed, y) | 1U;
    for (int x = 0; x < rendered.cols; ++x) {
      // Xorshift (Marsaglia 2003), 16 bits of it for each channel.
      state ^= state << 13U;
      state ^= state >> 7U;
      state ^= state << 17U;
      for (int c = 0; c < 3; ++c) {
        const float signal = in[3 * x + c] * shade[x] * gain;
        const float sigma =
            std::sqrt(kReadVariance + kShotVariance * std::max(0.0F, signal));
        const float noise = normal_[(state >> (16U * c)) & (kTableSize - 1)];
        out[3 * x + c] = cv::saturate_cast<uchar>(signal + sigma * noise);
      }
    }
  });
  return image;
}

}  // namespace groundlock::simulator
