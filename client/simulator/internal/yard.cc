// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "client/simulator/internal/paint.h"
#include "client/simulator/internal/parallel.h"
#include "client/simulator/internal/scene_model.h"
#include "map_store/base/mix_seed.h"

namespace groundlock::simulator {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kWallHeight_m = 4.2F;
constexpr int kGroundSide_px = 4'096;
constexpr float kWall_px_per_m = 110.0F;
constexpr float kProp_px_per_m = 190.0F;
constexpr float kGroundLight_m = 0.05F;  // grid step of baked light
constexpr float kPropLight_m = 0.06F;
constexpr float kWallLight_m = 0.12F;
constexpr int kTerrainCells = 104;  // along a side: 0.25 m each
constexpr int kBarrelSegments = 32;

// Collects surfaces; their paint is made afterwards, in parallel, each from a
// generator of its own, so that threads cannot change it.
class Builder {
 public:
  using Paint = std::function<cv::Mat(cv::RNG&, cv::Size, float px_per_m)>;
  Builder(const Terrain& terrain, float detail)
      : terrain_(terrain), detail_(detail) {}

  // A square of terrain about the origin.
  void Ground(float half_m, float px_per_m, float light_m, Paint paint) {
    const Vector2f corner(-half_m, half_m);
    const float side_m = 2 * half_m;
    const auto at = [terrain = terrain_, corner, side_m](float u, float v) {
      const float x = corner.x() + u * side_m;
      const float y = corner.y() - v * side_m;
      return SurfacePoint{
          Vector3f(x, y, static_cast<float>(terrain.HeightAt(x, y))),
          terrain.NormalAt(x, y).cast<float>()};
    };
    const int index = AddSurface(
        {side_m, side_m}, px_per_m, light_m, false, std::move(paint), at);
    const int cells = terrain_.is_level() ? 1 : kTerrainCells;
    const float step = 1.0F / static_cast<float>(cells);
    for (int row = 0; row < cells; ++row) {
      for (int column = 0; column < cells; ++column) {
        const float u = static_cast<float>(column) * step;
        const float v = static_cast<float>(row) * step;
        scene_.quads.push_back({{at(u, v).p_world,
                                 at(u + step, v).p_world,
                                 at(u + step, v + step).p_world,
                                 at(u, v + step).p_world},
                                Vector2f(u, v),
                                Vector2f(step, 0),
                                Vector2f(0, step),
                                at(u + step / 2, v + step / 2).normal_world,
                                index});
      }
    }
  }

  // A rectangle seen from the side that its normal across x up... points to.
  //   top_left, right, down: world; right and down span the rectangle.
  void Rectangle(const Vector3f& top_left,
                 const Vector3f& right,
                 const Vector3f& down,
                 float px_per_m,
                 float light_m,
                 Paint paint) {
    const Vector3f normal = down.cross(right).normalized();
    const int index = AddSurface(
        {right.norm(), down.norm()},
        px_per_m,
        light_m,
        false,
        std::move(paint),
        [=](float u, float v) {
          return SurfacePoint{top_left + u * right + v * down, normal};
        });
    scene_.quads.push_back(
        {{top_left, top_left + right, top_left + right + down, top_left + down},
         Vector2f(0, 0),
         Vector2f(1, 0),
         Vector2f(0, 1),
         normal,
         index});
  }

  // A box on the ground, or bottom_m above it, without its bottom.
  void Box(const Vector2f& center,
           const Vector3f& size,
           float yaw_rad,
           Prop style,
           const cv::Scalar& color,
           float bottom_m = 0.0F) {
    const Paint paint = [=](cv::RNG& rng, cv::Size px, float density) {
      return PaintProp(rng, style, px, density, color);
    };
    const Eigen::Matrix3f R =
        Eigen::AngleAxisf(yaw_rad, Vector3f::UnitZ()).toRotationMatrix();
    const Vector3f x = R.col(0) * size.x();
    const Vector3f y = R.col(1) * size.y();
    const float lift = HeightAt(center);
    // Sides reach down to where the ground is lowest under them.
    float sink = 0.0F;
    for (const Vector3f& corner :
         std::array<Vector3f, 4>{x + y, x - y, y - x, -x - y}) {
      sink = std::max(sink, lift - HeightAt(center + 0.5F * corner.head<2>()));
    }
    const Vector3f down(0, 0, -size.z() - (bottom_m > 0.0F ? 0.0F : sink));
    const Vector3f middle(center.x(), center.y(), lift + bottom_m + size.z());
    const auto side = [&](const Vector3f& left, const Vector3f& right) {
      Rectangle(middle + left,
                right - left,
                down,
                kProp_px_per_m,
                kPropLight_m,
                paint);
    };
    side(-x / 2 - y / 2, x / 2 - y / 2);
    side(x / 2 - y / 2, x / 2 + y / 2);
    side(x / 2 + y / 2, -x / 2 + y / 2);
    side(-x / 2 + y / 2, -x / 2 - y / 2);
    Rectangle(
        middle - x / 2 + y / 2, x, -y, kProp_px_per_m, kPropLight_m, paint);
  }

  void Barrel(const Vector2f& center,
              float radius,
              float height,
              const cv::Scalar& color) {
    const Paint paint = [=](cv::RNG& rng, cv::Size px, float density) {
      return PaintProp(rng, Prop::kBarrel, px, density, color);
    };
    const float lift = HeightAt(center);
    float foot = lift;  // where the ground is lowest under it
    for (int i = 0; i < kBarrelSegments; ++i) {
      const float angle = 2 * std::numbers::pi_v<float> *
                          static_cast<float>(i) / kBarrelSegments;
      foot = std::min(foot,
                      HeightAt(center + radius * Vector2f(std::cos(angle),
                                                          std::sin(angle))));
    }
    const float top_m = lift + height;
    const auto rim = [=](float u, float z) {
      const float angle = 2 * std::numbers::pi_v<float> * u;
      return Vector3f(center.x() + radius * std::cos(angle),
                      center.y() + radius * std::sin(angle),
                      z);
    };
    const int side = AddSurface(
        {2 * std::numbers::pi_v<float> * radius, height},
        kProp_px_per_m,
        kPropLight_m,
        true,
        paint,
        [=](float u, float v) {
          const float angle = 2 * std::numbers::pi_v<float> * u;
          return SurfacePoint{rim(u, foot + (top_m - foot) * (1 - v)),
                              Vector3f(std::cos(angle), std::sin(angle), 0)};
        });
    const int lid = AddSurface({2 * radius, 2 * radius},
                               kProp_px_per_m,
                               kPropLight_m,
                               false,
                               paint,
                               [=](float u, float v) {
                                 return SurfacePoint{
                                     Vector3f(center.x() + radius * (2 * u - 1),
                                              center.y() - radius * (2 * v - 1),
                                              top_m),
                                     Vector3f::UnitZ()};
                               });
    const float step = 1.0F / kBarrelSegments;
    for (int i = 0; i < kBarrelSegments; ++i) {
      const float u = i * step;
      const float middle = 2 * std::numbers::pi_v<float> * (u + step / 2);
      scene_.quads.push_back({{rim(u, top_m),
                               rim(u + step, top_m),
                               rim(u + step, foot),
                               rim(u, foot)},
                              Vector2f(u, 0),
                              Vector2f(step, 0),
                              Vector2f(0, 1),
                              Vector3f(std::cos(middle), std::sin(middle), 0),
                              side});
      const auto on_lid = [&](float at) {
        return Vector2f(
            0.5F + 0.5F * std::cos(2 * std::numbers::pi_v<float> * at),
            0.5F - 0.5F * std::sin(2 * std::numbers::pi_v<float> * at));
      };
      const Vector2f middle_uv(0.5F, 0.5F);
      const Vector3f top(center.x(), center.y(), top_m);
      scene_.quads.push_back(
          {{top, rim(u, top_m), rim(u + step, top_m), rim(u + step, top_m)},
           middle_uv,
           on_lid(u) - middle_uv,
           on_lid(u + step) - middle_uv,
           Vector3f::UnitZ(),
           lid});
    }
  }

  SceneModel Finish(std::uint64_t seed, int threads) {
    ParallelFor(static_cast<int>(paints_.size()), threads, [&](int i) {
      cv::RNG rng(base::MixSeed(seed, i));
      Surface& surface = scene_.surfaces[i];
      surface.albedo = paints_[i](rng, sizes_px_[i], surface.texels_per_m);
    });
    return std::move(scene_);
  }

 private:
  int AddSurface(const Vector2f& size_m,
                 float px_per_m,
                 float light_m,
                 bool wrap_u,
                 Paint paint,
                 std::function<SurfacePoint(float, float)> at) {
    px_per_m *= detail_;
    light_m /= detail_;
    const auto pixels = [&](float length) {
      return std::max(8, static_cast<int>(std::lround(length * px_per_m)));
    };
    const auto cells = [&](float length) {
      return std::max(2, static_cast<int>(std::lround(length / light_m)));
    };
    Surface surface;
    surface.texels_per_m = px_per_m;
    surface.wrap_u = wrap_u;
    surface.light_grid = {cells(size_m.x()), cells(size_m.y())};
    surface.at = std::move(at);
    scene_.surfaces.push_back(std::move(surface));
    sizes_px_.emplace_back(pixels(size_m.x()), pixels(size_m.y()));
    paints_.push_back(std::move(paint));
    return static_cast<int>(paints_.size()) - 1;
  }

  float HeightAt(const Vector2f& at) const {
    return static_cast<float>(terrain_.HeightAt(at.x(), at.y()));
  }

  const Terrain& terrain_;
  float detail_;
  SceneModel scene_;
  std::vector<Paint> paints_;
  std::vector<cv::Size> sizes_px_;
};

// highest_m: of the ground.
void AddGroundAndWalls(Builder& builder, float highest_m) {
  constexpr float h = kHalfYard_m;
  builder.Ground(h,
                 kGroundSide_px / (2 * h),
                 kGroundLight_m,
                 [](cv::RNG& rng, cv::Size px, float density) {
                   return PaintGround(
                       rng, px.width, static_cast<float>(px.width) / density);
                 });
  const auto wall = [&](const Vector3f& left, const Vector3f& right, Facade s) {
    const Vector3f up(0, 0, kWallHeight_m + highest_m);
    const Vector3f down(0, 0, -kWallHeight_m - 2 * highest_m);
    builder.Rectangle(left + up,
                      right - left,
                      down,
                      kWall_px_per_m,
                      kWallLight_m,
                      [s](cv::RNG& rng, cv::Size px, float density) {
                        return PaintFacade(rng, s, px, density);
                      });
  };
  wall({-h, h, 0}, {h, h, 0}, Facade::kPlaster);
  wall({h, h, 0}, {h, -h, 0}, Facade::kBrick);
  wall({h, -h, 0}, {-h, -h, 0}, Facade::kBlocks);
  wall({-h, -h, 0}, {-h, h, 0}, Facade::kPlanks);
}

const cv::Scalar kGreen(70, 120, 60);
const cv::Scalar kBlue(150, 95, 50);
const cv::Scalar kWood(95, 140, 175);
const cv::Scalar kGrey(150, 155, 158);
const cv::Scalar kYellow(60, 175, 205);
const cv::Scalar kTeal(140, 140, 60);

void AddProps(Builder& b) {
  // The obstacle of the sequence "occlusion".
  b.Box({0.0F, 0.3F}, {1.75F, 0.9F, 1.1F}, 0.06F, Prop::kMetal, kGreen);
  b.Box({-0.05F, 0.3F}, {1.85F, 1.0F, 0.09F}, 0.06F, Prop::kMetal, kTeal, 1.1F);
  // Behind the drive.
  b.Box({-2.7F, 4.6F}, {0.9F, 0.9F, 0.8F}, 0.3F, Prop::kCrate, kWood);
  b.Box({-3.7F, 5.0F}, {1.0F, 0.8F, 0.9F}, -0.2F, Prop::kCrate, kYellow);
  b.Box({-2.7F, 4.7F}, {0.6F, 0.6F, 0.5F}, 0.7F, Prop::kCrate, kGrey, 0.8F);
  b.Barrel({3.0F, 3.7F}, 0.3F, 0.9F, kBlue);
  b.Barrel({3.75F, 4.1F}, 0.3F, 0.9F, kYellow);
  b.Barrel({2.6F, 4.6F}, 0.3F, 0.9F, kGrey);
  b.Box({0.9F, 6.6F}, {2.2F, 0.12F, 1.5F}, -0.1F, Prop::kPoster, kGrey, 0.3F);
  b.Box({-2.2F, 11.4F}, {3.4F, 2.0F, 2.5F}, 0.05F, Prop::kStone, kTeal);
  b.Box({4.7F, 7.4F}, {1.2F, 1.2F, 0.6F}, 0.5F, Prop::kStone, kGrey);
  b.Barrel({-4.3F, 3.2F}, 0.05F, 3.4F, kGrey);
  b.Box({-4.3F, 3.2F}, {0.9F, 0.06F, 0.7F}, 0.25F, Prop::kPoster, kGrey, 2.2F);
  b.Barrel({5.3F, 5.6F}, 0.05F, 3.4F, kGrey);
  b.Box({5.3F, 5.6F}, {0.9F, 0.06F, 0.7F}, -0.3F, Prop::kPoster, kGrey, 2.1F);
  // Around the yard.
  b.Box({4.4F, -1.4F}, {0.8F, 0.8F, 0.7F}, 0.4F, Prop::kCrate, kWood);
  b.Barrel({4.6F, 1.1F}, 0.3F, 0.9F, kTeal);
  b.Box({-4.1F, -2.6F}, {1.2F, 1.0F, 0.5F}, 0.2F, Prop::kCrate, kWood);
  b.Box({11.2F, 5.2F}, {0.12F, 2.4F, 1.6F}, 0.1F, Prop::kPoster, kGrey, 0.3F);
  b.Box({11.0F, -2.0F}, {1.0F, 1.4F, 1.1F}, 0.2F, Prop::kCrate, kYellow);
  b.Box({11.3F, -6.2F}, {1.1F, 1.1F, 0.9F}, -0.3F, Prop::kMetal, kBlue);
  b.Barrel({-10.9F, -3.2F}, 0.3F, 0.9F, kGreen);
  b.Barrel({-11.2F, 2.1F}, 0.3F, 0.9F, kYellow);
  b.Box(
      {-11.2F, 7.1F}, {0.12F, 2.2F, 1.6F}, -0.15F, Prop::kPoster, kGrey, 0.3F);
  b.Box({-10.4F, -9.6F}, {1.8F, 1.2F, 1.3F}, 0.5F, Prop::kMetal, kTeal);
  b.Box({-6.2F, 10.9F}, {1.3F, 1.0F, 1.2F}, 0.15F, Prop::kCrate, kWood);
  b.Box({2.6F, 11.2F}, {1.4F, 0.9F, 1.0F}, -0.2F, Prop::kMetal, kBlue);
  b.Box({-1.6F, -11.6F}, {1.6F, 0.8F, 1.0F}, 0.1F, Prop::kCrate, kGrey);
  b.Box({0.4F, -8.6F}, {0.7F, 0.7F, 0.7F}, 0.6F, Prop::kCrate, kYellow);
}

}  // namespace

SceneModel BuildYard(const Terrain& terrain,
                     std::uint64_t seed,
                     float detail,
                     int threads) {
  Builder builder(terrain, detail);
  AddGroundAndWalls(builder, static_cast<float>(terrain.MaxHeight()));
  AddProps(builder);
  SceneModel scene = builder.Finish(seed, threads);
  // Azimuth 215 degrees from +x to +y, elevation 47 degrees.
  const float azimuth = 215.0F * std::numbers::pi_v<float> / 180.0F;
  const float elevation = 47.0F * std::numbers::pi_v<float> / 180.0F;
  scene.to_sun = Vector3f(std::cos(elevation) * std::cos(azimuth),
                          std::cos(elevation) * std::sin(azimuth),
                          std::sin(elevation));
  return scene;
}

}  // namespace groundlock::simulator
