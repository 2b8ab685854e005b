// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "client/simulator/internal/parallel.h"
#include "map_store/base/mix_seed.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector3f;

constexpr int kSunSamples = 12;
constexpr int kSkySamples = 16;
constexpr float kSunRadius = 0.03F;  // rad; wider than ours: softer shadows
constexpr float kSkyReach_m = 3.0F;  // contact shading fades beyond it
constexpr float kLift_m = 2e-3F;
constexpr float kGamma = 2.2F;
constexpr int kDisplaySteps = 4'096;
constexpr float kDisplayRange = 2.0F;  // radiance at the last step
constexpr float kBrightest = 8.0F;     // radiance that is shown as white

float Unit(std::uint64_t& state) {
  state = base::MixSeed(state, 1);
  return static_cast<float>(state >> 40U) * 0x1.0p-24F;
}

// Directions around `axis`: two unit vectors that complete a frame.
void Complete(const Vector3f& axis, Vector3f* u, Vector3f* v) {
  *u = axis.unitOrthogonal();
  *v = axis.cross(*u);
}

struct Light {
  float sun = 0.0F;  // cosine times the seen share of the sun's disc
  float sky = 0.0F;  // seen share of the dome, cosine-weighted
};

Light LightAt(const SurfacePoint& at,
              const Vector3f& to_sun,
              const RayScene& rays,
              std::uint64_t state) {
  constexpr float kTwoPi = 6.2831853F;
  Light light;
  const Vector3f origin = at.p_world + kLift_m * at.normal_world;
  Vector3f u;
  Vector3f v;
  const float cosine = at.normal_world.dot(to_sun);
  if (cosine > 0.0F) {
    Complete(to_sun, &u, &v);
    int seen = 0;
    for (int i = 0; i < kSunSamples; ++i) {
      const float r =
          kSunRadius *
          std::sqrt((static_cast<float>(i) + Unit(state)) / kSunSamples);
      const float angle = kTwoPi * Unit(state);
      const Vector3f direction =
          (to_sun + r * (std::cos(angle) * u + std::sin(angle) * v))
              .normalized();
      if (!rays.Occluded(origin, direction, 60.0F)) ++seen;
    }
    light.sun = cosine * static_cast<float>(seen) / kSunSamples;
  }
  Complete(at.normal_world, &u, &v);
  int open = 0;
  for (int i = 0; i < kSkySamples; ++i) {
    const float r2 = (static_cast<float>(i) + Unit(state)) / kSkySamples;
    const float r = std::sqrt(r2);
    const float angle = kTwoPi * Unit(state);
    const Vector3f direction = r * (std::cos(angle) * u + std::sin(angle) * v) +
                               std::sqrt(1.0F - r2) * at.normal_world;
    if (!rays.Occluded(origin, direction, kSkyReach_m)) ++open;
  }
  const float upwards = 0.75F + 0.25F * at.normal_world.z();
  light.sky = upwards * static_cast<float>(open) / kSkySamples;
  return light;
}

std::uint8_t DisplayByFormula(float radiance) {
  // Linear up to 0.7, then bent so that 2.0 just reaches white.
  const float knee = 0.7F;
  const float bent =
      radiance < knee
          ? radiance
          : knee + 0.3F * (1.0F - std::exp(-(radiance - knee) / 0.45F));
  return static_cast<std::uint8_t>(
      std::lround(255.0F * std::pow(std::clamp(bent, 0.0F, 1.0F), 1 / kGamma)));
}

std::array<float, 256> LinearTable() {
  std::array<float, 256> table{};
  for (int i = 0; i < 256; ++i) {
    table[i] = std::pow(static_cast<float>(i) / 255.0F, kGamma);
  }
  return table;
}

std::array<std::uint8_t, kDisplaySteps> DisplayTable() {
  std::array<std::uint8_t, kDisplaySteps> table{};
  for (int i = 0; i < kDisplaySteps; ++i) {
    table[i] = Display(kDisplayRange * static_cast<float>(i) / kDisplaySteps);
  }
  return table;
}

cv::Mat Lit(const cv::Mat& albedo, const cv::Mat& light, int threads) {
  static const auto linear = LinearTable();
  static const auto display = DisplayTable();
  cv::Mat lit(albedo.size(), CV_8UC4);
  ParallelFor(albedo.rows, threads, [&](int y) {
    const auto* paint = albedo.ptr<cv::Vec3b>(y);
    auto* out = lit.ptr<cv::Vec4b>(y);
    // The light grid's samples are texel centres of a coarse texture.
    const float gy = (static_cast<float>(y) + 0.5F) /
                         static_cast<float>(albedo.rows) *
                         static_cast<float>(light.rows) -
                     0.5F;
    const int y0 =
        std::clamp(static_cast<int>(std::floor(gy)), 0, light.rows - 1);
    const int y1 = std::min(y0 + 1, light.rows - 1);
    const float fy = std::clamp(gy - static_cast<float>(y0), 0.0F, 1.0F);
    const auto* row0 = light.ptr<cv::Vec2f>(y0);
    const auto* row1 = light.ptr<cv::Vec2f>(y1);
    const float step =
        static_cast<float>(light.cols) / static_cast<float>(albedo.cols);
    for (int x = 0; x < albedo.cols; ++x) {
      const float gx = (static_cast<float>(x) + 0.5F) * step - 0.5F;
      const int x0 =
          std::clamp(static_cast<int>(std::floor(gx)), 0, light.cols - 1);
      const int x1 = std::min(x0 + 1, light.cols - 1);
      const float fx = std::clamp(gx - static_cast<float>(x0), 0.0F, 1.0F);
      const cv::Vec2f top = row0[x0] * (1 - fx) + row0[x1] * fx;
      const cv::Vec2f bottom = row1[x0] * (1 - fx) + row1[x1] * fx;
      const cv::Vec2f sum = top * (1 - fy) + bottom * fy;
      const float sun = kSunLight * sum[0];
      const float total = sun + kSkyLight * sum[1] + 0.03F;
      for (int c = 0; c < 3; ++c) {
        const float radiance = linear[paint[x][c]] * total;
        const int index =
            static_cast<int>(radiance * (kDisplaySteps / kDisplayRange));
        out[x][c] = display[std::min(index, kDisplaySteps - 1)];
      }
      out[x][3] = static_cast<uchar>(std::lround(255.0F * sun / total));
    }
  });
  return lit;
}

}  // namespace

std::uint8_t Display(float radiance) {
  // A display value's threshold is found once: of its bits, which for what is
  // positive are in the order of the numbers.
  static const std::array<float, 255> thresholds = [] {
    std::array<float, 255> least{};
    std::uint32_t low = 0;
    for (std::size_t value = 1; value <= least.size(); ++value) {
      std::uint32_t high = std::bit_cast<std::uint32_t>(kBrightest);
      while (low < high) {
        const std::uint32_t middle = low + (high - low) / 2;
        if (DisplayByFormula(std::bit_cast<float>(middle)) < value) {
          low = middle + 1;
        } else {
          high = middle;
        }
      }
      least[value - 1] = std::bit_cast<float>(low);
    }
    return least;
  }();
  return static_cast<std::uint8_t>(
      std::upper_bound(thresholds.begin(), thresholds.end(), radiance) -
      thresholds.begin());
}

std::vector<Texture> BakeLight(SceneModel& scene,
                               const RayScene& rays,
                               std::uint64_t seed,
                               int threads) {
  std::vector<Texture> textures;
  for (std::size_t i = 0; i < scene.surfaces.size(); ++i) {
    Surface& surface = scene.surfaces[i];
    const cv::Size grid = surface.light_grid;
    cv::Mat light(grid, CV_32FC2);
    ParallelFor(grid.height, threads, [&](int y) {
      for (int x = 0; x < grid.width; ++x) {
        const float u =
            (static_cast<float>(x) + 0.5F) / static_cast<float>(grid.width);
        const float v =
            (static_cast<float>(y) + 0.5F) / static_cast<float>(grid.height);
        const std::uint64_t cell = base::MixSeed(seed + i, y * grid.width + x);
        const Light at = LightAt(surface.at(u, v), scene.to_sun, rays, cell);
        light.at<cv::Vec2f>(y, x) = {at.sun, at.sky};
      }
    });
    cv::GaussianBlur(light, light, cv::Size(3, 3), 0.7);
    textures.emplace_back(Lit(surface.albedo, light, threads), surface.wrap_u);
    surface.albedo.release();
  }
  return textures;
}

}  // namespace groundlock::simulator
