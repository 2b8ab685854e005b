// SPDX-License-Identifier: Apache-2.0
// Arbitrary bytes as a map file: Open and Verify never crash, and what Verify
// accepts can be walked from end to end.
#include <sys/mman.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "map_store/base/file.h"
#include "map_store/map/internal/file_layout.h"
#include "map_store/map/map.h"

namespace {

using groundlock::map::Map;
using groundlock::map::internal::FileHeader;
using groundlock::map::internal::HashBytes;
using groundlock::map::internal::HashHeader;

// Most inputs would end at the first checksum: those with bit 0 set get theirs
// repaired, so that the checks behind it are reached.
void RepairChecksums(std::string& bytes) {
  if (bytes.size() < sizeof(FileHeader)) return;
  FileHeader header;
  std::memcpy(&header, bytes.data(), sizeof(header));
  header.magic = groundlock::map::internal::kMagic;
  header.format_version = groundlock::map::internal::kFormatVersion;
  header.num_sections = groundlock::map::internal::kNumSections;
  header.file_bytes = bytes.size();
  for (auto& section : header.sections) {
    if (section.element_bytes == 0 || section.offset > bytes.size() ||
        section.count >
            (bytes.size() - section.offset) / section.element_bytes) {
      continue;
    }
    section.checksum = HashBytes(bytes.data() + section.offset,
                                 section.count * section.element_bytes);
  }
  header.content_hash = HashHeader(header);
  std::memcpy(bytes.data(), &header, sizeof(header));
}

// A small valid map, as a file's bytes.
std::string ValidMap() {
  groundlock::map::MapData data;
  data.cameras.emplace_back();
  data.landmarks.resize(3);
  for (int v = 0; v < 2; ++v) {
    auto& view = data.views.emplace_back();
    view.name = "view";
    for (std::uint32_t i = 0; i < 3; ++i) {
      view.keypoints_px.emplace_back(0.5F, 0.5F);
      view.landmarks.push_back(i);
      view.descriptors.emplace_back().fill(static_cast<std::uint8_t>(i));
    }
  }
  const std::string path =
      "/tmp/map_file_fuzzer." + std::to_string(getpid()) + ".glmap";
  const bool written = WriteMapFile(data, path).ok();
  const auto bytes = groundlock::base::ReadFile(path, 1U << 24U);
  unlink(path.c_str());
  if (!written || !bytes.ok()) std::abort();
  return *bytes;
}

// Changes the first bytes of pages (header and sections) of a valid map: each
// six bytes of the input are a page, an offset below 1024 and what goes there.
std::string Patched(const std::uint8_t* data, std::size_t size) {
  static const std::string valid = ValidMap();
  std::string bytes = valid;
  for (; size >= 6; data += 6, size -= 6) {
    const std::size_t page = data[0] % (bytes.size() / 4096);
    const std::size_t offset = data[1] * 4U;
    const std::size_t at = page * 4096 + offset;
    if (at + 4 <= bytes.size()) std::memcpy(bytes.data() + at, data + 2, 4);
  }
  return bytes;
}

void Walk(const Map& map) {
  for (const auto& landmark : map.landmarks()) {
    for (const std::uint64_t i : map.ObservationsOf(landmark)) {
      if (map.features()[i].view >= map.num_views()) std::abort();
    }
  }
  const auto data = map.ToData();
  if (const absl::Status valid = data.Validate(); !valid.ok()) {
    std::fprintf(stderr, "Verify let pass: %s\n", valid.ToString().c_str());
    std::abort();
  }
  ComputeReprojection(data);
  const auto& relief = map.ground_relief();
  if (relief.empty()) return;
  for (const double place : {-1e9, -1.0, 0.0, 0.3, 2.0, 1e9}) {
    relief.At(relief.origin_plane + relief.step * Eigen::Vector2d(place, 2.0));
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  if (size == 0) return 0;
  std::string bytes =
      (data[0] & 2U) != 0
          ? Patched(data + 1, size - 1)
          : std::string(reinterpret_cast<const char*>(data) + 1, size - 1);
  if ((data[0] & 1U) != 0) RepairChecksums(bytes);
  const int fd = memfd_create("map", MFD_CLOEXEC);
  if (fd < 0) return 0;
  const bool written = write(fd, bytes.data(), bytes.size()) ==
                       static_cast<ssize_t>(bytes.size());
  if (written) {
    const auto map = Map::Open("/proc/self/fd/" + std::to_string(fd));
    if (map.ok()) {
      // Safe before Verify: everything that stays within one view or landmark.
      for (std::size_t i = 0; i < (*map)->num_views(); ++i) {
        (*map)->FeaturesOf((*map)->view(i));
        (*map)->DescriptorsOf((*map)->view(i));
      }
      if ((*map)->Verify().ok()) Walk(**map);
    }
  }
  close(fd);
  return 0;
}
