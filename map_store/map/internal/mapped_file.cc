// SPDX-License-Identifier: Apache-2.0
#include "map_store/map/internal/mapped_file.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::map::internal {

absl::Status Damaged(std::string_view what) {
  return absl::DataLossError(base::Abseil(what));
}

absl::StatusOr<Mapping> MapFile(const std::filesystem::path& path) {
  // O_NONBLOCK: a named pipe must not hold up the caller.
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return absl::ErrnoToStatus(errno, "cannot open");
  struct stat status {};
  if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode)) {
    close(fd);
    return absl::InvalidArgumentError("not a regular file");
  }
  const auto bytes = static_cast<std::size_t>(status.st_size);
  if (bytes < kPageBytes) {
    close(fd);
    return Damaged("not a Groundlock map: " + std::to_string(bytes) +
                   " bytes are too short for a header");
  }
  void* data = mmap(nullptr, bytes, PROT_READ, MAP_SHARED, fd, 0);
  const int error = errno;
  close(fd);  // the mapping stays
  if (data == MAP_FAILED) return absl::ErrnoToStatus(error, "cannot map");
  return Mapping{static_cast<const std::byte*>(data), bytes};
}

absl::StatusOr<FileHeader> ReadHeader(const Mapping& mapping) {
  FileHeader header;
  std::memcpy(&header, mapping.data, sizeof(header));
  if (header.magic != kMagic) {
    return Damaged("not a Groundlock map: wrong signature");
  }
  // Before the checksum: a newer header may be longer.
  if (header.format_version < kOldestFormatVersion ||
      header.format_version > kFormatVersion) {
    return absl::UnimplementedError(
        absl::StrCat("map format version ",
                     header.format_version,
                     ", this program reads versions ",
                     kOldestFormatVersion,
                     " to ",
                     kFormatVersion));
  }
  if (header.content_hash != HashHeader(header)) {
    return Damaged("header damaged: checksum differs");
  }
  const std::uint32_t num_sections = NumSections(header.format_version);
  if (header.num_sections != num_sections) {
    return Damaged("header damaged: number of sections");
  }
  if (header.file_bytes != mapping.bytes) {
    return Damaged("truncated or extended: " + std::to_string(mapping.bytes) +
                   " bytes, the header says " +
                   std::to_string(header.file_bytes));
  }
  for (std::uint32_t i = num_sections; i < kNumSections; ++i) {
    header.sections.at(i) = {};
  }
  for (std::uint32_t i = 0; i < num_sections; ++i) {
    const SectionRecord& section = header.sections.at(i);
    const auto id = static_cast<SectionId>(i + 1);
    if (section.id != id ||
        section.element_bytes !=
            SectionElementBytes(id, header.format_version) ||
        section.offset % kPageBytes != 0 ||
        section.count > mapping.bytes / section.element_bytes ||
        !IsRange(section.offset,
                 section.count * section.element_bytes,
                 mapping.bytes)) {
      return Damaged(std::string("section '") + SectionName(id) +
                     "' lies outside the file");
    }
  }
  return header;
}

}  // namespace groundlock::map::internal
