// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/exif.h"

#include <libexif/exif-data.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <memory>

#include "map_store/base/status.h"
#include "map_store/formats/internal/text_reader.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;

// EXIF comes first in a file, in segments of 64 KiB.
constexpr std::size_t kHeadBytes = std::size_t{256} << 10;

// A field of up to three rationals; nullopt if it is not there or has fewer.
std::optional<std::array<double, 3>> Rationals(ExifData* data,
                                               int tag,
                                               std::size_t count) {
  const ExifEntry* entry = exif_content_get_entry(data->ifd[EXIF_IFD_GPS],
                                                  static_cast<ExifTag>(tag));
  if (entry == nullptr || entry->format != EXIF_FORMAT_RATIONAL ||
      entry->components < count || entry->size < 8 * count) {
    return std::nullopt;
  }
  std::array<double, 3> values{};
  for (std::size_t i = 0; i < count; ++i) {
    const ExifRational rational =
        exif_get_rational(entry->data + 8 * i, exif_data_get_byte_order(data));
    if (rational.denominator == 0) return std::nullopt;
    values.at(i) = static_cast<double>(rational.numerator) /
                   static_cast<double>(rational.denominator);
  }
  return values;
}

char FirstByte(ExifData* data, int tag) {
  const ExifEntry* entry = exif_content_get_entry(data->ifd[EXIF_IFD_GPS],
                                                  static_cast<ExifTag>(tag));
  if (entry == nullptr || entry->size < 1) return 0;
  return static_cast<char>(entry->data[0]);
}

std::optional<double> Angle_deg(ExifData* data,
                                int tag,
                                int ref_tag,
                                char negative) {
  const auto dms = Rationals(data, tag, 3);
  if (!dms) return std::nullopt;
  const double angle = (*dms)[0] + (*dms)[1] / 60.0 + (*dms)[2] / 3'600.0;
  return FirstByte(data, ref_tag) == negative ? -angle : angle;
}

}  // namespace

std::optional<geometry::GeodeticPosition> GpsFromExif(std::string_view jpeg) {
  const std::unique_ptr<ExifData, decltype(&exif_data_unref)> data(
      exif_data_new_from_data(
          reinterpret_cast<const unsigned char*>(jpeg.data()),
          static_cast<unsigned int>(std::min(jpeg.size(), kHeadBytes))),
      &exif_data_unref);
  if (data == nullptr) return std::nullopt;
  const auto latitude = Angle_deg(
      data.get(), EXIF_TAG_GPS_LATITUDE, EXIF_TAG_GPS_LATITUDE_REF, 'S');
  const auto longitude = Angle_deg(
      data.get(), EXIF_TAG_GPS_LONGITUDE, EXIF_TAG_GPS_LONGITUDE_REF, 'W');
  if (!latitude || !longitude) return std::nullopt;
  geometry::GeodeticPosition position{*latitude, *longitude, 0.0};
  if (const auto height = Rationals(data.get(), EXIF_TAG_GPS_ALTITUDE, 1)) {
    position.height_m = (*height)[0];
    if (FirstByte(data.get(), EXIF_TAG_GPS_ALTITUDE_REF) == 1) {
      position.height_m = -position.height_m;
    }
  }
  // Cameras without a fix write zeros.
  if (!position.Validate().ok() || (*latitude == 0.0 && *longitude == 0.0)) {
    return std::nullopt;
  }
  return position;
}

absl::StatusOr<std::vector<PhotoPosition>> ReadPhotoPositions(
    const fs::path& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    return absl::NotFoundError(
        absl::StrCat(folder.string(), ": no such folder"));
  }
  std::vector<PhotoPosition> positions;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    std::string extension = entry->path().extension().string();
    std::transform(extension.begin(),
                   extension.end(),
                   extension.begin(),
                   [](unsigned char c) { return std::tolower(c); });
    if (extension != ".jpg" && extension != ".jpeg") continue;
    std::ifstream stream(entry->path(), std::ios::binary);
    std::string head(kHeadBytes, '\0');
    stream.read(head.data(), static_cast<std::streamsize>(head.size()));
    head.resize(static_cast<std::size_t>(
        std::max<std::streamsize>(0, stream.gcount())));
    if (const auto position = GpsFromExif(head)) {
      positions.push_back({entry->path().filename().string(), *position});
    }
  }
  std::sort(positions.begin(),
            positions.end(),
            [](const PhotoPosition& a, const PhotoPosition& b) {
              return a.image < b.image;
            });
  return positions;
}

absl::StatusOr<std::vector<PhotoPosition>> ParsePhotoPositions(
    std::string_view text, std::string_view file) {
  internal::TextReader reader(text, file);
  std::vector<PhotoPosition> positions;
  std::string_view line;
  while (reader.NextRecord(&line)) {
    line = internal::Trim(line);
    std::array<double, 3> numbers{};
    // From the end: names may hold commas.
    for (std::size_t i = numbers.size(); i-- > 0;) {
      const std::size_t comma = line.rfind(',');
      if (comma == std::string_view::npos ||
          !internal::Words(line.substr(comma + 1)).Next(&numbers.at(i))) {
        return reader.Error("expected IMAGE,LATITUDE,LONGITUDE,HEIGHT");
      }
      line = line.substr(0, comma);
    }
    const geometry::GeodeticPosition position{
        numbers[0], numbers[1], numbers[2]};
    if (const absl::Status valid = position.Validate(); !valid.ok()) {
      return reader.Error(base::Std(valid.message()));
    }
    positions.push_back({std::string(internal::Trim(line)), position});
  }
  return positions;
}

}  // namespace groundlock::formats
