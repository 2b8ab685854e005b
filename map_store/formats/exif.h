// SPDX-License-Identifier: Apache-2.0
// What a photo's own metadata say about where and through what it was taken.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_EXIF_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_EXIF_H_

#include <Eigen/Core>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/geodesy.h"

namespace groundlock::formats {

// The GPS position in a JPEG's bytes; nullopt if there is none that makes
// sense. Its height is as the camera wrote it (most write that above the sea,
// which differs from WGS84's by up to 100 m, but by the same for all photos of
// a place); 0 if it wrote none.
std::optional<geometry::GeodeticPosition> GpsFromExif(std::string_view jpeg);

struct PhotoLens {
  // Maker, model and focal length as written: photos of one size for which it
  // is the same have one lens. "" if nothing is written.
  std::string camera;
  // In the photo's own pixels, to some per cent; nullopt if it is not written,
  // or makes no sense.
  std::optional<double> focal_px;
};
// From a JPEG's bytes; its size as decoded, without the rotation that EXIF may
// ask for.
PhotoLens LensFromExif(std::string_view jpeg, int width_px, int height_px);

// Where up is in a photo, by the angles that the camera's gimbal, or whatever
// carried it, wrote into the JPEG's XMP packet: a unit vector in the camera's
// frame (x right, y down, z forward, of the picture as it is stored). nullopt
// if there are none whose meaning is documented, or they make no sense. The
// angles, degrees, are those of a frame turned from north, east, down by yaw,
// pitch and roll, in this order, about its z, y and x axes:
//   drone-dji:GimbalPitchDegree, GimbalRollDegree (also written by Hasselblad
//     and newer Autel) and drone-parrot:CameraPitchDegree, CameraRollDegree:
//     x is where the camera looks, y its right; pitch 0 is the horizon, -90
//     straight down. Source: DJI (dji-sdk/Mobile-SDK-Android issue 984).
//   Camera:Pitch, Camera:Roll, of Pix4D's namespace, by senseFly, Parrot,
//     Sentera and older Autel: x is the picture's top, y its right; pitch 0 is
//     straight down, 90 the horizon. senseFly's roll has the other sign.
//     Source: Pix4D, "Yaw, Pitch, Roll and Omega, Phi, Kappa angles";
//     OpenDroneMap's opendm/photo.py (signs), OpenAthena (Autel).
// Yaw does not matter for up.
std::optional<Eigen::Vector3d> UpFromAttitude(std::string_view jpeg);

// The beginning of a file, in which EXIF data are. kNotFound.
absl::StatusOr<std::string> ReadExifHead(const std::filesystem::path& photo);

// The .jpg and .jpeg files right in a folder, by name. kNotFound if it is none.
absl::StatusOr<std::vector<std::filesystem::path>> ListPhotos(
    const std::filesystem::path& folder);

struct PhotoPosition {
  std::string image;  // file name
  geometry::GeodeticPosition position;
};
// Of a folder's photos, as ListPhotos finds them; those without a position are
// left out. kNotFound if it is no folder.
absl::StatusOr<std::vector<PhotoPosition>> ReadPhotoPositions(
    const std::filesystem::path& folder);

// From text: a line "IMAGE,LATITUDE,LONGITUDE,HEIGHT" each, in degrees and
// metres; lines that are empty or start with # are skipped. Errors name `file`
// and the line.
absl::StatusOr<std::vector<PhotoPosition>> ParsePhotoPositions(
    std::string_view text, std::string_view file);

}  // namespace groundlock::formats

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_EXIF_H_
