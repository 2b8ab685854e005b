// SPDX-License-Identifier: Apache-2.0
// The height of a scene's ground.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TERRAIN_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TERRAIN_H_

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "map_store/geometry/geodesy.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::simulator {

// A sum of waves about z = 0; none of them: level ground. World: metres, z up.
class Terrain {
 public:
  Terrain() = default;
  // Hills of about 14 m from crest to crest, with slopes up to 20 degrees
  // within |x|, |y| <= half_side_m.
  static Terrain Hills(std::uint64_t seed, double half_side_m);

  bool is_level() const { return waves_.empty(); }
  double HeightAt(double x, double y) const;
  Eigen::Vector3d NormalAt(double x, double y) const;
  // No height is farther from 0.
  double MaxHeight() const;

  // The point as high over this ground as it is over z = 0.
  Eigen::Vector3d Lift(const Eigen::Vector3d& p_world) const;
  // What stands on z = 0 at this pose stands on this ground, tilted with it.
  geometry::Rigid3 Stand(const geometry::Rigid3& world_from_body) const;

 private:
  struct Wave {
    Eigen::Vector2d rate;  // rad/m
    double phase = 0.0;
    double amplitude_m = 0.0;
  };
  Eigen::Vector2d SlopeAt(double x, double y) const;

  std::vector<Wave> waves_;
};

// The ground within |x|, |y| <= half_side_m as a grid of ESRI's text format,
// and the text of its coordinate system: a transverse Mercator projection about
// the world's origin, heights over the ellipsoid. Over a hundred metres that
// and the world agree to a millimetre.
struct ElevationText {
  std::string grid;               // .asc
  std::string coordinate_system;  // .prj
};
ElevationText ElevationModelOf(const Terrain& terrain,
                               double half_side_m,
                               double step_m,
                               const geometry::GeodeticPosition& origin);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TERRAIN_H_
