// SPDX-License-Identifier: Apache-2.0
// The stages of localisation, with their accuracy beside the time.
#include <benchmark/benchmark.h>

#include <random>

#include "map_store/features/descriptor_matching.h"
#include "map_store/features/sift_features.h"
#include "map_store/geometry/pose_ransac.h"
#include "server/localization/solvers/pose_refinement.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

void BM_ExtractSift(benchmark::State& state) {
  std::mt19937 engine(1);
  cv::Mat coarse(90, 160, CV_8UC1);
  for (int y = 0; y < coarse.rows; ++y) {
    for (int x = 0; x < coarse.cols; ++x) {
      coarse.at<uchar>(y, x) = static_cast<uchar>(engine());
    }
  }
  cv::Mat image;
  cv::resize(coarse, image, {1280, 720}, 0.0, 0.0, cv::INTER_CUBIC);
  std::size_t features = 0;
  for (auto _ : state) {
    features = features::ExtractSift(image, {}, {})->keypoints_px.size();
  }
  state.counters["features"] = static_cast<double>(features);
}
BENCHMARK(BM_ExtractSift)->Unit(benchmark::kMillisecond);

void BM_MatchDescriptors(benchmark::State& state) {
  std::mt19937 engine(1);
  const auto random = [&](std::int64_t count) {
    std::vector<map::Descriptor> descriptors(count);
    for (map::Descriptor& descriptor : descriptors) {
      for (std::uint8_t& value : descriptor) {
        value = static_cast<std::uint8_t>(engine());
      }
    }
    return features::DescriptorSet(descriptors);
  };
  const features::DescriptorSet queries = random(state.range(0));
  const features::DescriptorSet references = random(state.range(1));
  for (auto _ : state) {
    benchmark::DoNotOptimize(
        features::MatchDescriptors(queries, references, 0.8));
  }
}
BENCHMARK(BM_MatchDescriptors)
    ->Args({8'000, 5'000})
    ->Args({12'000, 1'000})
    ->Unit(benchmark::kMillisecond);

// Range: outliers in percent.
void BM_PoseRansac(benchmark::State& state) {
  const test_support::Scene scene = test_support::MakeScene(
      {.num_points = 400,
       .noise_px = 0.5,
       .outlier_ratio = static_cast<double>(state.range(0)) / 100.0});
  geometry::PoseRansacReport report;
  for (auto _ : state) {
    report = geometry::EstimatePoseRansac(
                 scene.camera, scene.p_world, scene.pixel_px, {})
                 .value();
  }
  state.counters["iterations"] = report.iterations;
  state.counters["centre_mm"] =
      1e3 * test_support::CenterError(report.camera_from_world.Inverse(),
                                      scene.world_from_camera);
}
BENCHMARK(BM_PoseRansac)
    ->Arg(20)
    ->Arg(50)
    ->Arg(75)
    ->Unit(benchmark::kMillisecond);

void BM_RefinePose(benchmark::State& state) {
  const test_support::Scene scene = test_support::MakeScene(
      {.num_points = static_cast<int>(state.range(0)), .noise_px = 0.5});
  geometry::Rigid3 initial = scene.world_from_camera;
  initial.translation += Eigen::Vector3d(0.02, -0.03, 0.01);
  RefinedPose refined;
  for (auto _ : state) {
    refined =
        RefinePose(scene.camera, scene.p_world, scene.pixel_px, initial, {})
            .value();
  }
  state.counters["centre_mm"] =
      1e3 * test_support::CenterError(refined.world_from_camera,
                                      scene.world_from_camera);
}
BENCHMARK(BM_RefinePose)->Arg(100)->Arg(400)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace groundlock::localization

BENCHMARK_MAIN();
