// SPDX-License-Identifier: Apache-2.0
// What a work folder already holds, so that a build that was interrupted goes
// on where it was.
#ifndef GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_STAGE_LOG_H_
#define GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_STAGE_LOG_H_

#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::build::internal {

// 32 hex digits over the parts, each with its length: ("ab", "c") is not
// ("a", "bc").
std::string HashOf(std::span<const std::string> parts);
// Over names (without folders) and contents.
absl::StatusOr<std::string> HashOfFiles(
    std::span<const std::filesystem::path> files);

// Stages and the keys under which they were finished; a key says everything
// that the stage's result depends on. Locks the folder: one build at a time.
// Not thread-safe.
class StageLog {
 public:
  // Creates the folder if absent. kFailedPrecondition if another build works
  // in it. A log that cannot be read counts as empty.
  static absl::StatusOr<StageLog> Open(const std::filesystem::path& folder);
  StageLog(StageLog&& other) noexcept;
  StageLog& operator=(StageLog&&) = delete;
  ~StageLog();

  bool IsDone(std::string_view stage, std::string_view key) const;
  // Must come before a stage's result is touched: an interruption then leaves
  // it undone.
  absl::Status Begin(std::string_view stage);
  absl::Status Finish(std::string_view stage, std::string_view key);

 private:
  StageLog(std::filesystem::path folder, int lock_fd);
  absl::Status Write() const;

  std::filesystem::path folder_;
  int lock_fd_ = -1;
  std::map<std::string, std::string, std::less<>> keys_;  // by stage
};

}  // namespace groundlock::build::internal

#endif  // GROUNDLOCK_MAP_STORE_BUILD_INTERNAL_STAGE_LOG_H_
