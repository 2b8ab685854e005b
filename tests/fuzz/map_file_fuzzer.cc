// SPDX-License-Identifier: Apache-2.0
// Arbitrary bytes as a map file: Open and Verify never crash, and what Verify
// accepts can be walked from end to end.
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <string>

#include "map_store/map/internal/file_layout.h"
#include "map_store/map/map.h"

namespace {

using groundlock::map::Map;
using groundlock::map::internal::FileHeader;
using groundlock::map::internal::HashBytes;
using groundlock::map::internal::HashHeader;

// Most inputs would end at the first checksum: odd ones get theirs repaired,
// so that the checks behind it are reached.
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

void Walk(const Map& map) {
  for (const auto& landmark : map.landmarks()) {
    for (const std::uint64_t i : map.ObservationsOf(landmark)) {
      if (map.features()[i].view >= map.num_views()) std::abort();
    }
  }
  const auto data = map.ToData();
  if (!data.Validate().ok()) std::abort();
  ComputeReprojection(data);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  if (size == 0) return 0;
  std::string bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
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
