// SPDX-License-Identifier: Apache-2.0
// Is the ground of a map ever wrong and sure? Estimates it from all views and
// from random thirds of them, and compares.
//
//   ground_subsets MODEL... [--subsets 20] [--align align.json]
//                  [--without-ground] [--images FOLDER]
//
// MODEL: whatever `groundlock map import` reads. --align: puts it into a world
// whose ground is z = 0, as the simulator's align.json does; else the estimate
// from all views is the reference, or the first sure one where that is unknown.
// --without-ground takes out what lies lower than a tenth of the cameras'
// height (with
// --align). --images: of one model; the upright edges in them tell up, of all
// views and of each third anew. Sure and off by more than 2 degrees and three
// of the sigmas stated, or by more than 15 % of the cameras' height and three
// of its sigmas: wrong; the exit status is 1 then.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "client/cli/parse.h"
#include "map_store/build/internal/upright_edges.h"
#include "map_store/decoding/decoder.h"
#include "map_store/formats/formats.h"
#include "map_store/map/map_data.h"
#include "map_store/map/measured_up.h"

namespace groundlock {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kWrong_rad = 2.0 * kDegree;
constexpr double kWrongHeight = 0.15;  // of the cameras'
constexpr double kLow = 0.1;           // of the cameras'

// Without the views that `keep` refuses and the landmarks that nothing shows
// then.
void KeepViews(const std::vector<bool>& keep, map::MapData& data) {
  std::vector<map::MapViewData> views;
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    if (keep[v]) views.push_back(data.views[v]);
  }
  data.views = std::move(views);
}

void DropLandmarks(const std::vector<bool>& drop, map::MapData& data) {
  for (map::MapViewData& view : data.views) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < view.landmarks.size(); ++i) {
      if (drop[view.landmarks[i]]) continue;
      view.landmarks[kept] = view.landmarks[i];
      view.keypoints_px[kept] = view.keypoints_px[i];
      view.descriptors[kept] = view.descriptors[i];
      ++kept;
    }
    view.landmarks.resize(kept);
    view.keypoints_px.resize(kept);
    view.descriptors.resize(kept);
  }
}

double MeanHeight(const map::MapData& data, const geometry::Plane& ground) {
  double sum = 0.0;
  for (const map::MapViewData& view : data.views) {
    sum += ground.SignedDistance(view.camera_from_world.Inverse().translation);
  }
  return sum / static_cast<double>(std::max<std::size_t>(1, data.views.size()));
}

double Apart_rad(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

struct Count {
  int sure = 0;
  int wrong = 0;
  double worst_rad = 0.0;
  double worst_height = 0.0;
};

// True if an estimate was made and nothing is said against it.
bool Compare(map::MapData data,
             std::uint64_t seed,
             const std::optional<geometry::Plane>& truth,
             Count& count,
             geometry::Plane* found = nullptr) {
  const map::MapData before = data;
  const auto estimate = map::AlignToEstimatedGround(seed, data);
  if (!estimate.ok() || !estimate->doubt.empty()) return false;
  ++count.sure;
  const geometry::Plane& ground = estimate->ground_source;
  if (found != nullptr) *found = ground;
  if (!truth) return true;
  const double off = Apart_rad(ground.normal, truth->normal);
  const double height = MeanHeight(before, *truth);
  const double high = std::abs(MeanHeight(before, ground) / height - 1.0);
  count.worst_rad = std::max(count.worst_rad, off);
  count.worst_height = std::max(count.worst_height, high);
  if (off > std::max(kWrong_rad, 3.0 * estimate->sigma_rad) ||
      high * height >
          std::max(kWrongHeight * height, 3.0 * estimate->height_sigma)) {
    ++count.wrong;
  }
  return true;
}

// By the edges in the images of the views that are left.
void MeasureUp(const std::string& images, map::MapData& data) {
  if (images.empty()) return;
  std::vector<std::string> warnings;
  data.measured_up = map::MeasureUp(
      {{}, build::internal::FindUprightEdges(data, images)}, data, warnings);
}

int Run(const std::vector<std::string>& models,
        const std::string& images,
        int subsets,
        const std::optional<geometry::Similarity3>& world_from_source,
        bool without_ground) {
  int wrong = 0;
  for (const std::string& path : models) {
    std::vector<std::string> warnings;
    auto data = formats::Import(path, {}, &warnings);
    if (!data.ok()) {
      std::fprintf(
          stderr, "%s: %s\n", path.c_str(), data.status().ToString().c_str());
      return 2;
    }
    if (world_from_source) data->Transform(*world_from_source);
    if (without_ground) {
      const double limit = kLow * MeanHeight(*data, geometry::Plane{});
      std::vector<bool> drop;
      for (const auto& landmark : data->landmarks) {
        drop.push_back(landmark.p_world.z() < limit);
      }
      DropLandmarks(drop, *data);
    }
    MeasureUp(images, *data);
    if (data->measured_up) {
      const Eigen::Vector3d& up = data->measured_up->up_world;
      std::printf(
          "%s: up (%.4f, %.4f, %.4f) by %s, %.2f deg from the ways of "
          "the cameras\n",
          path.c_str(),
          up.x(),
          up.y(),
          up.z(),
          data->measured_up->basis.c_str(),
          Apart_rad(up, map::UpByCameras(*data)) / kDegree);
    }
    // Of the thirds that tell up, against all views.
    int num_up = 0;
    double worst_up_rad = 0.0;
    double worst_ways_rad = 0.0;
    Count whole;
    std::optional<geometry::Plane> truth;
    if (world_from_source) truth = geometry::Plane{};
    geometry::Plane reference;
    const bool is_sure = Compare(*data, 0, truth, whole, &reference);
    if (!truth && is_sure) truth = reference;
    Count count;
    for (int i = 0; i < subsets; ++i) {
      std::mt19937_64 generator(static_cast<std::uint64_t>(i));
      std::vector<bool> keep;
      for (std::size_t v = 0; v < data->views.size(); ++v) {
        keep.push_back(generator() % 3 == 0);
      }
      if (std::count(keep.begin(), keep.end(), true) < 2) continue;
      map::MapData subset = *data;
      KeepViews(keep, subset);
      MeasureUp(images, subset);
      if (subset.measured_up) {
        // Where all views tell none, the ground is what there is.
        const Eigen::Vector3d& up =
            data->measured_up ? data->measured_up->up_world : reference.normal;
        ++num_up;
        worst_up_rad =
            std::max(worst_up_rad, Apart_rad(up, subset.measured_up->up_world));
        worst_ways_rad =
            std::max(worst_ways_rad, Apart_rad(up, map::UpByCameras(subset)));
      }
      if (Compare(std::move(subset),
                  static_cast<std::uint64_t>(i),
                  truth,
                  count,
                  &reference) &&
          !truth) {
        truth = reference;
      }
    }
    std::printf(
        "%s: %s from all %zu views%s; of %d subsets %d sure, %d of them wrong, "
        "worst %.2f deg, %.1f %% of the cameras' height\n",
        path.c_str(),
        is_sure ? "sure" : "unknown",
        data->views.size(),
        whole.wrong > 0 ? " and WRONG" : "",
        subsets,
        count.sure,
        count.wrong,
        std::max(count.worst_rad, whole.worst_rad) / kDegree,
        100.0 * std::max(count.worst_height, whole.worst_height));
    if (!images.empty()) {
      std::printf(
          "%s: %d thirds tell up, at worst %.2f deg off; the ways of "
          "their cameras %.2f deg\n",
          path.c_str(),
          num_up,
          worst_up_rad / kDegree,
          worst_ways_rad / kDegree);
    }
    wrong += whole.wrong + count.wrong;
  }
  return wrong > 0 ? 1 : 0;
}

}  // namespace
}  // namespace groundlock

int main(int argc, char** argv) {
  if (const auto status = groundlock::decoding::RunDecoderIfAsked(argc, argv)) {
    return *status;
  }
  std::vector<std::string> models;
  int subsets = 20;
  std::string align;
  std::string images;
  bool without_ground = false;
  CLI::App app("Is the ground of a map ever wrong and sure?");
  app.add_option("models", models, "What map import reads")->required();
  app.add_option("--subsets", subsets, "Random thirds of the views");
  app.add_option("--align", align, "Into a world whose ground is z = 0");
  app.add_option("--images", images, "Folder of the model's images");
  app.add_flag("--without-ground", without_ground, "Leave out what lies low");
  CLI11_PARSE(app, argc, argv);
  std::optional<groundlock::geometry::Similarity3> world_from_source;
  if (!align.empty()) {
    const auto read = groundlock::cli::ReadAlignment(align);
    if (!read.ok()) {
      std::fprintf(stderr, "%s\n", read.status().ToString().c_str());
      return 2;
    }
    world_from_source = *read;
  }
  return groundlock::Run(
      models, images, subsets, world_from_source, without_ground);
}
