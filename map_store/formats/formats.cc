// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/formats.h"

#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/source.h"
#include "map_store/formats/photo_readings.h"
#include "map_store/map/map.h"

namespace groundlock::formats {

namespace fs = std::filesystem;
using base::Abseil;

namespace {

// What the photos' sensors say of up, if that lies beside the model.
absl::Status AddMeasuredUp(const fs::path& file,
                           map::MapData& data,
                           std::vector<std::string>& warnings) {
  std::error_code error;
  if (!fs::is_regular_file(file, error)) return absl::OkStatus();
  ASSIGN_OR_RETURN(const map::UpReadings readings, ReadUpReadings(file));
  data.measured_up = map::MeasureUp(readings, data, warnings);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<Format> FormatFromName(std::string_view name) {
  std::string known;
  for (const Format format : {Format::kAuto,
                              Format::kColmap,
                              Format::kNvm,
                              Format::kBundler,
                              Format::kOpenMvg,
                              Format::kOpenSfm,
                              Format::kGroundlock}) {
    if (name == FormatName(format)) return format;
    absl::StrAppend(
        &known, known.empty() ? "" : ", ", Abseil(FormatName(format)));
  }
  return absl::InvalidArgumentError(
      absl::StrCat("unknown format \"", Abseil(name), "\"; known are ", known));
}

std::string_view FormatName(Format format) {
  switch (format) {
    case Format::kAuto:
      return "auto";
    case Format::kColmap:
      return "colmap";
    case Format::kNvm:
      return "nvm";
    case Format::kBundler:
      return "bundler";
    case Format::kOpenMvg:
      return "openmvg";
    case Format::kOpenSfm:
      return "opensfm";
    case Format::kGroundlock:
      return "groundlock";
  }
  return "unknown";
}

absl::StatusOr<map::MapData> Import(const fs::path& path,
                                    const ImportOptions& options,
                                    std::vector<std::string>* warnings) {
  std::vector<std::string> unheard;
  if (warnings == nullptr) warnings = &unheard;
  ASSIGN_OR_RETURN(const internal::Source source,
                   internal::FindSource(path, options, warnings));
  internal::MemoryBudget budget(options.memory_bytes);
  absl::StatusOr<map::MapData> data =
      absl::InternalError("the format was not found out");
  switch (source.format) {
    case Format::kAuto:
      break;
    case Format::kColmap:
      data = internal::ImportColmap(
          source.colmap, !options.database.empty(), budget, warnings);
      break;
    case Format::kNvm:
      data = internal::ImportNvm(source.file, options.images, budget, warnings);
      break;
    case Format::kBundler:
      data = internal::ImportBundler(
          source.file, options.images, budget, options.go_on, warnings);
      break;
    case Format::kOpenMvg:
      data = internal::ImportOpenMvg(
          source.file, options.images, budget, options.go_on, warnings);
      break;
    case Format::kOpenSfm:
      data = internal::ImportOpenSfm(
          source.file, options.images, budget, options.go_on, warnings);
      break;
    case Format::kGroundlock:
      data = internal::ImportMapFile(source.file);
      break;
  }
  RETURN_IF_ERROR(data.status());
  // What the importers let through must be a map; this is their safety net.
  RETURN_IF_ERROR(base::Annotate(data->Validate(), path.string()));
  if (source.format != Format::kGroundlock) {
    RETURN_IF_ERROR(AddMeasuredUp(source.photo_readings(), *data, *warnings));
  }
  return data;
}

absl::StatusOr<map::MapData> internal::ImportMapFile(const fs::path& path) {
  ASSIGN_OR_RETURN(const auto map, map::Map::Open(path));
  RETURN_IF_ERROR(base::Annotate(map->Verify(), path.string()));
  return map->ToData();
}

absl::StatusOr<ExportFormat> ExportFormatFromName(std::string_view name) {
  if (name == "colmap") return ExportFormat::kColmapBinary;
  if (name == "colmap-text") return ExportFormat::kColmapText;
  if (name == "nvm") return ExportFormat::kNvm;
  if (name == "ply") return ExportFormat::kPly;
  if (name == "groundlock") return ExportFormat::kGroundlock;
  return absl::InvalidArgumentError(
      absl::StrCat("unknown export format \"",
                   Abseil(name),
                   "\"; known are colmap, colmap-text, nvm, ply, groundlock"));
}

absl::Status Export(const map::MapData& data,
                    ExportFormat format,
                    const fs::path& path,
                    std::vector<std::string>* warnings) {
  RETURN_IF_ERROR(data.Validate());
  fs::path target = path.lexically_normal();
  if (!target.has_filename()) target = target.parent_path();  // "map/"
  std::error_code error;
  if (!target.has_filename() || fs::exists(fs::symlink_status(target, error))) {
    return absl::AlreadyExistsError(
        absl::StrCat(path.string(), " is already there"));
  }
  switch (format) {
    case ExportFormat::kColmapBinary:
    case ExportFormat::kColmapText:
      return internal::ExportColmap(
          data, format == ExportFormat::kColmapBinary, target);
    case ExportFormat::kNvm:
      return internal::ExportNvm(data, target, warnings);
    case ExportFormat::kPly:
      return internal::ExportPly(data, target);
    case ExportFormat::kGroundlock:
      return map::WriteMapFile(data, target);
  }
  return absl::InvalidArgumentError("unknown export format");
}

}  // namespace groundlock::formats
