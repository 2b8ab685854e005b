// SPDX-License-Identifier: Apache-2.0
// groundlock map align | check
#include <CLI/CLI.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_format.h"
#include "client/cli/control_points.h"
#include "client/cli/map_output.h"
#include "client/cli/map_terrain.h"
#include "client/cli/parse.h"
#include "client/cli/verbs.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/exif.h"
#include "map_store/map/map.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::uint64_t kMaxTextBytes = std::uint64_t{64} << 20;

struct AlignFlags {
  sdk::AlignRequest request;
  std::string similarity;
  std::string relative;
  std::string from;
  std::string to;
  double distance_m = 0.0;
  std::string control_points;
  std::string gps;
  double accuracy_m = 0.0;
  std::string origin;
  std::string ground;
  TerrainFlags terrain;
};

absl::StatusOr<sdk::AlignRequest::CameraPositions> ReadPositions(
    const AlignFlags& flags) {
  std::vector<formats::PhotoPosition> photos;
  if (fs::is_directory(flags.gps)) {
    ASSIGN_OR_RETURN(photos, formats::ReadPhotoPositions(flags.gps));
    if (photos.empty()) {
      return absl::NotFoundError(
          flags.gps + ": no photo here whose EXIF data hold a GPS position");
    }
  } else {
    ASSIGN_OR_RETURN(const std::string text,
                     base::ReadFile(flags.gps, kMaxTextBytes));
    ASSIGN_OR_RETURN(photos, formats::ParsePhotoPositions(text, flags.gps));
  }
  sdk::AlignRequest::CameraPositions result;
  result.accuracy_m = flags.accuracy_m;
  for (const formats::PhotoPosition& photo : photos) {
    result.positions.push_back({photo.image, photo.position});
  }
  return result;
}

absl::StatusOr<sdk::AlignRequest> MakeRequest(const AlignFlags& flags) {
  sdk::AlignRequest request = flags.request;
  if (!flags.similarity.empty()) {
    ASSIGN_OR_RETURN(const geometry::Similarity3 similarity,
                     ReadAlignment(flags.similarity));
    request.method = sdk::AlignRequest::FromSource{similarity};
  } else if (!flags.relative.empty()) {
    ASSIGN_OR_RETURN(const geometry::Similarity3 similarity,
                     ReadAlignment(flags.relative));
    request.method = sdk::AlignRequest::FromWorld{similarity};
  } else if (flags.distance_m != 0.0) {
    sdk::AlignRequest::KnownDistance distance;
    ASSIGN_OR_RETURN(distance.from, ParseMapPoint(flags.from));
    ASSIGN_OR_RETURN(distance.to, ParseMapPoint(flags.to));
    distance.distance_m = flags.distance_m;
    request.method = std::move(distance);
  } else if (!flags.control_points.empty()) {
    ASSIGN_OR_RETURN(const std::string text,
                     base::ReadFile(flags.control_points, kMaxTextBytes));
    auto points = ControlPointsFromJson(text);
    if (!points.ok()) {
      return base::Annotate(points.status(), flags.control_points);
    }
    request.method = *std::move(points);
  } else if (!flags.gps.empty()) {
    ASSIGN_OR_RETURN(request.method, ReadPositions(flags));
  } else if (flags.ground.empty() && flags.terrain.file.empty()) {
    return absl::InvalidArgumentError(
        "say what to align the map to: --similarity, --relative, --distance, "
        "--control-points, --gps, --ground or --terrain");
  }
  if (!flags.origin.empty()) {
    ASSIGN_OR_RETURN(request.origin, ParseGeodetic(flags.origin));
  }
  if (!flags.ground.empty()) {
    RETURN_IF_ERROR(
        base::Annotate(ParseGround(flags.ground, &request), "--ground"));
  }
  return request;
}

json ReportJson(const sdk::AlignReport& report, bool published) {
  json residuals = json::array();
  for (const auto& r : report.residuals) {
    residuals.push_back(
        {{"name", r.name},
         {"error_m", {r.error_m[0], r.error_m[1], r.error_m[2]}},
         {"used", r.used}});
  }
  const geometry::Similarity3& s = report.new_world_from_world;
  return {
      {"name", report.map.name},
      {"version", report.map.version},
      {"published", published},
      {"metric", report.map.metric},
      {"origin",
       report.map.origin
           ? json{{"latitude_deg", report.map.origin->latitude_deg},
                  {"longitude_deg", report.map.origin->longitude_deg},
                  {"height_m", report.map.origin->height_m}}
           : json()},
      {"new_world_from_world",
       {{"scale", s.scale},
        {"rotation_wxyz",
         {s.rotation.w(), s.rotation.x(), s.rotation.y(), s.rotation.z()}},
        {"translation",
         {s.translation.x(), s.translation.y(), s.translation.z()}}}},
      {"residuals", residuals},
      {"rms_error_m", report.rms_error_m},
      {"rms_horizontal_error_m", report.rms_horizontal_error_m},
      {"median_error_m", report.median_error_m},
      {"max_error_m", report.max_error_m},
      {"terrain",
       report.terrain ? json{{"offset_m", report.terrain->offset_m},
                             {"scatter_m", report.terrain->scatter_m},
                             {"num_ground", report.terrain->num_ground},
                             {"num_landmarks", report.terrain->num_landmarks}}
                      : json()},
      {"warnings", report.warnings}};
}

void PrintReport(const sdk::AlignReport& report,
                 bool published,
                 std::ostream& out) {
  if (!report.residuals.empty()) {
    out << "      east     north        up     total  (m, map - measured)\n";
    std::size_t num_used = 0;
    for (const auto& r : report.residuals) {
      out << absl::StrFormat("%10.3f%10.3f%10.3f%10.3f  %s%s\n",
                             r.error_m.x(),
                             r.error_m.y(),
                             r.error_m.z(),
                             r.error_m.norm(),
                             r.name,
                             r.used ? "" : "  (left out)");
      if (r.used) ++num_used;
    }
    out << absl::StrFormat(
        "%d of %d used: RMS %.3f m (horizontally %.3f m), median %.3f m, "
        "largest %.3f m\n",
        num_used,
        report.residuals.size(),
        report.rms_error_m,
        report.rms_horizontal_error_m,
        report.median_error_m,
        report.max_error_m);
  }
  if (report.terrain) {
    out << absl::StrFormat(
        "terrain: the map's own ground lay %.2f m %s it, by %d of %d "
        "landmarks, which scatter by %.2f m\n",
        std::abs(report.terrain->offset_m),
        report.terrain->offset_m > 0.0 ? "above" : "below",
        report.terrain->num_ground,
        report.terrain->num_landmarks,
        report.terrain->scatter_m);
  }
  if (report.map.origin) {
    out << absl::StrFormat("world: east, north, up at %.8f, %.8f, %.3f m\n",
                           report.map.origin->latitude_deg,
                           report.map.origin->longitude_deg,
                           report.map.origin->height_m);
  }
  out << absl::StrFormat("scale: 1 unit of before is now %.6g %s\n",
                         report.new_world_from_world.scale,
                         report.map.metric ? "m" : "units");
  if (published) {
    out << absl::StrFormat(
        "map %s, version %d\n", report.map.name, report.map.version);
  } else {
    out << "only a report: nothing was published\n";
  }
}

// A map's points say as well by a sample where it is.
constexpr std::uint64_t kSampledPoints = 20'000;

absl::Status RunAlign(const AlignFlags& flags, VerbContext& context) {
  ASSIGN_OR_RETURN(sdk::AlignRequest request, MakeRequest(flags));
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  if (!flags.terrain.file.empty()) {
    ASSIGN_OR_RETURN(const sdk::MapInfo map,
                     client->GetMap(request.name, request.version));
    ASSIGN_OR_RETURN(
        const sdk::PointCloud cloud,
        client->GetPointCloud(request.name, request.version, kSampledPoints));
    ASSIGN_OR_RETURN(request.ground,
                     ReadTerrain(flags.terrain, map, cloud, [&context] {
                       return context.interrupt.interrupted();
                     }));
  }
  ExitOnInterrupt(context);
  ASSIGN_OR_RETURN(const sdk::AlignReport report, client->AlignMap(request));
  for (const std::string& warning : report.warnings) {
    context.err << "warning: " << warning << '\n';
  }
  if (context.common.json) {
    context.out << ReportJson(report, !request.report_only).dump() << '\n';
  } else {
    PrintReport(report, !request.report_only, context.out);
  }
  return absl::OkStatus();
}

struct CheckFlags {
  std::string name;
  std::uint64_t version = 0;
};

// A map file that lies here; nullopt if the name is no such file's.
std::optional<std::vector<std::string>> CheckFile(const std::string& path) {
  std::error_code error;
  if (!fs::is_regular_file(path, error)) return std::nullopt;
  std::vector<std::string> problems;
  const auto map = map::Map::Open(path);
  const absl::Status status = map.ok() ? (*map)->Verify() : map.status();
  if (!status.ok()) problems.emplace_back(status.message());
  return problems;
}

absl::Status RunCheck(const CheckFlags& flags, VerbContext& context) {
  std::vector<std::string> problems;
  if (auto local = CheckFile(flags.name)) {
    problems = *std::move(local);
  } else {
    ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client,
                     Connect(context));
    ASSIGN_OR_RETURN(const sdk::MapCheck check,
                     client->CheckMap(flags.name, flags.version));
    problems = check.problems;
  }
  if (context.common.json) {
    context.out << json{{"map", flags.name},
                        {"sound", problems.empty()},
                        {"problems", problems}}
                       .dump()
                << '\n';
  } else if (problems.empty()) {
    context.out << flags.name << ": sound\n";
  }
  if (problems.empty()) return absl::OkStatus();
  return absl::DataLossError(problems.front());
}

CLI::Option* AddTerrainOptions(CLI::App& verb, TerrainFlags& flags) {
  CLI::Option* terrain = verb.add_option(
      "--terrain",
      flags.file,
      "Elevation model (GeoTIFF, DTED, what GDAL reads) to be the ground of a "
      "map that has a place on Earth");
  verb.add_option("--vertical-datum",
                  flags.datum,
                  "What its heights are counted from: ellipsoid (as GPS), "
                  "egm96 (SRTM, DTED), egm2008 (Copernicus), or a file of a "
                  "geoid's heights [what it says itself]")
      ->needs(terrain);
  verb.add_flag("--terrain-fit",
                flags.fit,
                "Move the terrain up or down to the ground that the map shows")
      ->needs(terrain);
  verb.add_option("--terrain-sigma",
                  flags.sigma_m,
                  "Of its heights, metres, 1 sigma [as the map's ground "
                  "scatters about it]")
      ->needs(terrain)
      ->check(CLI::PositiveNumber);
  verb.add_option("--terrain-margin",
                  flags.margin_m,
                  "Metres of it beyond the map [half of the map's extent]")
      ->needs(terrain)
      ->check(CLI::PositiveNumber);
  return terrain;
}

}  // namespace

void AddMapAlignVerb(CLI::App& map, VerbContext& context) {
  CLI::App* verb = map.add_subcommand(
      "align", "Give a map metres, a place on Earth and its ground");
  auto flags = std::make_shared<AlignFlags>();
  verb->add_option("NAME", flags->request.name, "Name of the map")->required();
  verb->add_option("--map-version",
                   flags->request.version,
                   "Version to start from [newest]");
  CLI::Option_group* method = verb->add_option_group("method");
  method->add_option("--similarity",
                     flags->similarity,
                     "align.json, from the coordinates that were imported");
  method->add_option("--relative",
                     flags->relative,
                     "align.json, from the map's present world");
  CLI::Option* distance =
      method
          ->add_option("--distance",
                       flags->distance_m,
                       "Metres between the points --from and --to")
          ->check(CLI::PositiveNumber);
  method->add_option("--control-points",
                     flags->control_points,
                     "JSON file of measured points of the map");
  CLI::Option* gps = method->add_option(
      "--gps",
      flags->gps,
      "Folder of the photos with their EXIF data, or a file with lines "
      "IMAGE,LATITUDE,LONGITUDE,HEIGHT");
  method->require_option(0, 1);
  const char* point_help =
      "X,Y,Z in the map's world, or IMAGE@X,Y;IMAGE@X,Y (pixels)";
  CLI::Option* from =
      verb->add_option("--from", flags->from, point_help)->needs(distance);
  CLI::Option* to =
      verb->add_option("--to", flags->to, point_help)->needs(distance);
  distance->needs(from)->needs(to);
  verb->add_option("--accuracy",
                   flags->accuracy_m,
                   "Of a good GPS position, metres, 1 sigma [3]")
      ->needs(gps)
      ->check(CLI::PositiveNumber);
  verb->add_option("--origin",
                   flags->origin,
                   "LATITUDE,LONGITUDE,HEIGHT where the world's x, y, z are "
                   "east, north, up [the middle of what was measured]");
  CLI::Option* ground =
      verb->add_option("--ground",
                       flags->ground,
                       "auto, a point X,Y,Z on it, or a plane A,B,C,D, in the "
                       "map's world");
  method->excludes(AddTerrainOptions(*verb, flags->terrain)->excludes(ground));
  verb->add_option("--seed", flags->request.seed, "Seed of random draws");
  verb->add_flag("--report-only",
                 flags->request.report_only,
                 "Say how well it fits, publish nothing");
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context] { return RunAlign(*flags, context); };
  });
}

void AddMapCheckVerb(CLI::App& map, VerbContext& context) {
  CLI::App* verb = map.add_subcommand(
      "check", "Read a whole map: its checksums, and whether it is consistent");
  auto flags = std::make_shared<CheckFlags>();
  verb->add_option(
          "MAP", flags->name, "A .glmap file here, or a map on the server")
      ->required();
  verb->add_option(
      "--map-version", flags->version, "Version of the map [newest]");
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context] {
      ExitOnInterrupt(context);
      return RunCheck(*flags, context);
    };
  });
}

}  // namespace groundlock::cli
