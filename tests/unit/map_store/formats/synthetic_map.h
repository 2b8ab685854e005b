// SPDX-License-Identifier: Apache-2.0
// A small map with consistent projections, for the tests of formats.
#ifndef GROUNDLOCK_TESTS_UNIT_MAP_STORE_FORMATS_SYNTHETIC_MAP_H_
#define GROUNDLOCK_TESTS_UNIT_MAP_STORE_FORMATS_SYNTHETIC_MAP_H_

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/map/map_data.h"

namespace groundlock::formats {

inline geometry::CameraModel MakeCamera(geometry::CameraModelId id,
                                        const std::vector<double>& params) {
  auto camera = geometry::CameraModel::Create(id, 640, 480, params);
  EXPECT_TRUE(camera.ok()) << camera.status();
  return *camera;
}

inline std::vector<geometry::CameraModel> AllCameraModels() {
  using geometry::CameraModelId;
  return {MakeCamera(CameraModelId::kSimplePinhole, {500, 320, 240}),
          MakeCamera(CameraModelId::kPinhole, {500, 510, 321, 239}),
          MakeCamera(CameraModelId::kSimpleRadial, {500, 320, 240, -0.05}),
          MakeCamera(CameraModelId::kRadial, {500, 322, 240, -0.05, 0.01}),
          MakeCamera(CameraModelId::kOpenCv,
                     {500, 505, 320, 241, -0.05, 0.01, 1e-3, -1e-3}),
          MakeCamera(CameraModelId::kOpenCvFisheye,
                     {500, 500, 320, 240, 0.01, -0.002, 0, 0})};
}

// One view per camera, on an arc, looking at a cloud around (0, 0, 10).
// Keypoints are exact projections up to float.
inline map::MapData SyntheticMap(
    const std::vector<geometry::CameraModel>& cameras,
    std::size_t num_landmarks = 60) {
  std::mt19937_64 generator(7);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::uniform_int_distribution<int> byte(0, 255);
  map::MapData data;
  data.source_format = "test";
  data.cameras = cameras;
  for (std::size_t i = 0; i < num_landmarks; ++i) {
    map::MapLandmarkData& landmark = data.landmarks.emplace_back();
    landmark.p_world = {
        3 * unit(generator), 2 * unit(generator), 10 + unit(generator)};
    for (std::uint8_t& c : landmark.rgb) {
      c = static_cast<std::uint8_t>(byte(generator));
    }
    landmark.error_px = 0.25F * static_cast<float>(i % 4);
  }
  // Descriptors as SIFT's are: sparse, a few large bins.
  std::geometric_distribution<int> bin(0.02);
  for (std::uint32_t i = 0; i < cameras.size(); ++i) {
    map::MapViewData& view = data.views.emplace_back();
    view.name = "view " + std::to_string(i) + ".jpg";
    view.camera = i;
    view.camera_from_world.rotation = Eigen::Quaterniond(
        Eigen::AngleAxisd(0.05 * i, Eigen::Vector3d(0.2, 1, 0.1).normalized()));
    view.camera_from_world.translation = {0.3 * i, -0.1 * i, 0.2};
    for (std::uint32_t j = 0; j < num_landmarks; ++j) {
      if ((i + j) % 5 == 4) continue;  // not every view sees every landmark
      const auto pixel = cameras[i].ImageFromCamera(view.camera_from_world *
                                                    data.landmarks[j].p_world);
      if (!pixel || !cameras[i].IsInsideImage(*pixel)) continue;
      view.keypoints_px.push_back(pixel->cast<float>());
      view.landmarks.push_back(j);
      map::Descriptor& descriptor = view.descriptors.emplace_back();
      for (std::uint8_t& value : descriptor) {
        value = static_cast<std::uint8_t>(std::min(bin(generator), 255));
      }
    }
  }
  return data;
}

// Removed with its content at the end of the test.
inline base::TemporaryDirectory MakeTestDirectory() {
  auto directory =
      base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  EXPECT_TRUE(directory.ok()) << directory.status();
  return *std::move(directory);
}

inline std::size_t NumObservations(const map::MapData& data) {
  std::size_t count = 0;
  for (const map::MapViewData& view : data.views) {
    count += view.landmarks.size();
  }
  return count;
}

// Folder with the test data, from $GROUNDLOCK_DATA.
inline std::filesystem::path DataFolder() {
  const char* folder = std::getenv("GROUNDLOCK_DATA");
  return folder != nullptr ? folder : "../shared/data";
}

}  // namespace groundlock::formats

#endif  // GROUNDLOCK_TESTS_UNIT_MAP_STORE_FORMATS_SYNTHETIC_MAP_H_
