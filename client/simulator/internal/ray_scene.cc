// SPDX-License-Identifier: Apache-2.0
#include "client/simulator/internal/ray_scene.h"

#include <cstring>

#include "absl/strings/str_cat.h"

namespace groundlock::simulator {
namespace {

constexpr float kNear_m = 1e-3F;  // clears the surface that a ray starts on

}  // namespace

absl::StatusOr<std::unique_ptr<RayScene>> RayScene::Create(
    const std::vector<Corners>& quads) {
  // One thread builds: the scenes are small, and the tree does not depend on
  // it.
  RTCDevice device = rtcNewDevice("threads=1");
  if (device == nullptr) {
    return absl::InternalError(
        absl::StrCat("Embree has no device, error ",
                     static_cast<int>(rtcGetDeviceError(nullptr))));
  }
  RTCScene scene = rtcNewScene(device);
  std::unique_ptr<RayScene> result(new RayScene(device, scene));
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_QUAD);
  auto* vertices =
      static_cast<float*>(rtcSetNewGeometryBuffer(geometry,
                                                  RTC_BUFFER_TYPE_VERTEX,
                                                  0,
                                                  RTC_FORMAT_FLOAT3,
                                                  3 * sizeof(float),
                                                  4 * quads.size()));
  auto* indices =
      static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry,
                                                     RTC_BUFFER_TYPE_INDEX,
                                                     0,
                                                     RTC_FORMAT_UINT4,
                                                     4 * sizeof(unsigned),
                                                     quads.size()));
  if (vertices == nullptr || indices == nullptr) {
    rtcReleaseGeometry(geometry);
    return absl::ResourceExhaustedError("Embree cannot allocate the scene");
  }
  unsigned next = 0;
  for (const Corners& quad : quads) {
    for (const Eigen::Vector3f& corner : quad) {
      std::memcpy(vertices + 3 * next, corner.data(), 3 * sizeof(float));
      indices[next] = next;
      ++next;
    }
  }
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(scene);
  if (const RTCError error = rtcGetDeviceError(device);
      error != RTC_ERROR_NONE) {
    return absl::InternalError(absl::StrCat(
        "Embree cannot build the scene, error ", static_cast<int>(error)));
  }
  return result;
}

RayScene::~RayScene() {
  rtcReleaseScene(scene_);
  rtcReleaseDevice(device_);
}

bool RayScene::Occluded(const Eigen::Vector3f& origin,
                        const Eigen::Vector3f& direction,
                        float distance) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay ray{};
  ray.org_x = origin.x();
  ray.org_y = origin.y();
  ray.org_z = origin.z();
  ray.dir_x = direction.x();
  ray.dir_y = direction.y();
  ray.dir_z = direction.z();
  ray.tnear = kNear_m;
  ray.tfar = distance;
  ray.mask = ~0U;
  rtcOccluded1(scene_, &context, &ray);
  return ray.tfar < 0.0F;  // Embree's sign of a hit
}

}  // namespace groundlock::simulator
