// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/formats.h"

#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"
#include "map_store/formats/internal/source.h"

namespace groundlock::formats {

namespace fs = std::filesystem;
using base::Abseil;

absl::StatusOr<Format> FormatFromName(std::string_view name) {
  for (const Format format : {Format::kAuto, Format::kColmap, Format::kNvm}) {
    if (name == FormatName(format)) return format;
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "unknown format \"", Abseil(name), "\"; known are auto, colmap, nvm"));
}

std::string_view FormatName(Format format) {
  switch (format) {
    case Format::kAuto:
      return "auto";
    case Format::kColmap:
      return "colmap";
    case Format::kNvm:
      return "nvm";
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
  absl::StatusOr<map::MapData> data;
  if (source.format == Format::kColmap) {
    data = internal::ImportColmap(
        source.colmap, !options.database.empty(), warnings);
  } else {
    data = internal::ImportNvm(source.nvm, options.images, warnings);
  }
  RETURN_IF_ERROR(data.status());
  // What the importers let through must be a map; this is their safety net.
  RETURN_IF_ERROR(base::Annotate(data->Validate(), path.string()));
  return data;
}

absl::StatusOr<ExportFormat> ExportFormatFromName(std::string_view name) {
  if (name == "colmap") return ExportFormat::kColmapBinary;
  if (name == "colmap-text") return ExportFormat::kColmapText;
  if (name == "nvm") return ExportFormat::kNvm;
  if (name == "ply") return ExportFormat::kPly;
  return absl::InvalidArgumentError(
      absl::StrCat("unknown export format \"",
                   Abseil(name),
                   "\"; known are colmap, colmap-text, nvm, ply"));
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
  }
  return absl::InvalidArgumentError("unknown export format");
}

}  // namespace groundlock::formats
