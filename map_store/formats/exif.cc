// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/exif.h"

#include <libexif/exif-data.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <memory>
#include <numbers>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/text_reader.h"
#include "map_store/formats/internal/xmp.h"

namespace groundlock::formats {
namespace {

namespace fs = std::filesystem;

// EXIF comes first in a file, in segments of 64 KiB.
constexpr std::size_t kHeadBytes = std::size_t{256} << 10;
constexpr std::size_t kMaxName = 64;

// Sizes in EXIF may be rounded to whole blocks of a codec.
constexpr double kSameShape = 0.02;
// In the logarithm. The film's focal length is given in whole millimetres, of
// which phones have a dozen, and by some for the width instead of the diagonal.
constexpr double kFocalsAgree = 0.15;
// Of the larger side: from a fisheye's 150 degrees to a telescope's two.
constexpr double kShortestFocal = 0.13;
constexpr double kLongestFocal = 30.0;

using ExifPointer = std::unique_ptr<ExifData, decltype(&exif_data_unref)>;

ExifPointer ReadExif(std::string_view jpeg) {
  return {exif_data_new_from_data(
              reinterpret_cast<const unsigned char*>(jpeg.data()),
              static_cast<unsigned int>(std::min(jpeg.size(), kHeadBytes))),
          &exif_data_unref};
}

// A field of up to three rationals; nullopt if it is not there or has fewer.
std::optional<std::array<double, 3>> Rationals(ExifData* data,
                                               ExifIfd directory,
                                               int tag,
                                               std::size_t count) {
  const ExifEntry* entry =
      exif_content_get_entry(data->ifd[directory], static_cast<ExifTag>(tag));
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

std::optional<double> PositiveRational(ExifData* data, int tag) {
  const auto values = Rationals(data, EXIF_IFD_EXIF, tag, 1);
  if (!values || !((*values)[0] > 0.0)) return std::nullopt;
  return (*values)[0];
}

// 0 if it is not there.
std::uint32_t Integer(ExifData* data, int tag) {
  const ExifEntry* entry = exif_content_get_entry(data->ifd[EXIF_IFD_EXIF],
                                                  static_cast<ExifTag>(tag));
  if (entry == nullptr || entry->components < 1) return 0;
  const ExifByteOrder order = exif_data_get_byte_order(data);
  if (entry->format == EXIF_FORMAT_SHORT && entry->size >= 2) {
    return exif_get_short(entry->data, order);
  }
  if (entry->format == EXIF_FORMAT_LONG && entry->size >= 4) {
    return exif_get_long(entry->data, order);
  }
  return 0;
}

// Letters, digits and what else is printed; without spaces at the ends.
std::string Text(ExifData* data, ExifIfd directory, ExifTag tag) {
  const ExifEntry* entry = exif_content_get_entry(data->ifd[directory], tag);
  if (entry == nullptr || entry->format != EXIF_FORMAT_ASCII) return "";
  std::string text;
  for (std::size_t i = 0; i < entry->size && text.size() < kMaxName; ++i) {
    const auto c = static_cast<char>(entry->data[i]);
    if (c == 0) break;
    if (absl::ascii_isprint(static_cast<unsigned char>(c))) text.push_back(c);
  }
  return std::string(internal::Trim(text));
}

// From the sensor's pixels per length.
std::optional<double> FocalByPixelPitch_px(ExifData* data,
                                           int width_px,
                                           int height_px) {
  const auto focal_mm = PositiveRational(data, EXIF_TAG_FOCAL_LENGTH);
  const auto per_unit =
      PositiveRational(data, EXIF_TAG_FOCAL_PLANE_X_RESOLUTION);
  const double written_width = Integer(data, EXIF_TAG_PIXEL_X_DIMENSION);
  const double written_height = Integer(data, EXIF_TAG_PIXEL_Y_DIMENSION);
  if (!focal_mm || !per_unit || written_width == 0.0) return std::nullopt;
  // A picture that was made smaller keeps what was written of the large one.
  // One that was cut is of another shape, and of which part nobody says.
  if (std::abs(written_width * height_px - written_height * width_px) >
      kSameShape * written_width * height_px) {
    return std::nullopt;
  }
  double unit_mm = 0.0;
  switch (Integer(data, EXIF_TAG_FOCAL_PLANE_RESOLUTION_UNIT)) {
    case 0:  // what EXIF takes for granted
    case 2:
      unit_mm = 25.4;
      break;
    case 3:
      unit_mm = 10.0;
      break;
    default:
      return std::nullopt;
  }
  return *focal_mm * *per_unit / unit_mm * width_px / written_width;
}

// From the focal length that has the same diagonal angle of view on film of
// 36 mm x 24 mm (CIPA DCG-001).
std::optional<double> FocalByFilm_px(ExifData* data,
                                     int width_px,
                                     int height_px) {
  const std::uint32_t focal_mm =
      Integer(data, EXIF_TAG_FOCAL_LENGTH_IN_35MM_FILM);
  if (focal_mm == 0) return std::nullopt;
  return focal_mm * std::hypot(width_px, height_px) / std::hypot(36.0, 24.0);
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
  const auto dms = Rationals(data, EXIF_IFD_GPS, tag, 3);
  if (!dms) return std::nullopt;
  const double angle = (*dms)[0] + (*dms)[1] / 60.0 + (*dms)[2] / 3'600.0;
  return FirstByte(data, ref_tag) == negative ? -angle : angle;
}

// Pitch and roll of that names; nullopt unless both are there and are angles.
struct PitchAndRoll {
  double pitch_rad = 0.0;
  double roll_rad = 0.0;
};
std::optional<PitchAndRoll> ReadAngles(std::string_view packet,
                                       std::string_view pitch,
                                       std::string_view roll) {
  constexpr double kRadPerDeg = std::numbers::pi / 180.0;
  constexpr double kFullTurn_deg = 360.0;
  const auto pitch_deg = internal::XmpNumber(packet, pitch);
  const auto roll_deg = internal::XmpNumber(packet, roll);
  if (!pitch_deg || !roll_deg || std::abs(*pitch_deg) > kFullTurn_deg ||
      std::abs(*roll_deg) > kFullTurn_deg) {
    return std::nullopt;
  }
  return PitchAndRoll{kRadPerDeg * *pitch_deg, kRadPerDeg * *roll_deg};
}

// Who writes Pix4D's angles as Pix4D defines them.
bool WritesAnglesOfPix4d(std::string_view maker) {
  for (const char* known : {"sensefly", "parrot", "sentera", "autel"}) {
    if (absl::StartsWithIgnoreCase(base::Abseil(maker), known)) return true;
  }
  return false;
}

}  // namespace

std::optional<geometry::GeodeticPosition> GpsFromExif(std::string_view jpeg) {
  const ExifPointer data = ReadExif(jpeg);
  if (data == nullptr) return std::nullopt;
  const auto latitude = Angle_deg(
      data.get(), EXIF_TAG_GPS_LATITUDE, EXIF_TAG_GPS_LATITUDE_REF, 'S');
  const auto longitude = Angle_deg(
      data.get(), EXIF_TAG_GPS_LONGITUDE, EXIF_TAG_GPS_LONGITUDE_REF, 'W');
  if (!latitude || !longitude) return std::nullopt;
  geometry::GeodeticPosition position{*latitude, *longitude, 0.0};
  if (const auto height =
          Rationals(data.get(), EXIF_IFD_GPS, EXIF_TAG_GPS_ALTITUDE, 1)) {
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

PhotoLens LensFromExif(std::string_view jpeg, int width_px, int height_px) {
  const ExifPointer data = ReadExif(jpeg);
  if (data == nullptr) return {};
  PhotoLens lens;
  lens.camera = absl::StrCat(Text(data.get(), EXIF_IFD_0, EXIF_TAG_MAKE),
                             " ",
                             Text(data.get(), EXIF_IFD_0, EXIF_TAG_MODEL));
  if (const auto focal_mm =
          PositiveRational(data.get(), EXIF_TAG_FOCAL_LENGTH)) {
    absl::StrAppend(&lens.camera, " ", *focal_mm, " mm");
  }
  // Tells a digital zoom, too.
  if (const std::uint32_t film_mm =
          Integer(data.get(), EXIF_TAG_FOCAL_LENGTH_IN_35MM_FILM);
      film_mm != 0) {
    absl::StrAppend(&lens.camera, " (", film_mm, " mm)");
  }
  lens.camera = std::string(internal::Trim(lens.camera));
  const auto by_pitch = FocalByPixelPitch_px(data.get(), width_px, height_px);
  lens.focal_px = FocalByFilm_px(data.get(), width_px, height_px);
  // The first is finer, and in some cameras plainly wrong.
  if (by_pitch &&
      (!lens.focal_px ||
       std::abs(std::log(*by_pitch / *lens.focal_px)) < kFocalsAgree)) {
    lens.focal_px = by_pitch;
  }
  const double side_px = std::max(width_px, height_px);
  if (lens.focal_px && !(*lens.focal_px > kShortestFocal * side_px &&
                         *lens.focal_px < kLongestFocal * side_px)) {
    lens.focal_px.reset();
  }
  return lens;
}

std::optional<Eigen::Vector3d> UpFromAttitude(std::string_view jpeg) {
  const std::string_view packet = internal::XmpPacket(jpeg);
  auto angles = ReadAngles(
      packet, "drone-dji:GimbalPitchDegree", "drone-dji:GimbalRollDegree");
  if (!angles) {
    angles = ReadAngles(packet,
                        "drone-parrot:CameraPitchDegree",
                        "drone-parrot:CameraRollDegree");
  }
  if (angles) {
    // The third row of Rz(yaw) Ry(pitch) Rx(roll) is down in the gimbal's axes:
    // forward, right, down.
    const auto& [pitch, roll] = *angles;
    return -Eigen::Vector3d(std::sin(roll) * std::cos(pitch),
                            std::cos(roll) * std::cos(pitch),
                            -std::sin(pitch));
  }
  // The prefix alone says little: others have a name space of their own.
  if (packet.find("http://pix4d.com/camera/1.0") == std::string_view::npos) {
    return std::nullopt;
  }
  const ExifPointer data = ReadExif(jpeg);
  if (data == nullptr) return std::nullopt;
  const std::string maker = Text(data.get(), EXIF_IFD_0, EXIF_TAG_MAKE);
  if (!WritesAnglesOfPix4d(maker)) return std::nullopt;
  angles = ReadAngles(packet, "Camera:Pitch", "Camera:Roll");
  if (!angles) return std::nullopt;
  const double sign =
      absl::StartsWithIgnoreCase(maker, "sensefly") ? -1.0 : 1.0;
  const double pitch = angles->pitch_rad;
  const double roll = sign * angles->roll_rad;
  // Down in the axes top, right, down of a picture that was taken straight
  // down.
  return -Eigen::Vector3d(std::sin(roll) * std::cos(pitch),
                          std::sin(pitch),
                          std::cos(roll) * std::cos(pitch));
}

absl::StatusOr<std::string> ReadExifHead(const fs::path& photo) {
  std::ifstream stream(photo, std::ios::binary);
  if (!stream) {
    return absl::NotFoundError(
        absl::StrCat(photo.string(), ": cannot be opened"));
  }
  std::string head(kHeadBytes, '\0');
  stream.read(head.data(), static_cast<std::streamsize>(head.size()));
  head.resize(
      static_cast<std::size_t>(std::max<std::streamsize>(0, stream.gcount())));
  return head;
}

absl::StatusOr<std::vector<fs::path>> ListPhotos(const fs::path& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    return absl::NotFoundError(
        absl::StrCat(folder.string(), ": no such folder"));
  }
  std::vector<fs::path> photos;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    const std::string extension =
        absl::AsciiStrToLower(entry->path().extension().string());
    if (extension == ".jpg" || extension == ".jpeg") {
      photos.push_back(entry->path());
    }
  }
  std::sort(photos.begin(), photos.end());
  return photos;
}

absl::StatusOr<std::vector<PhotoPosition>> ReadPhotoPositions(
    const fs::path& folder) {
  ASSIGN_OR_RETURN(const std::vector<fs::path> photos, ListPhotos(folder));
  std::vector<PhotoPosition> positions;
  for (const fs::path& photo : photos) {
    const auto head = ReadExifHead(photo);
    if (!head.ok()) continue;
    if (const auto position = GpsFromExif(*head)) {
      positions.push_back({photo.filename().string(), *position});
    }
  }
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
