// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/renderer.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "client/simulator/internal/light.h"
#include "client/simulator/internal/parallel.h"
#include "map_store/base/status.h"

namespace groundlock::simulator {
namespace {

using Eigen::Matrix3f;
using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr int kPacket = 8;
constexpr float kFar_m = 200.0F;
constexpr float kShadowReach_m = 1.4F;  // from the car's middle
constexpr float kCarRadius_m = 0.56F;   // of the sphere around the cuboid
constexpr unsigned kNone = RTC_INVALID_GEOMETRY_ID;

// The place of sample `index` of `count` in the pixel: every column and row of
// a count x count grid is used once, so that the mean is the pixel's centre.
// The order follows the R2 sequence (Roberts 2018: the plastic number's
// powers).
Vector2f SampleOffset(int index, int count) {
  const auto stratum = [&](double step) {
    const auto value = [&](int i) { return i * step - std::floor(i * step); };
    int rank = 0;
    for (int i = 0; i < count; ++i) rank += value(i) < value(index) ? 1 : 0;
    return (static_cast<float>(rank) + 0.5F) / static_cast<float>(count);
  };
  return {stratum(0.7548776662466927), stratum(0.5698402909980532)};
}

Float4 Sky(const Vector3f& direction) {
  const float f = std::clamp(direction.z() * 1.6F, 0.0F, 1.0F);
  const Float4 low = {236.0F, 226.0F, 214.0F, 0.0F};
  const Float4 high = {218.0F, 176.0F, 132.0F, 0.0F};
  return low + (high - low) * f;
}

// x^(1/2.2) for the ratio of two radiances, applied to display values.
float DisplayRatio(float ratio) {
  return ratio == 1.0F ? 1.0F : std::pow(ratio, 1.0F / 2.2F);
}

RTCRayHit8 EmptyPacket() {
  RTCRayHit8 packet;
  for (int i = 0; i < kPacket; ++i) {
    packet.ray.tnear[i] = 0.0F;
    packet.ray.tfar[i] = kFar_m;
    packet.ray.time[i] = 0.0F;
    packet.ray.mask[i] = ~0U;
    packet.ray.id[i] = static_cast<unsigned>(i);
    packet.ray.flags[i] = 0U;
    packet.hit.geomID[i] = kNone;
    packet.hit.instID[0][i] = kNone;
  }
  return packet;
}

void SetRay(RTCRayHit8& packet, int i, const Vector3f& o, const Vector3f& d) {
  packet.ray.org_x[i] = o.x();
  packet.ray.org_y[i] = o.y();
  packet.ray.org_z[i] = o.z();
  packet.ray.dir_x[i] = d.x();
  packet.ray.dir_y[i] = d.y();
  packet.ray.dir_z[i] = d.z();
}

}  // namespace

struct Renderer::CarView {
  Vector3f car_world;
  Matrix3f car_from_world;
  Vector3f to_sun_car;
  // Pixels that may show the car, half-open.
  std::array<int, 2> rows{};
  std::array<int, 2> columns{};
};

struct Renderer::View {
  Vector3f camera_world;
  Matrix3f world_from_camera;
  Vector2f offset;  // of the sample within each pixel
  std::vector<CarView> cars;
};

absl::StatusOr<std::unique_ptr<Renderer>> Renderer::Create(SceneModel scene,
                                                           const Lens& lens,
                                                           std::uint64_t seed,
                                                           int threads) {
  std::unique_ptr<Renderer> renderer(
      new Renderer(std::move(scene), lens, threads));
  std::vector<RayScene::Corners> quads;
  for (const Quad& quad : renderer->scene_.quads) {
    quads.push_back(quad.corners_world);
  }
  ASSIGN_OR_RETURN(renderer->scene_rays_, RayScene::Create(quads));
  quads.clear();
  for (const CarFace& face : renderer->car_) quads.push_back(face.corners_car);
  ASSIGN_OR_RETURN(renderer->car_rays_, RayScene::Create(quads));
  renderer->textures_ =
      BakeLight(renderer->scene_, *renderer->scene_rays_, seed, threads);
  return renderer;
}

Renderer::Renderer(SceneModel scene, const Lens& lens, int threads)
    : scene_(std::move(scene)),
      lens_(lens),
      threads_(threads),
      car_(BuildCar()),
      corners_(lens.height_px + 1, lens.width_px + 1, CV_32FC2) {
  ParallelFor(corners_.rows, threads, [&](int y) {
    for (int x = 0; x < corners_.cols; ++x) {
      const Eigen::Vector2d at = lens_.Undistort(x, y);
      corners_.at<cv::Vec2f>(y, x) = {static_cast<float>(at.x()),
                                      static_cast<float>(at.y())};
    }
  });
}

bool Renderer::Blocked(const Eigen::Vector3d& a_world,
                       const Eigen::Vector3d& b_world) const {
  const Eigen::Vector3d way = b_world - a_world;
  const double distance = way.norm();
  return scene_rays_->Occluded(a_world.cast<float>(),
                               (way / distance).cast<float>(),
                               static_cast<float>(distance) - 2e-3F);
}

bool Renderer::BlockedByCar(const geometry::Rigid3& world_from_car,
                            const Eigen::Vector3d& a_world,
                            const Eigen::Vector3d& b_world) const {
  const geometry::Rigid3 car_from_world = world_from_car.Inverse();
  const Eigen::Vector3d a_car = car_from_world * a_world;
  const Eigen::Vector3d way = car_from_world * b_world - a_car;
  const double distance = way.norm();
  return car_rays_->Occluded(a_car.cast<float>(),
                             (way / distance).cast<float>(),
                             static_cast<float>(distance) - 2e-3F);
}

Renderer::CarView Renderer::PrepareCar(
    const geometry::Rigid3& world_from_camera,
    const geometry::Rigid3& world_from_car) const {
  CarView view;
  view.car_world = world_from_car.translation.cast<float>();
  view.car_from_world =
      world_from_car.rotation.toRotationMatrix().cast<float>().transpose();
  view.to_sun_car = view.car_from_world * scene_.to_sun;
  // A generous box around the bounding sphere; the whole image when it is
  // close.
  const Eigen::Vector3d middle =
      world_from_camera.Inverse() *
      (world_from_car.translation + Eigen::Vector3d(0, 0, kCarHeight_m / 2));
  view.rows = {0, lens_.height_px};
  view.columns = {0, lens_.width_px};
  if (middle.z() < -kCarRadius_m) {
    view.rows = {0, 0};
  } else if (const auto at = lens_.Project(middle);
             at.has_value() && middle.z() > 2 * kCarRadius_m) {
    const double radius_px = 1.3 * lens_.f * kCarRadius_m * middle.norm() /
                             (middle.z() * (middle.z() - kCarRadius_m));
    const auto clamp = [](double v, int high) {
      return static_cast<int>(std::clamp(v, 0.0, static_cast<double>(high)));
    };
    view.rows = {clamp(at->y() - radius_px, lens_.height_px),
                 clamp(at->y() + radius_px, lens_.height_px)};
    view.columns = {clamp(at->x() - radius_px, lens_.width_px),
                    clamp(at->x() + radius_px, lens_.width_px)};
  }
  return view;
}

Renderer::View Renderer::Prepare(const Moment& moment,
                                 int index,
                                 int count) const {
  View view;
  const Eigen::Matrix3d R =
      moment.world_from_camera.rotation.toRotationMatrix();
  view.camera_world = moment.world_from_camera.translation.cast<float>();
  view.world_from_camera = R.cast<float>();
  view.offset = SampleOffset(index, count);
  const auto add = [&](const geometry::Rigid3& world_from_car) {
    view.cars.push_back(PrepareCar(moment.world_from_camera, world_from_car));
  };
  if (moment.world_from_car) add(*moment.world_from_car);
  for (const auto& other : moment.world_from_other_cars) add(other);
  return view;
}

// How much of its display value a point keeps in the car's shadow.
float Renderer::CarShade(const CarView& view,
                         const Vector3f& p_world,
                         float sun_share,
                         bool is_lying) const {
  const Vector3f p_car = view.car_from_world * (p_world - view.car_world);
  if (p_car.squaredNorm() > kShadowReach_m * kShadowReach_m) return 1.0F;
  float light = 1.0F;
  if (sun_share > 0.01F &&
      car_rays_->Occluded(p_car, view.to_sun_car, 2 * kShadowReach_m)) {
    light -= sun_share;
  }
  if (is_lying && p_car.z() < 0.05F) {
    // The sky that the car's belly hides: by distance from its footprint.
    const Vector2f outside(std::max(std::abs(p_car.x()) - 0.40F, 0.0F),
                           std::max(std::abs(p_car.y()) - 0.20F, 0.0F));
    const float reach = std::clamp(1.0F - outside.norm() / 0.22F, 0.0F, 1.0F);
    light *= 1.0F - 0.7F * reach * reach;
  }
  return DisplayRatio(light);
}

Float4 Renderer::ShadeScene(const View& view,
                            unsigned quad_index,
                            float s,
                            float t,
                            float distance,
                            const Vector3f& direction) const {
  const Quad& quad = scene_.quads[quad_index];
  const Vector2f uv = quad.uv0 + s * quad.du + t * quad.dv;
  const Surface& surface = scene_.surfaces[quad.surface];
  // A pixel's footprint is f^-1 by distance across, and longer by 1/cosine
  // along the view; the samples in a pixel share that length among them.
  const float cosine = std::max(
      std::abs(direction.dot(quad.normal_world)) / direction.norm(), 0.02F);
  const float across = distance / static_cast<float>(lens_.f);
  const float footprint_m = across * std::max(1.0F, 0.35F / cosine);
  const float texels = footprint_m * surface.texels_per_m;
  const float lod = texels > 1.0F ? std::log2(texels) : 0.0F;
  Float4 color = textures_[quad.surface].Sample(uv.x(), uv.y(), lod);
  for (const CarView& car : view.cars) {
    const Vector3f p_world = view.camera_world + distance * direction;
    if ((p_world - car.car_world).squaredNorm() <
        kShadowReach_m * kShadowReach_m) {
      const bool is_lying = quad.normal_world.z() > 0.9F;
      color *= CarShade(car, p_world, color[3] / 255.0F, is_lying);
    }
  }
  return color;
}

Float4 Renderer::ShadeCar(const CarView& view,
                          unsigned face_index,
                          const Vector3f& p_car,
                          const Vector3f& direction_car) const {
  const CarFace& face = car_[face_index];
  const Vector3f& n = face.normal_car;
  const float cosine = n.dot(view.to_sun_car);
  float sun = 0.0F;
  if (cosine > 0.0F) {
    const Vector3f p_world =
        view.car_from_world.transpose() * p_car + view.car_world;
    const bool lit =
        !scene_rays_->Occluded(p_world, scene_.to_sun, 60.0F) &&
        !car_rays_->Occluded(p_car + 2e-3F * n, view.to_sun_car, 2.0F);
    sun = lit ? cosine : 0.0F;
  }
  // Under the body little sky is seen.
  const float height = std::clamp(p_car.z() / 0.12F, 0.15F, 1.0F);
  const float sky = (0.65F + 0.35F * n.z()) * height;
  const float light = kSunLight * sun + kSkyLight * sky + 0.03F;
  // Blinn-Phong gloss towards the sun, and the sky mirrored at grazing angles.
  const Vector3f to_eye = -direction_car.normalized();
  const Vector3f half = (to_eye + view.to_sun_car).normalized();
  const float shine =
      sun > 0.0F ? std::pow(std::max(0.0F, n.dot(half)), 40.0F) : 0.0F;
  const float fresnel =
      std::pow(1.0F - std::clamp(n.dot(to_eye), 0.0F, 1.0F), 4.0F);
  const float mirror = face.gloss * (1.6F * shine + 0.25F * fresnel + 0.03F);
  Float4 color{};
  for (int c = 0; c < 3; ++c) {
    color[c] = static_cast<float>(Display(face.color_bgr[c] * light + mirror));
  }
  return color;
}

void Renderer::RenderRow(int y,
                         std::span<const View> views,
                         float* row_bgr,
                         float* row_car) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  alignas(32) std::array<int, kPacket> valid{};
  std::array<Vector3f, kPacket> directions;
  const auto* above = corners_.ptr<cv::Vec2f>(y);
  const auto* below = corners_.ptr<cv::Vec2f>(y + 1);
  const float weight = 1.0F / static_cast<float>(views.size());
  for (const View& view : views) {
    for (int x0 = 0; x0 < lens_.width_px; x0 += kPacket) {
      alignas(32) RTCRayHit8 packet = EmptyPacket();
      for (int i = 0; i < kPacket; ++i) {
        const int x = std::min(x0 + i, lens_.width_px - 1);
        valid[i] = x0 + i < lens_.width_px ? -1 : 0;
        const cv::Vec2f at = above[x] +
                             view.offset.x() * (above[x + 1] - above[x]) +
                             view.offset.y() * (below[x] - above[x]);
        directions[i] = view.world_from_camera * Vector3f(at[0], at[1], 1.0F);
        SetRay(packet, i, view.camera_world, directions[i]);
      }
      rtcIntersect8(valid.data(), scene_rays_->get(), &context, &packet);
      // Of the cars, the nearest before the scene.
      std::array<Float4, kPacket> car_colors{};
      std::array<bool, kPacket> shows_car{};
      for (const CarView& view_of_car : view.cars) {
        if (y < view_of_car.rows[0] || y >= view_of_car.rows[1] ||
            x0 + kPacket <= view_of_car.columns[0] ||
            x0 >= view_of_car.columns[1]) {
          continue;
        }
        const Vector3f origin = view_of_car.car_from_world *
                                (view.camera_world - view_of_car.car_world);
        alignas(32) RTCRayHit8 car = EmptyPacket();
        for (int i = 0; i < kPacket; ++i) {
          SetRay(car, i, origin, view_of_car.car_from_world * directions[i]);
          car.ray.tfar[i] = packet.ray.tfar[i];
        }
        rtcIntersect8(valid.data(), car_rays_->get(), &context, &car);
        for (int i = 0; i < kPacket; ++i) {
          if (valid[i] == 0 || car.hit.geomID[i] == kNone) continue;
          const Vector3f along(
              car.ray.dir_x[i], car.ray.dir_y[i], car.ray.dir_z[i]);
          car_colors[i] = ShadeCar(view_of_car,
                                   car.hit.primID[i],
                                   origin + car.ray.tfar[i] * along,
                                   along);
          shows_car[i] = true;
          packet.ray.tfar[i] = car.ray.tfar[i];
        }
      }
      for (int i = 0; i < kPacket && valid[i] != 0; ++i) {
        Float4 color;
        if (shows_car[i]) {
          color = car_colors[i];
          if (row_car != nullptr) row_car[x0 + i] += weight;
        } else if (packet.hit.geomID[i] != kNone) {
          color = ShadeScene(view,
                             packet.hit.primID[i],
                             packet.hit.u[i],
                             packet.hit.v[i],
                             packet.ray.tfar[i],
                             directions[i]);
        } else {
          color = Sky(directions[i].normalized());
        }
        float* pixel = row_bgr + 3 * static_cast<std::ptrdiff_t>(x0 + i);
        for (int c = 0; c < 3; ++c) pixel[c] += weight * color[c];
      }
    }
  }
}

cv::Mat Renderer::Render(std::span<const Moment> moments,
                         cv::Mat* car_share) const {
  cv::Mat image = cv::Mat::zeros(lens_.height_px, lens_.width_px, CV_32FC3);
  if (car_share != nullptr) *car_share = cv::Mat::zeros(image.size(), CV_32F);
  std::vector<View> views;
  for (std::size_t i = 0; i < moments.size(); ++i) {
    views.push_back(Prepare(
        moments[i], static_cast<int>(i), static_cast<int>(moments.size())));
  }
  ParallelFor(lens_.height_px, threads_, [&](int y) {
    RenderRow(y,
              views,
              image.ptr<float>(y),
              car_share != nullptr ? car_share->ptr<float>(y) : nullptr);
  });
  return image;
}

}  // namespace groundlock::simulator
