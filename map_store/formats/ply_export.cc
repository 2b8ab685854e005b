// SPDX-License-Identifier: Apache-2.0
// PLY, binary little endian: the landmarks with their colours, for viewers.
#include <cstring>

#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/binary_reader.h"
#include "map_store/formats/internal/importers.h"

namespace groundlock::formats::internal {

absl::Status ExportPly(const map::MapData& data,
                       const std::filesystem::path& path) {
  // Double: a georeferenced world can be kilometres wide.
  std::string out = absl::StrCat(
      "ply\nformat binary_little_endian 1.0\ncomment Groundlock map\n"
      "element vertex ",
      data.landmarks.size(),
      "\nproperty double x\nproperty double y\nproperty double z\n"
      "property uchar red\nproperty uchar green\nproperty uchar blue\n"
      "end_header\n");
  for (const map::MapLandmarkData& landmark : data.landmarks) {
    char record[3 * sizeof(double) + 3];
    std::memcpy(record, landmark.p_world.data(), 3 * sizeof(double));
    std::memcpy(record + 3 * sizeof(double), landmark.rgb.data(), 3);
    out.append(record, sizeof(record));
  }
  return base::WriteFileAtomically(path, out);
}

}  // namespace groundlock::formats::internal
