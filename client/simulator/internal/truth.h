// SPDX-License-Identifier: Apache-2.0
// The truth of a rendered frame: poses, boxes, visibility.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TRUTH_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TRUTH_H_

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "client/simulator/internal/renderer.h"
#include "map_store/geometry/box.h"

namespace groundlock::simulator {

struct TargetTruth {
  // Of the projected cuboid, whatever hides it and wherever the image ends;
  // nullopt when a corner is behind the camera or beyond the lens model.
  std::optional<geometry::Box2> box;
  // Of the surface samples that are seen inside the image; nullopt if none.
  std::optional<geometry::Box2> seen_box;
  // Shares of the surface samples that face the camera:
  double visible_fraction = 0.0;  // not hidden by other objects
  double inframe_fraction = 0.0;  // inside the image
  double seen_fraction = 0.0;     // both
  bool in_view() const { return seen_fraction > 0.02; }
};

// Points spread evenly over the car's surface.
class CarSamples {
 public:
  CarSamples(const std::vector<CarFace>& car, std::uint64_t seed);
  // Of the moment's first car; its other ones may hide it.
  TargetTruth Measure(const Renderer& renderer, const Moment& moment) const;

 private:
  struct Sample {
    Eigen::Vector3d p_car;
    Eigen::Vector3d normal_car;
  };
  std::vector<Sample> samples_;
};

// The header and rows of the truth table, newline included. Columns:
// frame,t_s, camera centre and world_from_camera quaternion, then
// for sequences with a target its pose, size, boxes and visibility.
std::string TruthHeader(bool has_target);
std::string TruthRow(int frame,
                     double t_s,
                     const Moment& moment,
                     const std::optional<TargetTruth>& target);

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_TRUTH_H_
