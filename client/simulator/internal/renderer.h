// SPDX-License-Identifier: Apache-2.0
// Frames of a scene with a car, by ray casting.
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_RENDERER_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_RENDERER_H_

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "client/simulator/internal/lens.h"
#include "client/simulator/internal/ray_scene.h"
#include "client/simulator/internal/scene_model.h"
#include "client/simulator/internal/texture.h"
#include "map_store/geometry/rigid3.h"

namespace groundlock::simulator {

// What is where at one moment of an exposure.
struct Moment {
  geometry::Rigid3 world_from_camera;
  std::optional<geometry::Rigid3> world_from_car;
  // Other cars, which look the same.
  std::vector<geometry::Rigid3> world_from_other_cars = {};
};

class Renderer {
 public:
  // Traces the light of `scene` first: takes a second or two.
  static absl::StatusOr<std::unique_ptr<Renderer>> Create(SceneModel scene,
                                                          const Lens& lens,
                                                          std::uint64_t seed,
                                                          int threads);

  // Mean over the moments of the exposure, one sample per pixel for each, at
  // different places in the pixel. CV_32FC3, display values 0 to 255.
  //   car_share  if given, CV_32F: which share of the pixel shows a car.
  cv::Mat Render(std::span<const Moment> moments,
                 cv::Mat* car_share = nullptr) const;

  // Is the straight way between two points blocked by the scene (not by cars)?
  bool Blocked(const Eigen::Vector3d& a_world,
               const Eigen::Vector3d& b_world) const;
  // Is it blocked by a car that stands there?
  bool BlockedByCar(const geometry::Rigid3& world_from_car,
                    const Eigen::Vector3d& a_world,
                    const Eigen::Vector3d& b_world) const;
  const std::vector<CarFace>& car() const { return car_; }
  const Lens& lens() const { return lens_; }

 private:
  struct CarView;
  struct View;  // one moment, prepared
  Renderer(SceneModel scene, const Lens& lens, int threads);

  View Prepare(const Moment& moment, int index, int count) const;
  CarView PrepareCar(const geometry::Rigid3& world_from_camera,
                     const geometry::Rigid3& world_from_car) const;
  void RenderRow(int y,
                 std::span<const View> views,
                 float* row_bgr,
                 float* row_car) const;
  Float4 ShadeScene(const View& view,
                    unsigned quad,
                    float s,
                    float t,
                    float distance,
                    const Eigen::Vector3f& direction) const;
  Float4 ShadeCar(const CarView& view,
                  unsigned face,
                  const Eigen::Vector3f& p_car,
                  const Eigen::Vector3f& direction_car) const;
  float CarShade(const CarView& view,
                 const Eigen::Vector3f& p_world,
                 float sun_share,
                 bool is_lying) const;

  SceneModel scene_;
  Lens lens_;
  int threads_;
  std::vector<CarFace> car_;
  std::vector<Texture> textures_;
  std::unique_ptr<RayScene> scene_rays_;
  std::unique_ptr<RayScene> car_rays_;
  // Undistorted coordinates of the pixels' corners, (height + 1) x (width + 1).
  cv::Mat corners_;
};

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_RENDERER_H_
