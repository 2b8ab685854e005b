// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/recording/mcap_writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/dashboard/recording/internal/mcap_records.h"
#include "client/dashboard/recording/mcap_reader.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::recording {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kLibrary = "groundlock";
// Kept free below the limit for the index: what it takes per chunk at most.
constexpr std::uint64_t kIndexBytesPerChunk = 256;
constexpr std::uint64_t kIndexBytes = 1 << 20;

absl::Status FileError(const fs::path& path, const char* what, int error) {
  const std::string message =
      absl::StrCat(path.string(), ": ", what, ": ", std::strerror(error));
  if (error == ENOSPC || error == EDQUOT || error == EFBIG) {
    return absl::ResourceExhaustedError(message);
  }
  if (error == EEXIST) return absl::AlreadyExistsError(message);
  return absl::FailedPreconditionError(message);
}

// An open file that is written from its end.
class OutputFile {
 public:
  OutputFile(fs::path path, int fd, std::uint64_t size)
      : path_(std::move(path)), fd_(fd), size_(size) {}
  ~OutputFile() { close(fd_); }
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;

  absl::Status Append(std::string_view bytes) {
    const std::uint64_t begin = size_;
    while (!bytes.empty()) {
      const ssize_t written =
          pwrite(fd_, bytes.data(), bytes.size(), static_cast<off_t>(size_));
      if (written < 0 && errno == EINTR) continue;
      if (written <= 0) {
        const int error = written < 0 ? errno : ENOSPC;
        // Half a record would hide what is written behind it.
        if (ftruncate(fd_, static_cast<off_t>(begin)) == 0) size_ = begin;
        return FileError(path_, "cannot write", error);
      }
      bytes.remove_prefix(static_cast<std::size_t>(written));
      size_ += static_cast<std::uint64_t>(written);
    }
    return absl::OkStatus();
  }
  absl::Status Sync() {
    if (fsync(fd_) != 0) return FileError(path_, "cannot sync", errno);
    return absl::OkStatus();
  }
  std::uint64_t size() const { return size_; }

 private:
  const fs::path path_;
  const int fd_;
  std::uint64_t size_;
};

class Writer final : public McapWriter {
 public:
  Writer(fs::path path, int fd, const McapWriterOptions& options)
      : options_(options), file_(std::move(path), fd, 0) {}

  absl::Status Begin() {
    std::string bytes(internal::kMagic);
    internal::AppendHeader(kLibrary, &bytes);
    return file_.Append(bytes);
  }

  absl::StatusOr<std::uint16_t> AddChannel(
      std::string_view topic,
      std::string_view schema_name,
      std::string_view schema_data) override {
    RETURN_IF_ERROR(Flush());
    if (summary_.channels.size() >= std::numeric_limits<std::uint16_t>::max()) {
      return absl::ResourceExhaustedError("too many channels");
    }
    std::string bytes;
    auto schema = std::find_if(
        summary_.schemas.begin(), summary_.schemas.end(), [&](const auto& s) {
          return s.name == schema_name;
        });
    if (schema == summary_.schemas.end()) {
      const auto id = static_cast<std::uint16_t>(summary_.schemas.size() + 1);
      summary_.schemas.push_back(
          {id, std::string(schema_name), "protobuf", std::string(schema_data)});
      schema = summary_.schemas.end() - 1;
      internal::Append(*schema, &bytes);
    }
    const auto id = static_cast<std::uint16_t>(summary_.channels.size());
    summary_.channels.push_back(
        {id, schema->id, std::string(topic), "protobuf"});
    internal::Append(summary_.channels.back(), &bytes);
    RETURN_IF_ERROR(file_.Append(bytes));
    return id;
  }

  absl::Status Write(std::uint16_t channel,
                     std::uint64_t log_time_ns,
                     std::uint64_t publish_time_ns,
                     std::string_view data) override {
    if (channel >= summary_.channels.size()) {
      return absl::InvalidArgumentError(
          absl::StrCat("channel ", channel, " was not added"));
    }
    const std::uint64_t index_bytes =
        kIndexBytes + kIndexBytesPerChunk * summary_.chunks.size();
    if (file_.size() + chunk_.size() + data.size() + index_bytes >
        options_.max_file_bytes) {
      return absl::ResourceExhaustedError(
          absl::StrCat("the recording has reached its limit of ",
                       options_.max_file_bytes >> 20,
                       " MiB"));
    }
    // Within the file times do not go backwards, whatever the clock does.
    log_time_ns = std::max(log_time_ns, last_time_ns_);
    last_time_ns_ = log_time_ns;
    if (chunk_.empty()) chunk_start_ns_ = log_time_ns;
    index_[channel].emplace_back(log_time_ns, chunk_.size());
    internal::Append(
        internal::Message{
            channel, sequence_[channel]++, log_time_ns, publish_time_ns, data},
        &chunk_);
    return chunk_.size() >= options_.chunk_bytes ? Flush() : absl::OkStatus();
  }

  absl::Status Flush() override {
    if (chunk_.empty()) return absl::OkStatus();
    ASSIGN_OR_RETURN(const std::string compressed, internal::Compress(chunk_));
    internal::ChunkIndex entry;
    entry.start_time_ns = chunk_start_ns_;
    entry.end_time_ns = last_time_ns_;
    entry.chunk_offset = file_.size();
    entry.compression = "zstd";
    entry.compressed_bytes = compressed.size();
    entry.uncompressed_bytes = chunk_.size();
    std::string bytes;
    internal::Append(internal::Chunk{entry.start_time_ns,
                                     entry.end_time_ns,
                                     entry.uncompressed_bytes,
                                     internal::Crc32(chunk_),
                                     entry.compression,
                                     compressed},
                     &bytes);
    entry.chunk_bytes = bytes.size();
    for (const auto& [channel, messages] : index_) {
      entry.message_index_offsets[channel] = entry.chunk_offset + bytes.size();
      internal::Append(channel, messages, &bytes);
    }
    entry.message_index_bytes = bytes.size() - entry.chunk_bytes;
    RETURN_IF_ERROR(file_.Append(bytes));
    for (const auto& [channel, messages] : index_) {
      summary_.messages_per_channel[channel] += messages.size();
    }
    if (summary_.chunks.empty()) summary_.start_time_ns = entry.start_time_ns;
    summary_.end_time_ns = entry.end_time_ns;
    summary_.chunks.push_back(std::move(entry));
    chunk_.clear();
    index_.clear();
    return absl::OkStatus();
  }

  absl::Status Finish() override {
    RETURN_IF_ERROR(Flush());
    std::string bytes;
    internal::AppendDataEnd(&bytes);
    internal::AppendSummary(summary_, file_.size() + bytes.size(), &bytes);
    RETURN_IF_ERROR(file_.Append(bytes));
    return file_.Sync();
  }

  std::uint64_t file_bytes() const override { return file_.size(); }

 private:
  const McapWriterOptions options_;
  OutputFile file_;
  internal::Summary summary_;
  std::string chunk_;  // uncompressed records of the chunk begun
  std::uint64_t chunk_start_ns_ = 0;
  std::uint64_t last_time_ns_ = 0;
  std::map<std::uint16_t, internal::MessageIndex> index_;  // of chunk_
  std::map<std::uint16_t, std::uint32_t> sequence_;
};

}  // namespace

absl::Status McapWriterOptions::Validate() const {
  if (chunk_bytes < 1 || chunk_bytes > (1 << 28)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "chunk_bytes: ", chunk_bytes, " is not between 1 and 2^28"));
  }
  if (max_file_bytes <= kIndexBytes) {
    return absl::InvalidArgumentError(absl::StrCat(
        "max_file_bytes: ", max_file_bytes, " is not above ", kIndexBytes));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<McapWriter>> McapWriter::Create(
    const fs::path& path, const McapWriterOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  const int fd =
      open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) return FileError(path, "cannot create", errno);
  auto writer = std::make_unique<Writer>(path, fd, options);
  RETURN_IF_ERROR(writer->Begin());
  return writer;
}

absl::Status RepairMcap(const fs::path& path) {
  ASSIGN_OR_RETURN(const auto reader, McapReader::Open(path));
  if (reader->complete()) return absl::OkStatus();
  const int fd = open(path.c_str(), O_RDWR | O_CLOEXEC);
  if (fd < 0) return FileError(path, "cannot open", errno);
  OutputFile file(path, fd, reader->data_bytes());
  if (ftruncate(fd, static_cast<off_t>(reader->data_bytes())) != 0) {
    return FileError(path, "cannot be cut", errno);
  }
  std::string bytes;
  internal::AppendDataEnd(&bytes);
  internal::AppendSummary(
      reader->summary(), file.size() + bytes.size(), &bytes);
  RETURN_IF_ERROR(file.Append(bytes));
  return file.Sync();
}

}  // namespace groundlock::recording
