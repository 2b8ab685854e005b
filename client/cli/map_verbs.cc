// SPDX-License-Identifier: Apache-2.0
// groundlock map import | list | show | delete | export
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <ctime>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/map_lens.h"
#include "client/cli/map_output.h"
#include "client/cli/names.h"
#include "client/cli/parse.h"
#include "client/cli/progress.h"
#include "client/cli/verbs.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/formats.h"
#include "map_store/formats/photo_readings.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double kMiB = 1 << 20;

// RFC 3339, UTC.
std::string TimeText(std::chrono::system_clock::time_point time) {
  const std::time_t seconds = std::chrono::system_clock::to_time_t(time);
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  char text[32] = {};
  std::strftime(text, sizeof(text), "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

json GeodeticJson(const geometry::GeodeticPosition& place) {
  return {{"latitude_deg", place.latitude_deg},
          {"longitude_deg", place.longitude_deg},
          {"height_m", place.height_m}};
}

json MapJson(const sdk::MapInfo& map) {
  const geometry::Similarity3& s = map.world_from_source;
  return {
      {"name", map.name},
      {"version", map.version},
      {"content_hash", map.content_hash},
      {"create_time", TimeText(map.create_time)},
      {"source_format", map.source_format},
      {"metric", map.metric},
      {"world_from_source",
       {{"scale", s.scale},
        {"rotation_wxyz",
         {s.rotation.w(), s.rotation.x(), s.rotation.y(), s.rotation.z()}},
        {"translation",
         {s.translation.x(), s.translation.y(), s.translation.z()}}}},
      {"lens",
       map.lens ? json::parse(geometry::CameraModelToJson(*map.lens)) : json()},
      {"ground",
       {{"state", GroundStateName(map.ground_state)},
        {"sigma_deg",
         map.ground_sigma_deg > 0.0 ? json(map.ground_sigma_deg) : json()},
        {"height_sigma",
         map.ground_height_sigma > 0.0 ? json(map.ground_height_sigma)
                                       : json()},
        {"relief", map.ground_relief_m},
        {"relief_given", map.ground_relief_given},
        {"normal",
         {map.ground_world.normal.x(),
          map.ground_world.normal.y(),
          map.ground_world.normal.z()}},
        {"d", map.ground_world.d}}},
      {"origin", map.origin ? GeodeticJson(*map.origin) : json()},
      {"num_cameras", map.num_cameras},
      {"num_views", map.num_views},
      {"num_landmarks", map.num_landmarks},
      {"num_observations", map.num_observations},
      {"mean_reprojection_error_px", map.mean_reprojection_error_px},
      {"has_descriptors", map.has_descriptors},
      {"file_bytes", map.file_bytes}};
}

void PrintMap(const sdk::MapInfo& map, std::ostream& out) {
  const auto line = [&](const char* name, const std::string& value) {
    out << absl::StrFormat("%-12s %s\n", name, value);
  };
  line("name", map.name);
  line("version", absl::StrCat(map.version));
  line("created", TimeText(map.create_time));
  line("from", map.source_format);
  line("unit",
       map.metric ? "metres (aligned)"
                  : "unknown (groundlock map align NAME gives it metres)");
  if (map.origin) {
    line("on Earth",
         absl::StrFormat("x east, y north, z up at %.7f, %.7f, %.2f m",
                         map.origin->latitude_deg,
                         map.origin->longitude_deg,
                         map.origin->height_m));
  }
  line("views",
       absl::StrCat(map.num_views,
                    ", taken by ",
                    map.num_cameras,
                    map.num_cameras == 1 ? " camera" : " cameras"));
  line("landmarks", absl::StrCat(map.num_landmarks));
  line("observed",
       absl::StrFormat("%d times, %.3f px mean reprojection error",
                       map.num_observations,
                       map.mean_reprojection_error_px));
  line("descriptors",
       map.has_descriptors ? "yes" : "none: no camera can be localised in it");
  line("lens",
       map.lens ? LensText(*map.lens)
                : "several: track and localize need --camera");
  line("ground", GroundText(map));
  if (map.ground_state != sdk::GroundState::kUnknown) {
    line("",
         absl::StrFormat("normal (%.4f, %.4f, %.4f), d %.4f",
                         map.ground_world.normal.x(),
                         map.ground_world.normal.y(),
                         map.ground_world.normal.z(),
                         map.ground_world.d));
  }
  line("size", absl::StrFormat("%.1f MiB", map.file_bytes / kMiB));
  line("hash", map.content_hash);
}

// Draws a transfer's progress and cancels it when the user interrupts.
sdk::Progress TransferProgress(const VerbContext& context,
                               std::string label,
                               std::unique_ptr<Progress>& bar) {
  return [&context, &bar, label = std::move(label)](std::uint64_t done,
                                                    std::uint64_t total) {
    // Nothing is known yet: the server prepares an export.
    if (total == 0) return !context.interrupt.interrupted();
    const auto mib = [](std::uint64_t bytes) {
      return static_cast<std::uint64_t>(bytes / kMiB + 0.999);
    };
    if (!bar) {
      const Terminal terminal = StderrTerminal();
      bar = std::make_unique<Progress>(
          context.err,
          Progress::Options{.label = label,
                            .total = mib(total),
                            .unit = "MiB",
                            .terminal = terminal.is_terminal,
                            .columns = terminal.columns});
    }
    bar->Update(mib(done), done == total ? "waiting for the server" : "");
    return !context.interrupt.interrupted();
  };
}

// --- import ----------------------------------------------------------------

struct ImportFlags {
  std::string name;
  std::string path;
  std::string format = "auto";
  std::string database;
  std::string images;
  std::string align;
  std::string photos;
  std::uint64_t seed = 0;
};

absl::StatusOr<sdk::ImportRequest> MakeImportRequest(const ImportFlags& flags) {
  formats::ImportOptions options;
  ASSIGN_OR_RETURN(options.format, formats::FormatFromName(flags.format));
  options.database = flags.database;
  options.images = flags.images;
  sdk::ImportRequest request;
  request.name = flags.name;
  request.seed = flags.seed;
  if (!flags.align.empty()) {
    ASSIGN_OR_RETURN(request.world_from_source, ReadAlignment(flags.align));
  }
  ASSIGN_OR_RETURN(const formats::ImportFiles found,
                   formats::FindImportFiles(flags.path, options));
  switch (found.format) {
    case formats::Format::kAuto:
      request.format = sdk::MapFormat::kAuto;
      break;
    case formats::Format::kColmap:
      request.format = sdk::MapFormat::kColmap;
      break;
    case formats::Format::kNvm:
      request.format = sdk::MapFormat::kNvm;
      break;
    case formats::Format::kBundler:
      request.format = sdk::MapFormat::kBundler;
      break;
    case formats::Format::kOpenMvg:
      request.format = sdk::MapFormat::kOpenMvg;
      break;
    case formats::Format::kOpenSfm:
      request.format = sdk::MapFormat::kOpenSfm;
      break;
    case formats::Format::kGroundlock:
      request.format = sdk::MapFormat::kGroundlock;
      break;
  }
  for (const formats::ImportFile& file : found.files) {
    request.files.push_back({file.path, file.remote});
  }
  request.model_path = found.model;
  request.database_path = found.database;
  request.images_path = found.images;
  return request;
}

// What the photos' sensors say goes along as a file beside the model.
absl::Status AddPhotoReadings(const ImportFlags& flags,
                              const fs::path& folder,
                              sdk::ImportRequest& request) {
  const bool is_asked_for = !flags.photos.empty();
  const fs::path photos = is_asked_for ? flags.photos : flags.images;
  const bool is_in_world = request.format == sdk::MapFormat::kGroundlock;
  if (is_asked_for && is_in_world) {
    return absl::InvalidArgumentError(
        "--photos: a .glmap file is in its world already");
  }
  std::error_code error;
  if (!is_asked_for && (is_in_world || !fs::is_directory(photos, error))) {
    return absl::OkStatus();
  }
  map::UpReadings readings;
  ASSIGN_OR_RETURN(readings.photos, formats::ReadPhotoReadings(photos));
  if (readings.photos.empty()) {
    return is_asked_for
               ? absl::NotFoundError(absl::StrCat(
                     photos.string(),
                     ": no photo here that says how it was held (XMP) or where "
                     "(GPS)"))
               : absl::OkStatus();
  }
  // What a build has seen in the images stays.
  const auto there = std::find_if(
      request.files.begin(), request.files.end(), [](const auto& known) {
        return known.remote_path == formats::kPhotoReadingsFile;
      });
  if (there != request.files.end()) {
    ASSIGN_OR_RETURN(const map::UpReadings before,
                     formats::ReadUpReadings(there->path));
    readings.edges = before.edges;
    request.files.erase(there);
  }
  const fs::path file = folder / formats::kPhotoReadingsFile;
  RETURN_IF_ERROR(
      base::WriteFileAtomically(file, formats::UpReadingsToJson(readings)));
  request.files.push_back({file, formats::kPhotoReadingsFile});
  return absl::OkStatus();
}

absl::Status RunImport(const ImportFlags& flags, VerbContext& context) {
  ASSIGN_OR_RETURN(sdk::ImportRequest request, MakeImportRequest(flags));
  ASSIGN_OR_RETURN(const base::TemporaryDirectory folder,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  RETURN_IF_ERROR(AddPhotoReadings(flags, folder.path(), request));
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  std::unique_ptr<Progress> bar;
  const auto report =
      client->ImportMap(request, TransferProgress(context, "import", bar));
  if (bar) bar->ClearNote();
  bar.reset();
  if (context.interrupt.interrupted() && !report.ok()) {
    return absl::CancelledError("interrupted; no map was imported");
  }
  RETURN_IF_ERROR(base::Annotate(report.status(), flags.path));
  for (const std::string& warning : report->warnings) {
    context.err << "warning: " << warning << '\n';
  }
  if (context.common.json) {
    context.out << json{{"map", MapJson(report->map)},
                        {"warnings", report->warnings}}
                       .dump()
                << '\n';
  } else {
    context.out << absl::StrFormat(
        "map %s, version %d: %d landmarks in %d views, %s\n",
        report->map.name,
        report->map.version,
        report->map.num_landmarks,
        report->map.num_views,
        report->map.metric ? "metric" : "ground estimated, unit unknown");
  }
  return absl::OkStatus();
}

void AddImport(CLI::App& map, VerbContext& context) {
  CLI::App* verb = map.add_subcommand(
      "import", "Upload a reconstruction of another tool as a map");
  auto flags = std::make_shared<ImportFlags>();
  verb->add_option("NAME", flags->name, "Name of the map")->required();
  verb->add_option(
          "PATH",
          flags->path,
          "COLMAP's model folder; VisualSFM's .nvm, Bundler's bundle.out, "
          "OpenMVG's sfm_data.json, OpenSfM's reconstruction.json or a .glmap "
          "file, or the folder of one")
      ->required();
  verb->add_option("--format",
                   flags->format,
                   "auto, colmap, nvm, bundler, openmvg, opensfm or groundlock")
      ->capture_default_str();
  verb->add_option("--database",
                   flags->database,
                   "COLMAP's database with the features' descriptors "
                   "[database.db beside or above the model]");
  verb->add_option("--images",
                   flags->images,
                   "Folder of the images and of the files of their features "
                   "(.sift, .key, .feat and .desc) [beside the model]");
  verb->add_option("--photos",
                   flags->photos,
                   "Folder of the photos as the camera wrote them: the angles "
                   "and GPS positions in them tell which way is up "
                   "[--images]");
  verb->add_option("--align",
                   flags->align,
                   "align.json: puts the map into metres, z up; without it "
                   "the ground is estimated");
  verb->add_option("--seed", flags->seed, "Seed of the ground estimate");
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context] { return RunImport(*flags, context); };
  });
}

// --- list, show, delete, export ----------------------------------------------

absl::Status RunList(VerbContext& context) {
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  ASSIGN_OR_RETURN(const std::vector<sdk::MapInfo> maps, client->ListMaps());
  if (context.common.json) {
    json list = json::array();
    for (const sdk::MapInfo& map : maps) list.push_back(MapJson(map));
    context.out << list.dump() << '\n';
    return absl::OkStatus();
  }
  if (maps.empty()) {
    context.out << "no maps yet: groundlock map import NAME PATH\n";
    return absl::OkStatus();
  }
  size_t width = 4;
  for (const sdk::MapInfo& map : maps) width = std::max(width, map.name.size());
  const int w = static_cast<int>(width);
  context.out << absl::StrFormat(
      "%-*s  version  landmarks   views  unit    "
      "created\n",
      w,
      "name");
  for (const sdk::MapInfo& map : maps) {
    context.out << absl::StrFormat("%-*s  %7d  %9d  %6d  %-6s  %s\n",
                                   w,
                                   map.name,
                                   map.version,
                                   map.num_landmarks,
                                   map.num_views,
                                   map.metric ? "metres" : "none",
                                   TimeText(map.create_time));
  }
  return absl::OkStatus();
}

absl::Status RunShow(const std::string& name,
                     std::uint64_t version,
                     VerbContext& context) {
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  ASSIGN_OR_RETURN(const sdk::MapInfo map, client->GetMap(name, version));
  if (context.common.json) {
    context.out << MapJson(map).dump() << '\n';
  } else {
    PrintMap(map, context.out);
  }
  return absl::OkStatus();
}

absl::Status RunDelete(const std::string& name, VerbContext& context) {
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  RETURN_IF_ERROR(client->DeleteMap(name));
  if (context.common.json) {
    context.out << json{{"deleted", name}}.dump() << '\n';
  } else {
    context.out << "deleted " << name << '\n';
  }
  return absl::OkStatus();
}

absl::StatusOr<sdk::MapExportFormat> ExportFormatOf(const std::string& name) {
  ASSIGN_OR_RETURN(const formats::ExportFormat format,
                   formats::ExportFormatFromName(name));
  switch (format) {
    case formats::ExportFormat::kColmapBinary:
      return sdk::MapExportFormat::kColmap;
    case formats::ExportFormat::kColmapText:
      return sdk::MapExportFormat::kColmapText;
    case formats::ExportFormat::kNvm:
      return sdk::MapExportFormat::kNvm;
    case formats::ExportFormat::kPly:
      return sdk::MapExportFormat::kPly;
    case formats::ExportFormat::kGroundlock:
      return sdk::MapExportFormat::kGroundlock;
  }
  return absl::InternalError("unknown export format");
}

struct ExportFlags {
  std::string name;
  std::string path;
  std::string format = "colmap";
  std::uint64_t version = 0;
};

absl::Status RunExport(const ExportFlags& flags, VerbContext& context) {
  ASSIGN_OR_RETURN(const sdk::MapExportFormat format,
                   ExportFormatOf(flags.format));
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  std::unique_ptr<Progress> bar;
  std::vector<std::string> warnings;
  const absl::Status status =
      client->ExportMap(flags.name,
                        flags.version,
                        format,
                        flags.path,
                        TransferProgress(context, "export", bar),
                        &warnings);
  if (bar) bar->ClearNote();
  bar.reset();
  if (context.interrupt.interrupted() && !status.ok()) {
    return absl::CancelledError("interrupted; nothing was exported");
  }
  RETURN_IF_ERROR(status);
  for (const std::string& warning : warnings) {
    context.err << "warning: " << warning << '\n';
  }
  if (context.common.json) {
    context.out << json{{"name", flags.name},
                        {"format", flags.format},
                        {"path", flags.path},
                        {"warnings", warnings}}
                       .dump()
                << '\n';
  } else {
    context.out << "exported " << flags.name << " to " << flags.path << '\n';
  }
  return absl::OkStatus();
}

void AddExport(CLI::App& map, VerbContext& context) {
  CLI::App* verb =
      map.add_subcommand("export", "Write a map as another tool's files");
  auto flags = std::make_shared<ExportFlags>();
  verb->add_option("NAME", flags->name, "Name of the map")->required();
  verb->add_option("PATH", flags->path, "Folder (COLMAP) or file to write")
      ->required();
  verb->add_option(
          "--format",
          flags->format,
          "colmap, colmap-text, nvm, ply, or groundlock for the map file")
      ->capture_default_str();
  verb->add_option(
      "--map-version", flags->version, "Version of the map [newest]");
  AddCommonOptions(*verb, context);
  verb->callback([flags, &context] {
    context.run = [flags, &context] { return RunExport(*flags, context); };
  });
}

}  // namespace

json MapInfoJson(const sdk::MapInfo& map) { return MapJson(map); }

void ExitOnInterrupt(VerbContext& context) {
  context.interrupt.OnInterrupt([] { _exit(130); });
}

sdk::Progress UploadProgress(const VerbContext& context,
                             std::string label,
                             std::unique_ptr<Progress>& bar) {
  return TransferProgress(context, std::move(label), bar);
}

void AddMapVerbs(CLI::App& app, VerbContext& context) {
  CLI::App* map = app.add_subcommand("map", "Maps on the server");
  map->require_subcommand(1);
  AddMapBuildVerb(*map, context);
  AddMapGrowVerbs(*map, context);
  AddImport(*map, context);

  CLI::App* list = map->add_subcommand("list", "The maps on the server");
  AddCommonOptions(*list, context);
  list->callback([&context] {
    context.run = [&context] {
      ExitOnInterrupt(context);
      return RunList(context);
    };
  });

  struct Named {
    std::string name;
    std::uint64_t version = 0;
  };
  auto named = std::make_shared<Named>();
  CLI::App* show = map->add_subcommand("show", "What a map holds");
  show->add_option("NAME", named->name, "Name of the map")->required();
  show->add_option(
      "--map-version", named->version, "Version of the map [newest]");
  AddCommonOptions(*show, context);
  show->callback([named, &context] {
    context.run = [named, &context] {
      ExitOnInterrupt(context);
      return RunShow(named->name, named->version, context);
    };
  });

  CLI::App* remove =
      map->add_subcommand("delete", "Delete a map with all its versions");
  remove->add_option("NAME", named->name, "Name of the map")->required();
  AddCommonOptions(*remove, context);
  remove->callback([named, &context] {
    context.run = [named, &context] {
      ExitOnInterrupt(context);
      return RunDelete(named->name, context);
    };
  });
  AddExport(*map, context);
  AddMapAlignVerb(*map, context);
  AddMapCheckVerb(*map, context);
}

}  // namespace groundlock::cli
