// SPDX-License-Identifier: Apache-2.0
// Embree behind two owning types.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_RAY_SCENE_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_RAY_SCENE_H_

#include <embree3/rtcore.h>

#include <Eigen/Core>
#include <array>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::simulator {

// Quads to trace rays against. Immutable; queries are thread-safe.
class RayScene {
 public:
  using Corners = std::array<Eigen::Vector3f, 4>;

  // kInternal if Embree reports an error.
  static absl::StatusOr<std::unique_ptr<RayScene>> Create(
      const std::vector<Corners>& quads);
  RayScene(const RayScene&) = delete;
  RayScene& operator=(const RayScene&) = delete;
  ~RayScene();

  // Is anything within (0, distance) along the unit direction?
  bool Occluded(const Eigen::Vector3f& origin,
                const Eigen::Vector3f& direction,
                float distance) const;
  RTCScene get() const { return scene_; }

 private:
  RayScene(RTCDevice device, RTCScene scene) : device_(device), scene_(scene) {}
  RTCDevice device_;
  RTCScene scene_;
};

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_RAY_SCENE_H_
