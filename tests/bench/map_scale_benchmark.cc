// SPDX-License-Identifier: Apache-2.0
// A synthetic map of a million landmarks and five million observations: time
// to write and to open it, and what is resident then. Arguments:
//   map_scale_benchmark [LANDMARKS] [VIEWS]
// A program of its own rather than one for Google Benchmark: each step is done
// once, and memory is the point.
#include <malloc.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <random>
#include <string>

#include "map_store/base/file.h"
#include "map_store/map/map.h"

namespace {

using groundlock::map::Map;
using groundlock::map::MapData;

constexpr int kObservationsPerLandmark = 5;

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
      .count();
}

// Of /proc/self/status, in MiB.
double StatusMib(const std::string& field) {
  std::ifstream status("/proc/self/status");
  std::string word;
  while (status >> word) {
    double kib = 0.0;
    if (word == field + ":" && status >> kib) return kib / 1024.0;
  }
  return 0.0;
}

// Every landmark is seen by five neighbouring views; descriptors of one
// landmark are alike.
MapData MakeData(std::size_t num_landmarks, std::size_t num_views) {
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  MapData data;
  data.source_format = "synthetic";
  data.metric = true;
  data.in_world = true;
  data.cameras.push_back(*groundlock::geometry::CameraModel::Create(
      groundlock::geometry::CameraModelId::kSimplePinhole,
      1'280,
      720,
      std::vector<double>{1'000, 640, 360}));
  data.views.resize(num_views);
  for (std::size_t v = 0; v < num_views; ++v) {
    data.views[v].name = "view" + std::to_string(v);
    data.views[v].camera_from_world.translation = {
        -static_cast<double>(v), 0.0, 10.0};
  }
  for (std::uint32_t i = 0; i < num_landmarks; ++i) {
    const std::size_t first = i % (num_views - kObservationsPerLandmark);
    data.landmarks.push_back({{static_cast<double>(first) + 3 * unit(generator),
                               3 * unit(generator),
                               unit(generator)},
                              {},
                              0.5F});
    groundlock::map::Descriptor own;
    for (std::uint8_t& value : own) {
      const std::uint64_t bits = generator();
      value = bits % 4 == 0 ? static_cast<std::uint8_t>((bits >> 8) % 120) : 0;
    }
    for (int k = 0; k < kObservationsPerLandmark; ++k) {
      auto& view = data.views[first + static_cast<std::size_t>(k)];
      view.keypoints_px.push_back(Eigen::Vector2f{640 + 600 * unit(generator),
                                                  360 + 300 * unit(generator)});
      view.landmarks.push_back(i);
      auto seen = own;
      for (int n = 0; n < 16; ++n) {
        const std::uint64_t bits = generator();
        auto& value = seen[bits % seen.size()];
        value = static_cast<std::uint8_t>(
            std::min<int>(255, value + static_cast<int>((bits >> 8) % 16)));
      }
      view.descriptors.push_back(seen);
    }
  }
  return data;
}

}  // namespace

int main(int argc, char** argv) {
  const std::size_t num_landmarks =
      argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 1'000'000;
  const std::size_t num_views =
      argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 5'000;
  if (num_views <= kObservationsPerLandmark) return 2;
  auto directory = groundlock::base::TemporaryDirectory::Create("/tmp");
  if (!directory.ok()) return 1;
  const std::string path = directory->path() / "scale.glmap";
  {
    const MapData data = MakeData(num_landmarks, num_views);
    std::printf("data: %.0f MiB resident\n", StatusMib("VmRSS"));
    const auto start = std::chrono::steady_clock::now();
    const absl::Status written = WriteMapFile(data, path);
    if (!written.ok()) {
      std::fprintf(stderr, "%s\n", written.ToString().c_str());
      return 1;
    }
    std::printf(
        "write: %.1f s, peak %.0f MiB resident, file %.0f MiB\n",
        SecondsSince(start),
        StatusMib("VmHWM"),
        static_cast<double>(std::filesystem::file_size(path)) / (1 << 20));
  }
  malloc_trim(0);
  const double before_mib = StatusMib("VmRSS");
  auto start = std::chrono::steady_clock::now();
  const auto map = Map::Open(path);
  if (!map.ok()) return 1;
  std::printf("open: %.2f ms, %.1f MiB more resident\n",
              1e3 * SecondsSince(start),
              StatusMib("VmRSS") - before_mib);
  const double opened_mib = StatusMib("VmRSS");
  const auto second = Map::Open(path);
  std::printf("open again: %.1f MiB more resident\n",
              StatusMib("VmRSS") - opened_mib);
  start = std::chrono::steady_clock::now();
  if (!(*map)->Verify().ok()) return 1;
  std::printf("verify: %.1f s\n", SecondsSince(start));
  return second.ok() ? 0 : 1;
}
