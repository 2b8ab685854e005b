// SPDX-License-Identifier: Apache-2.0
// Local files into the stream of a call that takes them. Internal to the SDK.
#ifndef GROUNDLOCK_CLIENT_SDK_FILE_UPLOAD_H_
#define GROUNDLOCK_CLIENT_SDK_FILE_UPLOAD_H_

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/sdk/client.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {

// A quarter of what the server takes: progress moves visibly.
inline constexpr std::uint64_t kChunkBytes = 256 << 10;

// kNotFound names a file that is missing.
absl::StatusOr<std::uint64_t> TotalBytes(const std::vector<LocalFile>& files);

// Sends the files and closes this side; OK also if the server has stopped
// listening, since its own status says why. Writer: of a stream of Request,
// which has file_start and chunk.
template <typename Request, typename Writer>
absl::Status SendFiles(const std::vector<LocalFile>& files,
                       std::uint64_t total,
                       const Progress& progress,
                       Writer& writer) {
  std::uint64_t done = 0;
  for (const LocalFile& file : files) {
    std::ifstream stream(file.path, std::ios::binary);
    std::error_code error;
    std::uint64_t missing = std::filesystem::file_size(file.path, error);
    if (!stream || error) {
      return absl::NotFoundError(
          absl::StrCat(file.path.string(), ": cannot read"));
    }
    Request message;
    message.mutable_file_start()->set_path(file.remote_path);
    message.mutable_file_start()->set_size_bytes(missing);
    if (!writer.Write(message)) return absl::OkStatus();
    while (missing > 0) {
      std::string chunk(std::min(missing, kChunkBytes), '\0');
      if (!stream.read(chunk.data(),
                       static_cast<std::streamsize>(chunk.size()))) {
        return absl::DataLossError(absl::StrCat(
            file.path.string(), ": became shorter while it was read"));
      }
      missing -= chunk.size();
      done += chunk.size();
      message.set_chunk(std::move(chunk));
      if (!writer.Write(message)) return absl::OkStatus();
      if (progress && !progress(done, total)) {
        return absl::CancelledError("the upload was cancelled");
      }
    }
  }
  writer.WritesDone();
  return absl::OkStatus();
}

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_FILE_UPLOAD_H_
