// SPDX-License-Identifier: Apache-2.0
// groundlock map extend | merge
#include <CLI/CLI.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/map_output.h"
#include "client/cli/parse.h"
#include "client/cli/verbs.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/build/grow.h"
#include "map_store/map/map.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// What an interrupted user wants to know instead of what was cancelled.
absl::Status UnlessInterrupted(const absl::Status& status,
                               const VerbContext& context) {
  return !status.ok() && context.interrupt.interrupted()
             ? absl::CancelledError("interrupted; no map was changed")
             : status;
}

// The newest version of a map, in the form in which it can be changed.
absl::StatusOr<map::MapData> FetchMap(const std::string& name,
                                      const fs::path& folder,
                                      sdk::Client& client,
                                      VerbContext& context) {
  const fs::path file = folder / (name + ".glmap");
  std::unique_ptr<Progress> bar;
  const absl::Status status =
      client.ExportMap(name,
                       0,
                       sdk::MapExportFormat::kGroundlock,
                       file,
                       UploadProgress(context, "download", bar));
  if (bar) bar->ClearNote();
  bar.reset();
  RETURN_IF_ERROR(UnlessInterrupted(status, context));
  ASSIGN_OR_RETURN(const auto map, map::Map::Open(file));
  return map->ToData();
}

absl::StatusOr<sdk::MapInfo> Publish(const std::string& name,
                                     const map::MapData& data,
                                     const fs::path& folder,
                                     sdk::Client& client,
                                     VerbContext& context) {
  const fs::path file = folder / "new.glmap";
  RETURN_IF_ERROR(map::WriteMapFile(data, file));
  ASSIGN_OR_RETURN(const sdk::ImportReport report,
                   UploadMap(name, file, std::nullopt, 0, client, context));
  for (const std::string& warning : report.warnings) {
    context.err << "warning: " << warning << '\n';
  }
  return report.map;
}

build::ProgressCallback Bars(StageProgress& bars) {
  return [&bars](const build::BuildProgress& progress) {
    return bars.Update(progress.stage, progress.fraction, progress.note);
  };
}

struct ExtendFlags {
  std::string name;
  std::string camera;
  build::ExtendOptions extend;
};

absl::Status RunExtend(ExtendFlags flags, VerbContext& context) {
  if (!flags.camera.empty()) {
    ASSIGN_OR_RETURN(flags.extend.camera, ReadCamera(flags.camera));
  }
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  ASSIGN_OR_RETURN(const base::TemporaryDirectory folder,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  ASSIGN_OR_RETURN(map::MapData data,
                   FetchMap(flags.name, folder.path(), *client, context));
  StageProgress bars(context);
  const auto report = build::ExtendMap(flags.extend, Bars(bars), &data);
  bars.Finish();
  RETURN_IF_ERROR(UnlessInterrupted(report.status(), context));
  for (const std::string& name : report->not_registered) {
    context.err << "warning: " << name << " found no place in the map\n";
  }
  ASSIGN_OR_RETURN(const sdk::MapInfo info,
                   Publish(flags.name, data, folder.path(), *client, context));
  if (context.common.json) {
    context.out << json{{"map", MapInfoJson(info)},
                        {"registered", report->registered},
                        {"not_registered", report->not_registered},
                        {"new_observations", report->num_new_observations},
                        {"new_landmarks", report->num_new_landmarks}}
                       .dump()
                << '\n';
  } else {
    context.out << absl::StrFormat(
        "%d of %d images added: %d new landmarks, %d new observations of old "
        "ones\nmap %s, version %d: %d landmarks in %d views\n",
        report->registered.size(),
        report->registered.size() + report->not_registered.size(),
        report->num_new_landmarks,
        report->num_new_observations,
        info.name,
        info.version,
        info.num_landmarks,
        info.num_views);
  }
  return absl::OkStatus();
}

struct MergeFlags {
  std::string name;
  std::string first;
  std::string second;
  build::MergeOptions merge;
};

absl::Status RunMerge(const MergeFlags& flags, VerbContext& context) {
  if (flags.first == flags.second) {
    return absl::InvalidArgumentError("A and B are the same map");
  }
  ASSIGN_OR_RETURN(const std::unique_ptr<sdk::Client> client, Connect(context));
  ASSIGN_OR_RETURN(const base::TemporaryDirectory folder,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  ASSIGN_OR_RETURN(map::MapData first,
                   FetchMap(flags.first, folder.path(), *client, context));
  ASSIGN_OR_RETURN(const map::MapData second,
                   FetchMap(flags.second, folder.path(), *client, context));
  StageProgress bars(context);
  const auto report = build::MergeMaps(second, flags.merge, Bars(bars), &first);
  bars.Finish();
  RETURN_IF_ERROR(UnlessInterrupted(report.status(), context));
  ASSIGN_OR_RETURN(const sdk::MapInfo info,
                   Publish(flags.name, first, folder.path(), *client, context));
  const geometry::Similarity3& s = report->first_from_second;
  if (context.common.json) {
    context.out
        << json{{"map", MapInfoJson(info)},
                {"common_landmarks", report->num_common_landmarks},
                {"candidates", report->num_candidates},
                {"median_error_px", report->median_error_px},
                {"median_distance", report->median_distance},
                {"first_from_second",
                 {{"scale", s.scale},
                  {"rotation_wxyz",
                   {s.rotation.w(),
                    s.rotation.x(),
                    s.rotation.y(),
                    s.rotation.z()}},
                  {"translation",
                   {s.translation.x(), s.translation.y(), s.translation.z()}}}}}
               .dump()
        << '\n';
  } else {
    context.out << absl::StrFormat(
        "%d common landmarks (of %d that look alike), %.2f px and %.3g %s "
        "apart in the median; lengths of %s times %.4f are those of %s\n"
        "map %s, version %d: %d landmarks in %d views\n",
        report->num_common_landmarks,
        report->num_candidates,
        report->median_error_px,
        report->median_distance,
        info.metric ? "m" : "units",
        flags.second,
        s.scale,
        flags.first,
        info.name,
        info.version,
        info.num_landmarks,
        info.num_views);
  }
  return absl::OkStatus();
}

}  // namespace

void AddMapGrowVerbs(CLI::App& map, VerbContext& context) {
  CLI::App* extend = map.add_subcommand(
      "extend", "Add images to a map; a new version of it is published");
  auto grow = std::make_shared<ExtendFlags>();
  extend->add_option("NAME", grow->name, "Name of the map")->required();
  extend->add_option("--images", grow->extend.images, "Folder of new images")
      ->required();
  extend
      ->add_option("--camera",
                   grow->camera,
                   "camera.json: their lens [the map's own of that size]")
      ->type_name("camera.json");
  extend
      ->add_option("--min-inliers",
                   grow->extend.min_inliers,
                   "Landmarks that must agree on where an image was taken")
      ->capture_default_str();
  extend->add_option("--threads", grow->extend.threads, "0 = all cores")
      ->capture_default_str();
  AddCommonOptions(*extend, context);
  extend->callback([grow, &context] {
    context.run = [grow, &context] { return RunExtend(*grow, context); };
  });

  CLI::App* merge = map.add_subcommand(
      "merge", "Make one map of two that show the same place in part");
  auto both = std::make_shared<MergeFlags>();
  merge->add_option("NEW", both->name, "Name of the map to make")->required();
  merge->add_option("A", both->first, "The map whose world and unit it gets")
      ->required();
  merge->add_option("B", both->second, "The map that is brought there")
      ->required();
  merge
      ->add_option("--min-common",
                   both->merge.min_common_landmarks,
                   "Landmarks that both must have in common")
      ->capture_default_str();
  merge->add_option("--threads", both->merge.threads, "0 = all cores")
      ->capture_default_str();
  merge->add_option("--seed", both->merge.seed, "Seed of everything random");
  AddCommonOptions(*merge, context);
  merge->callback([both, &context] {
    context.run = [both, &context] { return RunMerge(*both, context); };
  });
}

}  // namespace groundlock::cli
