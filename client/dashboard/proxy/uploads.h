// SPDX-License-Identifier: Apache-2.0
// Files that pages upload: videos to start sessions from, maps to import.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_UPLOADS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_UPLOADS_H_

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/dashboard/proxy/options.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

enum class UploadKind { kVideo, kMap };

struct Upload {
  std::string id;
  UploadKind kind = UploadKind::kVideo;
  std::string name;              // as the page calls it
  std::string owner;             // who has begun it; empty = not known
  std::filesystem::path folder;  // its files
  std::uint64_t bytes = 0;       // of complete files
  std::uint32_t num_files = 0;
};

// A file on its way. Not thread-safe.
class UploadFile {
 public:
  virtual ~UploadFile() = default;  // removes it, unless committed
  // kResourceExhausted: a limit, or the disk is full.
  virtual absl::Status Write(std::string_view bytes) = 0;
  virtual absl::Status Commit() = 0;
};

// ROOT/ID/upload.json and ROOT/ID/files/PATH; they survive a restart. All
// methods but OpenFile's writes are quick. Thread-safe.
class Uploads {
 public:
  // root: created if absent; what is there from before is kept.
  static absl::StatusOr<std::unique_ptr<Uploads>> Open(
      const std::filesystem::path& root, const UploadLimits& limits);
  ~Uploads();

  absl::StatusOr<Upload> Create(UploadKind kind,
                                const std::string& name,
                                const std::string& owner);
  // path: checked by ValidateUploadPath. size: as announced, 0 = not told.
  // kNotFound, kAlreadyExists, kResourceExhausted.
  absl::StatusOr<std::unique_ptr<UploadFile>> OpenFile(
      const std::string& id,
      const std::vector<std::string>& path,
      std::uint64_t size);
  absl::Status Remove(const std::string& id);
  absl::StatusOr<Upload> Find(const std::string& id) const;
  std::vector<Upload> List() const;

 private:
  struct Book;
  class File;
  Uploads(std::filesystem::path root, const UploadLimits& limits);
  absl::Status Load();

  const std::filesystem::path root_;
  const UploadLimits limits_;
  // Shared with the files on their way, which may outlive their upload.
  const std::shared_ptr<Book> book_;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_UPLOADS_H_
