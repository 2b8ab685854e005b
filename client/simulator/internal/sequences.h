// SPDX-License-Identifier: Apache-2.0
// Camera paths and drives: what happens in a sequence.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SEQUENCES_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SEQUENCES_H_

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "client/simulator/internal/terrain.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::simulator {

// A sequence of video: smooth functions of time, defined for all times (motion
// blur looks a little before and after each frame).
struct Drive {
  double duration_s = 0.0;
  std::function<geometry::Rigid3(double t_s)> world_from_camera;
  // x forward, y left, z up; origin on the ground.
  std::function<geometry::Rigid3(double t_s)> world_from_car;
  // Others, which look the same.
  std::vector<std::function<geometry::Rigid3(double t_s)>>
      world_from_other_cars = {};
};

inline constexpr std::string_view kMapping = "mapping";

// "mapping" first. Of a yard filmed by hand, and from a drone.
std::vector<std::string> YardSequenceNames();
std::vector<std::string> AerialSequenceNames();
// nullopt for "mapping" and unknown names. Cameras and cars are lifted with the
// ground below them.
std::optional<Drive> YardDrive(std::string_view sequence,
                               const Terrain& terrain,
                               std::uint64_t seed);
// The same of AerialSequenceNames().
std::optional<Drive> AerialDrive(std::string_view sequence,
                                 const Terrain& terrain,
                                 std::uint64_t seed);
// world_from_camera of the mapping views: walks that see what the sequences'
// cameras see, from nearby, and a round along the walls.
std::vector<geometry::Rigid3> YardMappingViews(const Terrain& terrain,
                                               std::uint64_t seed);
// The same of a survey by drone.
std::vector<geometry::Rigid3> AerialMappingViews(const Terrain& terrain,
                                                 std::uint64_t seed);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_SEQUENCES_H_
