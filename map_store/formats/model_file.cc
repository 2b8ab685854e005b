// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/model_file.h"

#include <unistd.h>

#include <algorithm>
#include <cstring>

#include "absl/strings/str_format.h"
#include "map_store/base/status.h"

namespace groundlock::formats::internal {
namespace {

// Address space alone; what counts is what is parsed.
constexpr std::uint64_t kMaxModelFileBytes = std::uint64_t{1} << 40;

// What a file's bytes take, and what each of its records takes beside them:
// so that the import of large_import_benchmark, which takes 1.7 GB until its
// map is written, is told as 2.3 GB, and files of nothing but the shortest
// records take less than they are told to (model_file_test).
constexpr std::uint64_t kPerModelByte = 4;
constexpr std::uint64_t kPerImage = 1'024;
constexpr std::uint64_t kPerPoint = 384;
constexpr std::uint64_t kPerLine = 768;
constexpr std::uint64_t kPerJsonByte = 24;
// An observation is told in some 18 characters, and has 128 bytes of
// descriptor.
constexpr std::uint64_t kPerFeatureByte = 12;
// The shortest records of COLMAP's files; a camera is shorter than a point.
constexpr std::uint64_t kImageBytes = 73;
constexpr std::uint64_t kPointBytes = 48;

std::uint64_t CountBinary(std::string_view bytes,
                          std::uint64_t shortest_record_bytes) {
  std::uint64_t count = 0;
  if (bytes.size() < sizeof(count)) return 0;
  std::memcpy(&count, bytes.data(), sizeof(count));
  // More than there is room for is damage, which the parser tells.
  return std::min<std::uint64_t>(count, bytes.size() / shortest_record_bytes);
}

std::uint64_t CountLines(std::string_view text) {
  return 1 +
         static_cast<std::uint64_t>(std::count(text.begin(), text.end(), '\n'));
}

double GiB(std::uint64_t bytes) {
  return static_cast<double>(bytes) / static_cast<double>(1ULL << 30);
}

}  // namespace

std::uint64_t MemoryToImport(std::string_view bytes, ModelFileKind kind) {
  switch (kind) {
    case ModelFileKind::kColmapImages:
      return kPerModelByte * bytes.size() +
             kPerImage * CountBinary(bytes, kImageBytes);
    case ModelFileKind::kColmapPoints:
    case ModelFileKind::kColmapCameras:
      return kPerModelByte * bytes.size() +
             kPerPoint * CountBinary(bytes, kPointBytes);
    case ModelFileKind::kText:
      return kPerModelByte * bytes.size() + kPerLine * CountLines(bytes);
    case ModelFileKind::kTextOfFeatures:
      return kPerFeatureByte * bytes.size() + kPerLine * CountLines(bytes);
    case ModelFileKind::kJson:
      return kPerJsonByte * bytes.size();
  }
  return bytes.size();
}

MemoryBudget::MemoryBudget(std::uint64_t bytes) : bytes_(bytes) {
  if (bytes_ == 0) {
    bytes_ = static_cast<std::uint64_t>(sysconf(_SC_PHYS_PAGES)) *
             static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE)) / 2;
  }
}

absl::StatusOr<base::MappedFile> MemoryBudget::Open(
    const std::filesystem::path& path, ModelFileKind kind) {
  ASSIGN_OR_RETURN(base::MappedFile file,
                   base::MappedFile::Open(path, kMaxModelFileBytes));
  // Lines of what is too large by its bytes alone need not be counted.
  const std::uint64_t needed = file.bytes().size() > bytes_
                                   ? file.bytes().size()
                                   : MemoryToImport(file.bytes(), kind);
  RETURN_IF_ERROR(Take(path, needed));
  return file;
}

absl::Status MemoryBudget::Take(const std::filesystem::path& path,
                                std::uint64_t bytes) {
  if (bytes > bytes_ - taken_bytes_) {
    return absl::ResourceExhaustedError(absl::StrFormat(
        "%s: with it the import takes up to %.2f GiB of memory, more than the "
        "%.2f GiB that it may",
        path.string(),
        GiB(taken_bytes_ + bytes),
        GiB(bytes_)));
  }
  taken_bytes_ += bytes;
  return absl::OkStatus();
}

}  // namespace groundlock::formats::internal
