// SPDX-License-Identifier: Apache-2.0
// What localisation costs in maps of 100, 1,000 and 10,000 views. The rendered
// yard's map is part of each of them; the rest is a synthetic crowd of views
// elsewhere, with descriptors that are put together from real ones, so that
// real frames are looked for, and found, among them.
//   scaling_benchmark [--views N…] [--landmarks-per-view N]
#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <map>
#include <opencv2/core/utility.hpp>
#include <random>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/base/mix_seed.h"
#include "map_store/base/parallel_for.h"
#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "server/localization/localizer.h"
#include "server/service/background_executor.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

using Clock = std::chrono::steady_clock;
using test_support::Quantile;

struct Arguments {
  std::vector<int> views = {100, 1'000, 10'000};
  int landmarks_per_view = 200;
  int relocalizations = 24;
};

// Every landmark is seen from this many neighbouring views.
constexpr int kViewsPerLandmark = 5;

double Seconds(Clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

std::vector<map::Descriptor> AllDescriptors(const map::MapData& data) {
  std::vector<map::Descriptor> all;
  for (const map::MapViewData& view : data.views) {
    all.insert(all.end(), view.descriptors.begin(), view.descriptors.end());
  }
  return all;
}

// As likely as real ones, cell by cell, and like none of them: the cells of the
// 4 x 4 grid come from three descriptors at random.
map::Descriptor Invent(const std::vector<map::Descriptor>& real,
                       std::mt19937_64& engine) {
  const map::Descriptor* parents[3] = {&real[engine() % real.size()],
                                       &real[engine() % real.size()],
                                       &real[engine() % real.size()]};
  map::Descriptor invented;
  for (int cell = 0; cell < 16; ++cell) {
    const map::Descriptor& parent = *parents[engine() % 3];
    std::copy_n(&parent[8 * cell], 8, &invented[8 * cell]);
  }
  return invented;
}

// The same landmark from another view: as far apart as real looks are (about
// 130 of 512).
map::Descriptor LookAgain(const map::Descriptor& look,
                          std::mt19937_64& engine) {
  map::Descriptor again;
  for (std::size_t i = 0; i < again.size(); ++i) {
    const int noise = static_cast<int>(engine() % 29) - 14;
    again[i] = static_cast<std::uint8_t>(
        std::clamp(static_cast<int>(look[i]) + noise, 0, 255));
  }
  return again;
}

// Adds views until there are `num_views`: along streets far from the yard, each
// looking at what lies before it.
void AddCrowd(int num_views, int landmarks_per_view, map::MapData& data) {
  const std::vector<map::Descriptor> real = AllDescriptors(data);
  const auto first_view = data.views.size();
  const auto first_landmark = static_cast<std::uint32_t>(data.landmarks.size());
  const int added = std::max(0, num_views - static_cast<int>(first_view));
  const int fresh = landmarks_per_view;  // that a view sees as the first
  data.views.resize(first_view + added);
  data.landmarks.resize(first_landmark +
                        static_cast<std::size_t>(added) * fresh);
  const geometry::CameraModel camera = data.cameras.front();
  // Where view i stands; a street of 100 views, 0.5 m apart.
  const auto center = [](int i) {
    return Eigen::Vector3d(200.0 + 0.5 * (i % 100), 60.0 * (i / 100), 1.6);
  };
  // z forward is the world's x, x right is minus y, y down is minus z.
  Eigen::Matrix3d world_from_camera;
  world_from_camera << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  base::ParallelFor(
      static_cast<std::size_t>(added), 16, [&](auto begin, auto end) {
        for (std::size_t i = begin; i < end; ++i) {
          map::MapViewData& view = data.views[first_view + i];
          view.name = "crowd/" + std::to_string(i) + ".jpg";
          const geometry::Rigid3 pose{Eigen::Quaterniond(world_from_camera),
                                      center(static_cast<int>(i))};
          view.camera_from_world = pose.Inverse();
          for (int back = 0; back < kViewsPerLandmark; ++back) {
            const std::size_t owner = i - back;
            if (owner > i || owner / 100 != i / 100) continue;
            std::mt19937_64 engine(base::MixSeed(11, owner));
            for (int n = 0; n < fresh; ++n) {
              const map::Descriptor look = Invent(real, engine);
              const auto uniform = [&](double low, double high) {
                return std::uniform_real_distribution<double>(low,
                                                              high)(engine);
              };
              const Eigen::Vector3d p_world =
                  center(static_cast<int>(owner)) +
                  Eigen::Vector3d(
                      uniform(6, 25), uniform(-3, 3), uniform(-2, 2));
              const auto landmark = static_cast<std::uint32_t>(
                  first_landmark + owner * fresh + n);
              if (back == 0) data.landmarks[landmark].p_world = p_world;
              const auto pixel =
                  camera.ImageFromCamera(view.camera_from_world * p_world);
              std::mt19937_64 noise(base::MixSeed(landmark, back));
              view.keypoints_px.push_back(
                  pixel.value_or(Eigen::Vector2d(1, 1)).cast<float>());
              view.landmarks.push_back(landmark);
              view.descriptors.push_back(LookAgain(look, noise));
            }
          }
        }
      });
}

struct Costs {
  double frame_ms = 0.0;       // median, frame path
  double anchor_ms = 0.0;      // per anchor, mean
  double relocalize_ms = 0.0;  // median
  int tracked = 0;
  int frames = 0;
  int relocalized = 0;
};

absl::StatusOr<Costs> Measure(const std::shared_ptr<const map::Map>& map,
                              const geometry::CameraModel& camera,
                              const std::map<int, cv::Mat>& images,
                              int relocalizations) {
  Costs costs;
  double anchor_s = 0.0;
  int anchors_run = 0;
  std::vector<double> frame_ms;
  {
    service::BackgroundExecutor anchors("anchors", 1, 16);
    ASSIGN_OR_RETURN(
        const auto localizer,
        localization::CreateLocalizer("fast", map, {}, [&](auto, auto task) {
          anchors.Post([&, task = std::move(task)] {
            const double start = test_support::ThreadCpuSeconds();
            task();
            anchor_s += test_support::ThreadCpuSeconds() - start;
            ++anchors_run;
          });
        }));
    for (const auto& [index, image] : images) {
      image::Frame frame = image::Frame::FromBgr(image);
      frame.sequence = static_cast<std::uint64_t>(index);
      frame.capture_time = std::chrono::nanoseconds(
          static_cast<std::int64_t>(1e9 * index / 24.0));
      const double start = test_support::ThreadCpuSeconds();
      ASSIGN_OR_RETURN(const auto result,
                       localizer->Localize({&frame, camera, {}}));
      frame_ms.push_back(1e3 * (test_support::ThreadCpuSeconds() - start));
      ++costs.frames;
      costs.tracked += result.state == localization::CameraState::kTracked;
    }
  }
  costs.frame_ms = Quantile(frame_ms, 0.5);
  costs.anchor_ms = 1e3 * anchor_s / std::max(1, anchors_run);
  std::vector<double> relocalize_ms;
  const std::size_t stride =
      std::max<std::size_t>(1, images.size() / relocalizations);
  for (const auto& [index, image] : images) {
    if (index % stride != 0) continue;
    const image::Frame frame = image::Frame::FromBgr(image);
    ASSIGN_OR_RETURN(const auto localizer,
                     localization::CreateLocalizer("fast", map, {}));
    const double start = test_support::ThreadCpuSeconds();
    ASSIGN_OR_RETURN(const auto result,
                     localizer->Localize({&frame, camera, {}}));
    relocalize_ms.push_back(1e3 * (test_support::ThreadCpuSeconds() - start));
    costs.relocalized += result.state == localization::CameraState::kTracked;
  }
  costs.relocalize_ms = Quantile(relocalize_ms, 0.5);
  std::printf(
      "  relocalised %d of %zu\n", costs.relocalized, relocalize_ms.size());
  return costs;
}

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(const auto sequence, test_support::FindSequence("scale"));
  ASSIGN_OR_RETURN(const auto camera,
                   test_support::ReadCamera(sequence.camera));
  ASSIGN_OR_RETURN(const auto images,
                   test_support::ReadFrames(sequence.video, 1));
  ASSIGN_OR_RETURN(
      const auto directory,
      base::TemporaryDirectory::Create(std::filesystem::temp_directory_path()));
  std::optional<Costs> first;
  for (const int num_views : arguments.views) {
    const std::filesystem::path path = directory.path() / "map";
    double write_s = 0.0;
    {
      ASSIGN_OR_RETURN(
          map::MapData data,
          test_support::ImportData(sequence.reconstruction, sequence.align));
      AddCrowd(num_views, arguments.landmarks_per_view, data);
      const Clock::time_point start = Clock::now();
      RETURN_IF_ERROR(map::WriteMapFile(data, path));
      write_s = Seconds(Clock::now() - start);
    }
    const Clock::time_point start = Clock::now();
    ASSIGN_OR_RETURN(const auto map, map::Map::Open(path));
    const double open_ms = 1e3 * Seconds(Clock::now() - start);
    std::printf(
        "%zu views, %.2f million landmarks, %.2f million observations, %.2f "
        "GiB: written with its index in %.1f s, opened in %.2f ms\n",
        map->num_views(),
        1e-6 * static_cast<double>(map->landmarks().size()),
        1e-6 * static_cast<double>(map->features().size()),
        static_cast<double>(map->info().file_bytes) / (1 << 30),
        write_s,
        open_ms);
    ASSIGN_OR_RETURN(const Costs costs,
                     Measure(map, camera, images, arguments.relocalizations));
    if (!first) first = costs;
    std::printf(
        "  frame path, CPU ms, median %.2f (%.2f times the first map's), "
        "tracked %d of %d\n  anchor, CPU ms, mean %.1f (%.2f times)\n"
        "  relocalisation, CPU ms, median %.1f (%.2f times)\n",
        costs.frame_ms,
        costs.frame_ms / first->frame_ms,
        costs.tracked,
        costs.frames,
        costs.anchor_ms,
        costs.anchor_ms / first->anchor_ms,
        costs.relocalize_ms,
        costs.relocalize_ms / first->relocalize_ms);
    std::fflush(stdout);
  }
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) {
  groundlock::bench::Arguments arguments;
  CLI::App app("What localisation costs in larger and larger maps");
  app.add_option("--views", arguments.views);
  app.add_option("--landmarks-per-view", arguments.landmarks_per_view)
      ->check(CLI::PositiveNumber);
  app.add_option("--relocalizations", arguments.relocalizations)
      ->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  groundlock::features::SetUpOpenCv();
  const absl::Status status = groundlock::bench::Run(arguments);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
