// SPDX-License-Identifier: Apache-2.0
// Writes MCAP files (https://mcap.dev): messages of several topics by time, in
// compressed chunks with an index, as Foxglove reads them.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_MCAP_WRITER_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_MCAP_WRITER_H_

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::recording {

struct McapWriterOptions {
  // A chunk is written when it has reached this many bytes, uncompressed.
  std::uint64_t chunk_bytes = 1 << 20;
  // Largest file; a message that would not fit any more is refused.
  std::uint64_t max_file_bytes = std::uint64_t{16} << 30;
  absl::Status Validate() const;  // names field, value and bound
};

// Whole chunks are on disk at any time, and readable: a file whose writer was
// killed lacks its last chunk and its index, and Repair gives it one. Not
// thread-safe.
class McapWriter {
 public:
  // kAlreadyExists: there is a file. kFailedPrecondition: it cannot be made.
  static absl::StatusOr<std::unique_ptr<McapWriter>> Create(
      const std::filesystem::path& path, const McapWriterOptions& options);
  virtual ~McapWriter() = default;  // as if killed, unless finished

  // Before the first message of the topic. schema_data: for encoding
  // "protobuf" a serialised FileDescriptorSet. Returns the channel.
  virtual absl::StatusOr<std::uint16_t> AddChannel(
      std::string_view topic,
      std::string_view schema_name,
      std::string_view schema_data) = 0;

  // data: the serialised message. kResourceExhausted: the file's limit is
  // reached (nothing was written, Finish still may) or the disk is full.
  virtual absl::Status Write(std::uint16_t channel,
                             std::uint64_t log_time_ns,
                             std::uint64_t publish_time_ns,
                             std::string_view data) = 0;
  // Writes the chunk begun, so that all messages are on disk.
  virtual absl::Status Flush() = 0;
  // Flushes and writes the index. Once, and last.
  virtual absl::Status Finish() = 0;

  virtual std::uint64_t file_bytes() const = 0;  // on disk
};

// Cuts a file that was interrupted behind its last whole chunk and gives it an
// index. A file that has one is left alone. kNotFound, kDataLoss (no MCAP).
absl::Status RepairMcap(const std::filesystem::path& path);

}  // namespace groundlock::recording

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_MCAP_WRITER_H_
