// SPDX-License-Identifier: Apache-2.0
#include "map_store/terrain/elevation_model.h"

#include <bit>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/cage/child_process.h"

namespace groundlock::terrain {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMaxInfoBytes = std::uint64_t{4} << 20;
constexpr double kNoData = -99'999.0;
// What lies deeper or higher is no ground of the Earth.
constexpr double kLowest_m = -12'000.0;
constexpr double kHighest_m = 9'500.0;

absl::Status RunGdal(std::vector<std::string> arguments,
                     const fs::path& log,
                     const std::function<bool()>& is_cancelled) {
  const std::string program = arguments.front();
  cage::ChildProcessOptions options;
  options.arguments = std::move(arguments);
  options.log = log;
  options.is_cancelled = is_cancelled;
  const absl::Status status = cage::RunChildProcess(options);
  if (absl::IsNotFound(status)) {
    return absl::FailedPreconditionError(
        absl::StrCat("elevation models need GDAL's programs, and there is no ",
                     program,
                     " here: Debian has it in gdal-bin"));
  }
  return status;
}

// Where PROJ's grids are installed.
std::vector<fs::path> GridFolders() {
  std::vector<fs::path> folders;
  for (const char* name : {"PROJ_DATA", "PROJ_LIB"}) {
    const char* value = std::getenv(name);
    if (value == nullptr) continue;
    for (const auto part : absl::StrSplit(value, ':', absl::SkipEmpty())) {
      folders.emplace_back(std::string(part));
    }
  }
  if (const char* home = std::getenv("HOME")) {
    folders.push_back(fs::path(home) / ".local/share/proj");
  }
  folders.emplace_back("/usr/local/share/proj");
  folders.emplace_back("/usr/share/proj");
  return folders;
}

// The grid of a geoid's heights over the ellipsoid; empty for the ellipsoid.
absl::StatusOr<fs::path> GeoidGrid(const VerticalDatum& datum) {
  std::vector<std::string> names;
  switch (datum.kind) {
    case VerticalDatum::Kind::kEllipsoid:
      return fs::path();
    case VerticalDatum::Kind::kGeoidFile:
      return datum.geoid_file;
    case VerticalDatum::Kind::kEgm96:
      names = {"us_nga_egm96_15.tif", "egm96_15.gtx"};
      break;
    case VerticalDatum::Kind::kEgm2008:
      names = {"us_nga_egm08_25.tif", "egm08_25.gtx"};
      break;
  }
  for (const fs::path& folder : GridFolders()) {
    for (const std::string& name : names) {
      std::error_code error;
      if (fs::is_regular_file(folder / name, error)) return folder / name;
    }
  }
  return absl::FailedPreconditionError(
      absl::StrCat("heights over ",
                   NameOf(datum),
                   " need the grid of that geoid, ",
                   names[0],
                   " (or ",
                   names[1],
                   "), in ~/.local/share/proj or /usr/share/proj",
                   datum.kind == VerticalDatum::Kind::kEgm96
                       ? ": Debian has it in proj-data"
                       : ": PROJ's data of that name; Debian has none of it"));
}

// A file's heights over the window as they are, by gdalwarp.
absl::StatusOr<std::vector<float>> Resample(
    const fs::path& file,
    const ElevationModelRequest& request,
    const fs::path& scratch) {
  const GeodeticWindow& w = request.window;
  const auto degrees = [](double value) {
    return absl::StrFormat("%.12f", value);
  };
  const fs::path raw = scratch / "heights.raw";
  const absl::Status status =
      RunGdal({"gdalwarp",
               "-q",
               "-overwrite",
               "-novshift",  // the datum is our own affair
               "-t_srs",
               "EPSG:4326",
               "-te",
               degrees(w.west_deg),
               degrees(w.south_deg),
               degrees(w.east_deg),
               degrees(w.north_deg),
               "-ts",
               absl::StrCat(request.columns),
               absl::StrCat(request.rows),
               "-r",
               "bilinear",
               "-ot",
               "Float32",
               "-dstnodata",
               absl::StrCat(kNoData),
               "-of",
               "ENVI",
               fs::absolute(file).string(),
               raw.string()},
              scratch / "log",
              request.is_cancelled);
  if (!status.ok()) return base::Annotate(status, file.string());
  const std::size_t count = request.columns * request.rows;
  ASSIGN_OR_RETURN(const std::string bytes,
                   base::ReadFile(raw, count * sizeof(float)));
  if (bytes.size() != count * sizeof(float)) {
    return absl::InternalError(file.string() + ": gdalwarp wrote too little");
  }
  // Of this machine's byte order, as gdalwarp writes it.
  std::vector<float> heights_m(count);
  std::memcpy(heights_m.data(), bytes.data(), bytes.size());
  for (float& height_m : heights_m) {
    if (!(height_m >= kLowest_m && height_m <= kHighest_m)) {
      height_m = std::numeric_limits<float>::quiet_NaN();
    }
  }
  return heights_m;
}

// The datum to go by: what the user says, checked against what the file says.
absl::StatusOr<VerticalDatum> ChooseDatum(const ElevationModelRequest& request,
                                          const ElevationModelInfo& info) {
  using Kind = VerticalDatum::Kind;
  const std::string says =
      info.datum ? NameOf(*info.datum) : info.foreign_datum;
  if (!request.datum) {
    if (info.datum) return *info.datum;
    return absl::FailedPreconditionError(absl::StrCat(
        base::Abseil(request.file.string()),
        says.empty()
            ? " does not say what its heights are counted from"
            : " counts heights from " + says + ", whose grid is not known here",
        ": give the vertical datum, which is ellipsoid (as GPS counts), egm96 "
        "(SRTM, DTED), egm2008 (Copernicus) or the file of a geoid's heights "
        "over the ellipsoid"));
  }
  // A geoid's grid may be of anything.
  if (request.datum->kind != Kind::kGeoidFile && !says.empty() &&
      says != NameOf(*request.datum)) {
    return absl::InvalidArgumentError(
        absl::StrCat(base::Abseil(request.file.string()),
                     " says that its heights are counted from ",
                     says,
                     ", not from ",
                     NameOf(*request.datum)));
  }
  return *request.datum;
}

absl::StatusOr<base::TemporaryDirectory> Scratch() {
  std::error_code error;
  const fs::path parent = fs::temp_directory_path(error);
  if (error) return absl::InternalError("there is no folder for scratch files");
  return base::TemporaryDirectory::Create(parent);
}

bool HasKnown(const std::vector<float>& heights_m) {
  for (const float height_m : heights_m) {
    if (!std::isnan(height_m)) return true;
  }
  return false;
}

}  // namespace

absl::StatusOr<VerticalDatum> ParseVerticalDatum(std::string_view text) {
  using Kind = VerticalDatum::Kind;
  if (text == "ellipsoid") return VerticalDatum{Kind::kEllipsoid, {}};
  if (text == "egm96") return VerticalDatum{Kind::kEgm96, {}};
  if (text == "egm2008") return VerticalDatum{Kind::kEgm2008, {}};
  std::error_code error;
  if (fs::is_regular_file(text, error)) {
    return VerticalDatum{Kind::kGeoidFile, fs::path(text)};
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "vertical datum \"",
      base::Abseil(text),
      "\" is none of ellipsoid, egm96, egm2008, and no file of a geoid"));
}

std::string NameOf(const VerticalDatum& datum) {
  switch (datum.kind) {
    case VerticalDatum::Kind::kEllipsoid:
      return "ellipsoid";
    case VerticalDatum::Kind::kEgm96:
      return "egm96";
    case VerticalDatum::Kind::kEgm2008:
      return "egm2008";
    case VerticalDatum::Kind::kGeoidFile:
      break;
  }
  return datum.geoid_file.string();
}

absl::StatusOr<ElevationModelInfo> ReadElevationModelInfo(
    const fs::path& file) {
  std::error_code error;
  if (!fs::is_regular_file(file, error)) {
    return absl::NotFoundError(file.string() + ": no such file");
  }
  ASSIGN_OR_RETURN(const base::TemporaryDirectory scratch, Scratch());
  const fs::path log = scratch.path() / "info";
  const absl::Status status = RunGdal(
      {"gdalinfo", "-json", "-nomd", fs::absolute(file).string()}, log, {});
  if (absl::IsInternal(status)) {
    return absl::InvalidArgumentError(
        absl::StrCat(base::Abseil(file.string()),
                     ": no elevation model that GDAL reads: ",
                     status.message()));
  }
  RETURN_IF_ERROR(status);
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(log, kMaxInfoBytes));
  auto info = ParseElevationModelInfo(text);
  if (!info.ok()) return base::Annotate(info.status(), file.string());
  return info;
}

absl::StatusOr<ElevationGrid> ReadElevationModel(
    const ElevationModelRequest& request) {
  static_assert(std::endian::native == std::endian::little);
  if (request.columns < 2 || request.columns > kMaxSide || request.rows < 2 ||
      request.rows > kMaxSide) {
    return absl::InvalidArgumentError(absl::StrCat("an elevation grid of ",
                                                   request.columns,
                                                   " x ",
                                                   request.rows,
                                                   " is out of range"));
  }
  ASSIGN_OR_RETURN(const ElevationModelInfo info,
                   ReadElevationModelInfo(request.file));
  ASSIGN_OR_RETURN(const VerticalDatum datum, ChooseDatum(request, info));
  ASSIGN_OR_RETURN(const fs::path geoid, GeoidGrid(datum));
  ASSIGN_OR_RETURN(const base::TemporaryDirectory scratch, Scratch());
  ElevationGrid grid;
  grid.window = request.window;
  grid.columns = request.columns;
  ASSIGN_OR_RETURN(grid.heights_m,
                   Resample(request.file, request, scratch.path()));
  if (!HasKnown(grid.heights_m)) {
    return absl::OutOfRangeError(absl::StrFormat(
        "%s knows nothing of %.5f to %.5f north, %.5f to %.5f east: it reaches "
        "from %.5f to %.5f, %.5f to %.5f",
        request.file.string(),
        request.window.south_deg,
        request.window.north_deg,
        request.window.west_deg,
        request.window.east_deg,
        info.window.south_deg,
        info.window.north_deg,
        info.window.west_deg,
        info.window.east_deg));
  }
  if (geoid.empty()) return grid;
  ASSIGN_OR_RETURN(const std::vector<float> geoid_m,
                   Resample(geoid, request, scratch.path()));
  for (std::size_t i = 0; i < grid.heights_m.size(); ++i) {
    grid.heights_m[i] += geoid_m[i];
  }
  if (!HasKnown(grid.heights_m)) {
    return absl::OutOfRangeError(geoid.string() +
                                 ": this geoid's grid does not reach there");
  }
  return grid;
}

}  // namespace groundlock::terrain
