// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/stage_log.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>
#include <xxhash.h>

#include <cerrno>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kLogFile = "stages.json";
constexpr std::uint64_t kMaxLogBytes = 1 << 20;

class Hasher {
 public:
  Hasher() : state_(XXH3_createState(), XXH3_freeState) {
    XXH3_128bits_reset(state_.get());
  }
  void Add(std::string_view bytes) {
    XXH3_128bits_update(state_.get(), bytes.data(), bytes.size());
  }
  void AddNumber(std::uint64_t number) {
    Add({reinterpret_cast<const char*>(&number), sizeof(number)});
  }
  std::string Hex() const {
    const XXH128_hash_t hash = XXH3_128bits_digest(state_.get());
    return absl::StrFormat("%016x%016x", hash.high64, hash.low64);
  }

 private:
  std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state_;
};

}  // namespace

std::string HashOf(std::span<const std::string> parts) {
  Hasher hasher;
  for (const std::string& part : parts) {
    hasher.AddNumber(part.size());
    hasher.Add(part);
  }
  return hasher.Hex();
}

absl::StatusOr<std::string> HashOfFiles(std::span<const fs::path> files) {
  Hasher hasher;
  std::vector<char> buffer(1 << 20);
  for (const fs::path& file : files) {
    const std::string name = file.filename().string();
    hasher.AddNumber(name.size());
    hasher.Add(name);
    std::ifstream stream(file, std::ios::binary);
    std::error_code error;
    if (!stream || !fs::is_regular_file(file, error)) {
      return absl::NotFoundError(absl::StrCat(file.string(), ": cannot read"));
    }
    std::uint64_t size = 0;
    do {
      stream.read(buffer.data(), static_cast<std::streamsize>(buffer.size()));
      const auto count = static_cast<std::size_t>(stream.gcount());
      hasher.Add({buffer.data(), count});
      size += count;
    } while (stream);
    hasher.AddNumber(size);
  }
  return hasher.Hex();
}

StageLog::StageLog(fs::path folder, int lock_fd)
    : folder_(std::move(folder)), lock_fd_(lock_fd) {}

StageLog::StageLog(StageLog&& other) noexcept
    : folder_(std::move(other.folder_)),
      lock_fd_(std::exchange(other.lock_fd_, -1)),
      keys_(std::move(other.keys_)) {}

StageLog::~StageLog() {
  if (lock_fd_ >= 0) close(lock_fd_);
}

absl::StatusOr<StageLog> StageLog::Open(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    return absl::FailedPreconditionError(
        absl::StrCat("cannot create ", folder.string(), ": ", error.message()));
  }
  const int fd =
      open((folder / "lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0) {
    return absl::ErrnoToStatus(
        errno, absl::StrCat("cannot write into ", folder.string()));
  }
  StageLog log(folder, fd);
  if (flock(fd, LOCK_EX | LOCK_NB) != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(folder.string(),
                     ": another build is at work here; wait for it, or name "
                     "another folder"));
  }
  const auto content = base::ReadFile(folder / kLogFile, kMaxLogBytes);
  if (content.ok()) {
    const json parsed = json::parse(*content, nullptr, false);
    if (parsed.is_object()) {
      for (const auto& [stage, key] : parsed.items()) {
        if (key.is_string()) log.keys_[stage] = key.get<std::string>();
      }
    }
  }
  return log;
}

bool StageLog::IsDone(std::string_view stage, std::string_view key) const {
  const auto it = keys_.find(stage);
  return it != keys_.end() && it->second == key;
}

absl::Status StageLog::Begin(std::string_view stage) {
  const auto it = keys_.find(stage);
  if (it == keys_.end()) return absl::OkStatus();
  keys_.erase(it);
  return Write();
}

absl::Status StageLog::Finish(std::string_view stage, std::string_view key) {
  keys_[std::string(stage)] = std::string(key);
  return Write();
}

absl::Status StageLog::Write() const {
  return base::WriteFileAtomically(folder_ / kLogFile, json(keys_).dump(2));
}

}  // namespace groundlock::build::internal
