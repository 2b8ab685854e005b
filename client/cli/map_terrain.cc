// SPDX-License-Identifier: Apache-2.0
#include "client/cli/map_terrain.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/terrain/elevation_grid.h"
#include "map_store/terrain/elevation_model.h"

namespace groundlock::cli {
namespace {

using Eigen::Vector2d;

// Points farther out than this share of them are strays.
constexpr double kStrays = 0.02;
constexpr double kLeastMargin_m = 20.0;
// As many heights as a map takes.
constexpr double kMostHeights = 250'000.0;
// Each way, so that there is something to put a surface through.
constexpr double kLeastSteps = 4.0;
constexpr double kFinest_m = 0.05;

// x and y from which to which something of the map lies.
struct Extent {
  Vector2d low, high;
};

Extent ExtentOf(const sdk::PointCloud& cloud, double margin_m) {
  Extent extent;
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double> values;
    for (const Eigen::Vector3f& p : cloud.xyz_world) {
      values.push_back(static_cast<double>(p[axis]));
    }
    std::sort(values.begin(), values.end());
    const auto strays =
        static_cast<std::size_t>(kStrays * static_cast<double>(values.size()));
    double low = values.empty() ? 0.0 : values[strays];
    double high = values.empty() ? 0.0 : values[values.size() - 1 - strays];
    for (const sdk::MapCamera& camera : cloud.cameras) {
      low = std::min(low, camera.world_from_camera.translation[axis]);
      high = std::max(high, camera.world_from_camera.translation[axis]);
    }
    extent.low[axis] = low;
    extent.high[axis] = high;
  }
  const double margin =
      margin_m > 0.0 ? margin_m
                     : std::max(kLeastMargin_m,
                                0.5 * (extent.high - extent.low).maxCoeff());
  extent.low.array() -= margin;
  extent.high.array() += margin;
  return extent;
}

// About an extent, with a cell to spare, so that its rim is inside.
terrain::GeodeticWindow WindowOf(const Extent& extent,
                                 double spare_m,
                                 const geometry::GeodeticPosition& origin) {
  terrain::GeodeticWindow window;
  for (const double x : {extent.low.x() - spare_m, extent.high.x() + spare_m}) {
    for (const double y :
         {extent.low.y() - spare_m, extent.high.y() + spare_m}) {
      window.Include(geometry::GeodeticFromWorld(origin, {x, y, 0.0}));
    }
  }
  return window;
}

}  // namespace

absl::StatusOr<sdk::AlignRequest::Terrain> ReadTerrain(
    const TerrainFlags& flags,
    const sdk::MapInfo& map,
    const sdk::PointCloud& cloud,
    const std::function<bool()>& is_cancelled) {
  if (!map.origin) {
    return absl::FailedPreconditionError(absl::StrCat(
        "map ",
        base::Abseil(map.name),
        " has no place on Earth, so no terrain can be laid under it: align it "
        "by --gps, by --control-points, or by --similarity with --origin "
        "first"));
  }
  terrain::ElevationModelRequest request;
  request.file = flags.file;
  request.is_cancelled = is_cancelled;
  if (!flags.datum.empty()) {
    auto datum = terrain::ParseVerticalDatum(flags.datum);
    if (!datum.ok()) return base::Annotate(datum.status(), "--vertical-datum");
    request.datum = *std::move(datum);
  }
  ASSIGN_OR_RETURN(const terrain::ElevationModelInfo info,
                   terrain::ReadElevationModelInfo(flags.file));
  const Extent extent = ExtentOf(cloud, flags.margin_m);
  const Vector2d side = extent.high - extent.low;
  // As fine as the model, as far as a map takes it.
  double step_m =
      std::clamp(info.cell_m, kFinest_m, side.minCoeff() / kLeastSteps);
  while ((side.x() / step_m + 2.0) * (side.y() / step_m + 2.0) > kMostHeights) {
    step_m *= 1.05;
  }
  const auto count = [&](double length) {
    return static_cast<std::size_t>(std::ceil(length / step_m)) + 1;
  };
  request.window = WindowOf(extent, 2.0 * step_m, *map.origin);
  const auto cells = [&](double length) {
    return std::clamp<std::size_t>(
        static_cast<std::size_t>(std::ceil(length / step_m + 4.0)),
        2,
        terrain::kMaxSide);
  };
  request.columns = cells(side.x());
  request.rows = cells(side.y());
  ASSIGN_OR_RETURN(const terrain::ElevationGrid grid,
                   terrain::ReadElevationModel(request));
  const terrain::WorldTerrain sampled = terrain::SampleInWorld(
      grid, *map.origin, extent.low, step_m, count(side.x()), count(side.y()));
  sdk::AlignRequest::Terrain terrain;
  terrain.first_m = sampled.first_m;
  terrain.step_m = sampled.step_m;
  terrain.columns = static_cast<std::uint32_t>(sampled.columns);
  terrain.z_m = sampled.z_m;
  terrain.sigma_m = flags.sigma_m;
  terrain.fit_height = flags.fit;
  return terrain;
}

}  // namespace groundlock::cli
