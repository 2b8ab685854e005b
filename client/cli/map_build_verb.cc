// SPDX-License-Identifier: Apache-2.0
// groundlock map build
#include <CLI/CLI.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/map_output.h"
#include "client/cli/parse.h"
#include "client/cli/verbs.h"
#include "client/media/video_source.h"
#include "map_store/base/status.h"
#include "map_store/build/build.h"
#include "map_store/build/posed.h"
#include "map_store/formats/formats.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct BuildFlags {
  std::string name;
  std::string poses;
  double pose_sigma_m = 0.0;
  double pose_sigma_deg = 0.0;
  std::string camera;
  std::string align;
  std::string features = "groundlock";
  bool keep_local = false;
  bool on_server = false;
  bool min_views_given = false;
  build::BuildOptions build;
};

void PrintVersion(const sdk::MapInfo& map, VerbContext& context) {
  context.out << absl::StrFormat(
      "map %s, version %d%s\n",
      map.name,
      map.version,
      absl::StrCat(
          map.metric ? ", metric" : ", unit unknown (groundlock map align)",
          ", ground ",
          GroundText(map)));
}

// A map is not moved without being asked to: receivers may be far off, and a
// user may want another world.
void SayHowToAlign(const std::string& name,
                   const std::string& photos,
                   int num_with_gps,
                   VerbContext& context) {
  constexpr int kMinPositions = 3;  // that determine a world
  if (num_with_gps < kMinPositions) return;
  context.out << absl::StrFormat(
      "%d photos have GPS: groundlock map align %s --gps %s gives the map "
      "metres and a place on Earth\n",
      num_with_gps,
      name,
      photos);
}

// Prints the report, uploads the model unless it stays, and prints the map.
absl::Status Deliver(const BuildFlags& flags,
                     const build::BuildReport& report,
                     const fs::path& model,
                     const std::optional<geometry::Similarity3>& alignment,
                     sdk::Client* client,
                     VerbContext& context) {
  const std::string report_file =
      (flags.build.work_folder / "report.html").string();
  for (const std::string& warning : report.warnings) {
    context.err << "warning: " << warning << '\n';
  }
  json result = {{"report", json::parse(build::ReportJson(report))},
                 {"report_file", report_file},
                 {"model", model.string()}};
  if (!context.common.json) {
    context.out << absl::StrFormat(
        "%d of %d images in the map, %d landmarks seen %.1f times each, %.2f "
        "px reprojection error\nreport: %s\n",
        report.num_registered,
        report.images.size(),
        report.num_landmarks,
        report.mean_track_length,
        report.mean_reprojection_error_px,
        report_file);
  }
  if (!context.common.json && !report.up_basis.empty()) {
    context.out << "up: by " << report.up_basis << '\n';
  }
  if (client != nullptr) {
    ASSIGN_OR_RETURN(
        const sdk::ImportReport imported,
        UploadMap(
            flags.name, model, alignment, flags.build.seed, *client, context));
    for (const std::string& warning : imported.warnings) {
      context.err << "warning: " << warning << '\n';
    }
    result["map"] = MapInfoJson(imported.map);
    if (!context.common.json) {
      PrintVersion(imported.map, context);
    }
  }
  if (!context.common.json && !alignment) {
    SayHowToAlign(
        flags.name, flags.build.images.string(), report.num_with_gps, context);
  }
  if (context.common.json) context.out << result.dump() << '\n';
  return absl::OkStatus();
}

// Known poses: no structure from motion, and the map is in their world.
absl::Status RunPosedBuild(
    const BuildFlags& flags,
    const std::optional<geometry::Similarity3>& alignment,
    sdk::Client* client,
    VerbContext& context) {
  constexpr double kRadPerDeg = 3.14159265358979323846 / 180.0;
  build::PosedOptions options;
  options.images = flags.build.images;
  ASSIGN_OR_RETURN(options.poses, build::ReadPoses(flags.poses));
  options.camera = flags.build.camera;
  options.sigma_m = flags.pose_sigma_m;
  options.sigma_rad = flags.pose_sigma_deg * kRadPerDeg;
  options.max_features = flags.build.max_features;
  options.threads = flags.build.threads;
  if (flags.min_views_given) options.min_views = flags.build.min_views;
  StageProgress bars(context);
  auto built =
      build::BuildFromPoses(options, [&](const build::BuildProgress& progress) {
        return bars.Update(progress.stage, progress.fraction, progress.note);
      });
  bars.Finish();
  RETURN_IF_ERROR(built.status());
  const fs::path model = flags.build.work_folder / "map";
  std::error_code error;
  fs::create_directories(flags.build.work_folder, error);
  fs::remove_all(model, error);
  RETURN_IF_ERROR(formats::Export(
      built->data, formats::ExportFormat::kColmapBinary, model));
  RETURN_IF_ERROR(build::WriteReport(built->report,
                                     built->data,
                                     flags.build.seed,
                                     flags.name,
                                     flags.build.work_folder));
  // The poses' world is metric, z up, unless align.json says what it is.
  return Deliver(flags,
                 built->report,
                 model,
                 alignment.value_or(geometry::Similarity3()),
                 client,
                 context);
}

// The same work over there, from the same files.
absl::Status RunBuildOnServer(const BuildFlags& flags, VerbContext& context) {
  sdk::BuildRequest request;
  request.name = flags.name;
  request.camera = flags.build.camera;
  request.max_images = static_cast<std::uint32_t>(flags.build.max_images);
  request.max_features = static_cast<std::uint32_t>(flags.build.max_features);
  request.seed = flags.build.seed;
  if (flags.build.video.empty() == flags.build.images.empty()) {
    return absl::InvalidArgumentError(
        "give either --video or --images with photos");
  }
  if (flags.build.video.empty()) {
    ASSIGN_OR_RETURN(const std::vector<fs::path> images,
                     media::ListImages(flags.build.images));
    for (const fs::path& image : images) {
      request.files.push_back({image, image.filename().string()});
    }
  } else {
    request.video_path = flags.build.video.filename().string();
    request.files.push_back({flags.build.video, request.video_path});
  }
  ASSIGN_OR_RETURN(const auto client, Connect(context));
  StageProgress bars(context);
  const auto built = client->BuildMap(
      request,
      [&](std::string_view stage, double fraction, const std::string& note) {
        return bars.Update(stage, fraction, note);
      });
  bars.Finish();
  if (context.interrupt.interrupted() && !built.ok()) {
    return absl::CancelledError("interrupted; no map was published");
  }
  RETURN_IF_ERROR(built.status());
  for (const std::string& warning : built->warnings) {
    context.err << "warning: " << warning << '\n';
  }
  const json report = json::parse(built->report_json, nullptr, false);
  if (!report.is_object()) {
    return absl::InternalError("the server sent a report that is not JSON");
  }
  if (context.common.json) {
    context.out << json{{"report", report}, {"map", MapInfoJson(built->map)}}
                << '\n';
    return absl::OkStatus();
  }
  context.out << absl::StrFormat(
      "%d images in the map, %d landmarks, %.2f px reprojection error\n",
      built->map.num_views,
      built->map.num_landmarks,
      built->map.mean_reprojection_error_px);
  const json basis = report.value("up_basis", json());
  if (basis.is_string() && !basis.get<std::string>().empty()) {
    context.out << "up: by " << basis.get<std::string>() << '\n';
  }
  PrintVersion(built->map, context);
  const json num_with_gps = report.value("num_with_gps", json());
  SayHowToAlign(flags.name,
                flags.build.images.string(),
                num_with_gps.is_number_integer() ? num_with_gps.get<int>() : 0,
                context);
  return absl::OkStatus();
}

absl::Status RunBuild(BuildFlags flags, VerbContext& context) {
  if (!flags.camera.empty()) {
    ASSIGN_OR_RETURN(flags.build.camera, ReadCamera(flags.camera));
  }
  std::optional<geometry::Similarity3> alignment;
  if (!flags.align.empty()) {
    ASSIGN_OR_RETURN(alignment, ReadAlignment(flags.align));
  }
  if (flags.features != "groundlock" && flags.features != "colmap") {
    return absl::InvalidArgumentError(absl::StrCat(
        "--features ", flags.features, ": expected groundlock or colmap"));
  }
  flags.build.features = flags.features == "colmap"
                             ? build::FeatureKind::kColmap
                             : build::FeatureKind::kGroundlock;
  if (!flags.poses.empty() &&
      flags.build.features == build::FeatureKind::kColmap) {
    return absl::InvalidArgumentError(
        "--features colmap: features of images with --poses are always "
        "groundlock's");
  }
  if (flags.on_server) {
    return RunBuildOnServer(flags, context);
  }
  if (flags.build.work_folder.empty()) {
    flags.build.work_folder = flags.name + ".build";
  }
  // Known before the work is done rather than after it.
  std::unique_ptr<sdk::Client> client;
  if (!flags.keep_local) {
    ASSIGN_OR_RETURN(client, Connect(context));
  }
  if (!flags.poses.empty()) {
    return RunPosedBuild(flags, alignment, client.get(), context);
  }
  StageProgress bars(context);
  const auto built =
      build::Build(flags.build, [&](const build::BuildProgress& progress) {
        return bars.Update(progress.stage, progress.fraction, progress.note);
      });
  bars.Finish();
  if (built.status().code() == absl::StatusCode::kCancelled) {
    return absl::CancelledError(
        absl::StrCat("interrupted; the same command goes on from what is in ",
                     flags.build.work_folder.string()));
  }
  RETURN_IF_ERROR(built.status());
  return Deliver(
      flags, built->report, built->model, alignment, client.get(), context);
}

}  // namespace

void AddMapBuildVerb(CLI::App& map, VerbContext& context) {
  CLI::App* verb = map.add_subcommand(
      "build", "Make a map from a video or photos of a place");
  auto flags = std::make_shared<BuildFlags>();
  build::BuildOptions& options = flags->build;
  verb->add_option("NAME", flags->name, "Name of the map")->required();
  auto* video = verb->add_option(
      "--video", options.video, "A walk through the place, filmed");
  auto* images = verb->add_option(
      "--images", options.images, "Folder of photos of the place");
  images->excludes(video);
  auto* poses = verb->add_option(
      "--poses",
      flags->poses,
      "Poses of the photos, where they are known: .csv "
      "(name,x,y,z,qw,qx,qy,qz, "
      "metres, world_from_camera) or .json; the map is then in their world");
  poses->needs(images);
  verb->add_option("--pose-sigma",
                   flags->pose_sigma_m,
                   "How far a position may be off, m; 0 = exact")
      ->needs(poses);
  verb->add_option("--pose-sigma-deg",
                   flags->pose_sigma_deg,
                   "How far an orientation may be off, degrees; 0 = exact")
      ->needs(poses);
  verb->add_option("--camera",
                   flags->camera,
                   "camera.json: the lens, kept as it is; without it the lens "
                   "is estimated along with the map")
      ->type_name("camera.json");
  verb->add_option("--work",
                   options.work_folder,
                   "Folder for everything on the way, and for the report "
                   "[NAME.build]")
      ->type_name("DIR");
  verb->add_option("--align",
                   flags->align,
                   "align.json: puts the map into metres, z up; without it "
                   "the ground is estimated");
  verb->add_option("--max-images",
                   options.max_images,
                   "Of a video: at most so many frames; 0 = no limit")
      ->capture_default_str();
  verb->add_option("--spacing",
                   options.keyframes.spacing,
                   "Of a video: how far the picture moves between two frames, "
                   "as a share of its width")
      ->capture_default_str();
  verb->add_option("--max-features", options.max_features, "Features per image")
      ->capture_default_str();
  verb->add_option("--features",
                   flags->features,
                   "Who finds features: groundlock, or colmap (slower)")
      ->capture_default_str();
  verb->add_option("--min-views",
                   options.min_views,
                   "Landmarks seen in fewer images are left out")
      ->capture_default_str();
  verb->add_option("--threads", options.threads, "0 = all cores")
      ->capture_default_str();
  verb->add_option("--colmap", options.colmap, "COLMAP's program")
      ->capture_default_str();
  verb->add_option("--seed", options.seed, "Seed of everything random");
  verb->add_flag("--keep-local",
                 flags->keep_local,
                 "Do not upload: the model stays in the work folder");
  auto* on_server = verb->add_flag(
      "--on-server",
      flags->on_server,
      "Let the server do the work: it gets the video or the photos");
  for (const char* local : {"--poses",
                            "--work",
                            "--align",
                            "--spacing",
                            "--features",
                            "--min-views",
                            "--threads",
                            "--colmap",
                            "--keep-local"}) {
    on_server->excludes(verb->get_option(local));
  }
  AddCommonOptions(*verb, context);
  verb->callback([flags, verb, &context] {
    flags->min_views_given = verb->count("--min-views") > 0;
    context.run = [flags, &context] { return RunBuild(*flags, context); };
  });
}

}  // namespace groundlock::cli
