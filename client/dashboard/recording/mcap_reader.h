// SPDX-License-Identifier: Apache-2.0
// Reads MCAP files as McapWriter makes them, whole or interrupted.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_MCAP_READER_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_MCAP_READER_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::recording {

namespace internal {
struct Summary;
}

struct McapMessage {
  std::string_view topic;
  std::string_view schema;  // its name
  std::uint64_t log_time_ns = 0;
  std::uint64_t publish_time_ns = 0;
  std::string_view data;  // valid during the call
};

// Not thread-safe.
class McapReader {
 public:
  // kNotFound; kDataLoss: this is no MCAP file, or its index is damaged. A file
  // without an index is gone through from its beginning.
  static absl::StatusOr<std::unique_ptr<McapReader>> Open(
      const std::filesystem::path& path);
  virtual ~McapReader() = default;

  // The file has its index: its writer has finished.
  virtual bool complete() const = 0;
  // Up to the end of the last whole chunk and its indexes.
  virtual std::uint64_t data_bytes() const = 0;
  virtual const internal::Summary& summary() const = 0;
  virtual std::uint64_t num_messages(std::string_view topic) const = 0;
  // Of the first and the last message; 0 if there is none.
  virtual std::uint64_t start_time_ns() const = 0;
  virtual std::uint64_t end_time_ns() const = 0;

  // Calls `take` for every message of the topics for which `wanted` returns
  // true, in the order of the file, until it returns false. Chunks without such
  // topics are not read. kDataLoss names the chunk that is damaged.
  virtual absl::Status Read(
      const std::function<bool(std::string_view topic)>& wanted,
      const std::function<bool(const McapMessage&)>& take) = 0;
};

}  // namespace groundlock::recording

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_MCAP_READER_H_
