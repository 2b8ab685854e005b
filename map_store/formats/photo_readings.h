// SPDX-License-Identifier: Apache-2.0
// What photos say of how they were taken and the edges in them of up, on its
// way to a map: read where the photos lie, and kept in a file beside the
// reconstruction.
#ifndef GROUNDLOCK_MAP_STORE_FORMATS_PHOTO_READINGS_H_
#define GROUNDLOCK_MAP_STORE_FORMATS_PHOTO_READINGS_H_

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/map/measured_up.h"

namespace groundlock::formats {

// Its name beside a model's files. Import looks for it there, and
// FindImportFiles lists it.
inline constexpr char kPhotoReadingsFile[] = "photo_readings.json";

// Of a folder's photos (ListPhotos), those that say something. Positions are
// counted from their middle, so that they tell no place on Earth. kNotFound if
// it is no folder.
absl::StatusOr<std::vector<map::PhotoReading>> ReadPhotoReadings(
    const std::filesystem::path& folder);

// {"photos":[{"image":NAME,"up_camera":[x,y,z],"p_local_m":[east,north,up]}],
// "upright_edges":{"up_model":[x,y,z],"count":N}}: either of the photos' two
// vectors or both; the edges may be missing, and are in the model's
// coordinates.
std::string UpReadingsToJson(const map::UpReadings& readings);
// From such a file. kNotFound, kResourceExhausted: no file of at most 64 MiB,
// where those of a hundred thousand photos have 20; else as ParseUpReadings.
absl::StatusOr<map::UpReadings> ReadUpReadings(
    const std::filesystem::path& file);
// kInvalidArgument with `file` and the place: no such JSON, directions that are
// not of length 1, positions beyond 1,000 km, more than a million photos.
absl::StatusOr<map::UpReadings> ParseUpReadings(std::string_view text,
                                                std::string_view file);

}  // namespace groundlock::formats

#endif  // GROUNDLOCK_MAP_STORE_FORMATS_PHOTO_READINGS_H_
