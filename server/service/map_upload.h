// SPDX-License-Identifier: Apache-2.0
// The files of an import as they arrive: checked, bounded, written to a
// temporary directory.
#ifndef GROUNDLOCK_SERVER_SERVICE_MAP_UPLOAD_H_
#define GROUNDLOCK_SERVER_SERVICE_MAP_UPLOAD_H_

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/options.h"
#include "server/service/scratch_space.h"

namespace groundlock::service {

// Relative, '/'-separated, at most 1024 bytes; parts of 1 to 255 bytes, none of
// them "." or "..", no backslashes or control characters. kInvalidArgument.
absl::Status ValidateRelativePath(std::string_view path,
                                  std::string_view field);

// `message` without `folder`'s name, which is nobody's business.
std::string WithoutFolder(std::string_view message,
                          const std::filesystem::path& folder);

// Not thread-safe. Blocks on the disk. Removes everything when destroyed.
class MapUpload {
 public:
  static constexpr std::size_t kMaxChunkBytes = 1 << 20;

  static absl::StatusOr<std::unique_ptr<MapUpload>> Create(
      const ScratchSpace& scratch, const MapLimits& limits);

  // kInvalidArgument: path, or the previous file is not complete, or there is
  // one of that name. kResourceExhausted: limits, of which that of files holds
  // for folders, too; the disk.
  absl::Status StartFile(const std::string& path, std::uint64_t size_bytes);
  // kInvalidArgument: no file was started, more bytes than announced, a chunk
  // of more than kMaxChunkBytes.
  absl::Status AddChunk(std::string_view chunk);
  // StartFile or AddChunk, as a message after the header says
  // (ImportMapRequest, BuildMapRequest). kInvalidArgument also if it says
  // neither.
  template <typename Message>
  absl::Status Add(const Message& message) {
    if (message.has_file_start()) {
      return StartFile(message.file_start().path(),
                       message.file_start().size_bytes());
    }
    if (message.has_chunk()) return AddChunk(message.chunk());
    return absl::InvalidArgumentError(
        "message: expected file_start or chunk after the header");
  }
  // kInvalidArgument unless all files are complete and there is one, and as
  // many as were announced (0 = not announced).
  absl::Status Finish(std::uint64_t announced_files);

  // Where a path of the client's lies; "." is the root. kInvalidArgument if it
  // was not uploaded (as a file, or a folder of one).
  absl::StatusOr<std::filesystem::path> Resolve(std::string_view path,
                                                std::string_view field) const;
  // WithoutFolder of the directory itself.
  std::string Anonymized(std::string_view message) const;

 private:
  MapUpload(std::unique_ptr<ScratchDirectory> directory,
            const MapLimits& limits);
  absl::Status CloseFile();
  absl::Status CheckDisk(std::uint64_t more_bytes) const;
  absl::Status MakeFolders(std::string_view path);

  const std::unique_ptr<ScratchDirectory> directory_;
  const MapLimits limits_;
  std::ofstream file_;
  std::string file_path_;
  std::uint64_t file_missing_bytes_ = 0;
  std::uint64_t total_bytes_ = 0;
  int num_files_ = 0;
  int num_folders_ = 0;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_MAP_UPLOAD_H_
