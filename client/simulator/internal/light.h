// SPDX-License-Identifier: Apache-2.0
// Light that does not move is computed once and kept in the textures.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_LIGHT_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_LIGHT_H_

#include <array>
#include <cstdint>
#include <vector>

#include "client/simulator/internal/ray_scene.h"
#include "client/simulator/internal/scene_model.h"
#include "client/simulator/internal/texture.h"

namespace groundlock::simulator {

// Linear light: the sun is a small disc, the sky a uniform dome.
inline constexpr float kSunLight = 1.35F;
inline constexpr float kSkyLight = 0.5F;

// Display value (0 to 255) of linear radiance, with a soft shoulder.
std::uint8_t Display(float radiance);

// Paints light onto every surface's albedo (which is released): the textures
// hold blue, green, red as displayed and, in the fourth channel, the sun's
// share of the light, which the moving car's shadow takes away.
std::vector<Texture> BakeLight(SceneModel& scene,
                               const RayScene& rays,
                               std::uint64_t seed,
                               int threads);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_LIGHT_H_
