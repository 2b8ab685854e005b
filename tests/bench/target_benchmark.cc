// SPDX-License-Identifier: Apache-2.0
// Time of one update (Detect and Learn) of every 2D tracker, by target size and
// on one core, with the error it makes beside it: a texture moves by a known
// amount, error_px is the mean distance of the found centre from the true one.
#include <benchmark/benchmark.h>

#include <cmath>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "server/target/colour_names.h"
#include "server/target/target_tracker.h"

namespace groundlock::target {
namespace {

using geometry::Box2;

cv::Mat Texture() {
  cv::Mat coarse(45, 80, CV_8UC3);
  cv::RNG rng(1);
  rng.fill(coarse, cv::RNG::UNIFORM, 0, 256);
  cv::Mat image;
  cv::resize(coarse, image, {1280, 720}, 0, 0, cv::INTER_CUBIC);
  cv::Mat noise(image.size(), image.type());
  rng.fill(noise, cv::RNG::NORMAL, 20, 10);
  return image + noise;
}

// The image moved along a circle, frame by frame, and where a point of it goes.
struct Frame {
  cv::Mat image;
  Eigen::Vector2d shift_px;
};

std::vector<Frame> Frames() {
  constexpr int kFrames = 16;
  constexpr double kRadiusPx = 8.0;
  const cv::Mat texture = Texture();
  std::vector<Frame> frames(kFrames);
  for (int i = 0; i < kFrames; ++i) {
    const double angle = 2.0 * CV_PI * i / kFrames;
    frames[i].shift_px = {kRadiusPx * (std::cos(angle) - 1.0),
                          kRadiusPx * std::sin(angle)};
    cv::warpAffine(
        texture,
        frames[i].image,
        cv::Matx23d(1, 0, frames[i].shift_px.x(), 0, 1, frames[i].shift_px.y()),
        texture.size(),
        cv::INTER_CUBIC,
        cv::BORDER_REPLICATE);
  }
  return frames;
}

void Update(benchmark::State& state, const std::string& name) {
  cv::setNumThreads(1);
  const std::vector<Frame> frames = Frames();
  const auto side = static_cast<double>(state.range(0));
  const Eigen::Vector2d center_px(640.0, 360.0);
  auto tracker = CreateTargetTracker({name, ""});
  if (!tracker.ok() ||
      !(*tracker)
           ->Initialize(frames[0].image,
                        Box2::FromCenter(center_px, {side, side}))
           .ok()) {
    state.SkipWithError("the tracker does not start");
    return;
  }
  double error_px = 0.0;
  std::int64_t updates = 0;
  for (auto _ : state) {
    const Frame& frame = frames[static_cast<std::size_t>(++updates) % 16];
    const auto seen = (*tracker)->Detect(frame.image, /*fixed_size=*/false);
    (*tracker)->Learn(frame.image);
    if (seen.ok()) {
      error_px +=
          (seen->box_px.center_px() - center_px - frame.shift_px).norm();
    }
  }
  state.counters["error_px"] = error_px / static_cast<double>(updates);
}

void BuildColourNames(benchmark::State& state) {
  for (auto _ : state) {
    for (int i = 0; i < 32; ++i) {
      benchmark::DoNotOptimize(NameColour(8 * i, 100, 50));
    }
  }
  state.SetItemsProcessed(state.iterations() * 32);
}
BENCHMARK(BuildColourNames);

}  // namespace
}  // namespace groundlock::target

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  for (const std::string& name : groundlock::target::TargetTrackerNames()) {
    benchmark::RegisterBenchmark(
        ("Update/" + name).c_str(), groundlock::target::Update, name)
        ->Arg(32)
        ->Arg(128)
        ->Arg(400)
        ->Unit(benchmark::kMillisecond);
  }
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
