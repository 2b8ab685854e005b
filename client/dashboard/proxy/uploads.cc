// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/uploads.h"

#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/http_rules.h"
#include "client/dashboard/proxy/logins.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMaxInfoBytes = 64 << 10;
constexpr std::size_t kMaxNameBytes = 200;
// Left free on the disk for everything else.
constexpr std::uint64_t kMinFreeBytes = std::uint64_t{64} << 20;

std::string KindName(UploadKind kind) {
  return kind == UploadKind::kVideo ? "video" : "map";
}

std::string InfoJson(const Upload& upload) {
  return nlohmann::json{{"kind", KindName(upload.kind)},
                        {"name", upload.name},
                        {"owner", upload.owner}}
      .dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::optional<Upload> ReadUpload(const fs::path& folder) {
  const auto text = base::ReadFile(folder / "upload.json", kMaxInfoBytes);
  if (!text.ok()) return std::nullopt;
  const auto json = nlohmann::json::parse(*text, nullptr, false);
  if (!json.is_object()) return std::nullopt;
  Upload upload;
  upload.id = folder.filename().string();
  upload.kind =
      json.value("kind", "") == "map" ? UploadKind::kMap : UploadKind::kVideo;
  upload.name = json.value("name", upload.id);
  upload.owner = json.value("owner", "");
  upload.folder = folder / "files";
  std::error_code error;
  for (fs::recursive_directory_iterator it(upload.folder, error), end;
       !error && it != end;
       it.increment(error)) {
    if (!it->is_regular_file(error)) continue;
    ++upload.num_files;
    upload.bytes += it->file_size(error);
  }
  return upload;
}

}  // namespace

struct Uploads::Book {
  base::Mutex mutex;
  std::map<std::string, Upload> uploads ABSL_GUARDED_BY(mutex);
  // Bytes of files on their way, by upload, as far as written.
  std::map<std::string, std::uint64_t> unfinished ABSL_GUARDED_BY(mutex);
  std::set<std::string> open_paths ABSL_GUARDED_BY(mutex);

  std::uint64_t TotalBytes() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex) {
    std::uint64_t total = 0;
    for (const auto& [id, upload] : uploads) total += upload.bytes;
    for (const auto& [id, bytes] : unfinished) total += bytes;
    return total;
  }
};

class Uploads::File final : public UploadFile {
 public:
  File(std::shared_ptr<Book> book,
       const UploadLimits& limits,
       std::string id,
       fs::path path,
       base::AtomicFile file)
      : book_(std::move(book)),
        limits_(limits),
        id_(std::move(id)),
        path_(std::move(path)),
        file_(std::move(file)) {}
  ~File() override {
    base::MutexLock lock(&book_->mutex);
    book_->open_paths.erase(path_.string());
    book_->unfinished[id_] -= bytes_;
  }

  absl::Status Write(std::string_view bytes) override {
    {
      base::MutexLock lock(&book_->mutex);
      const auto upload = book_->uploads.find(id_);
      if (upload == book_->uploads.end()) {
        return absl::NotFoundError("the upload was removed");
      }
      const std::uint64_t limit = upload->second.kind == UploadKind::kVideo
                                      ? limits_.max_video_bytes
                                      : limits_.max_map_bytes;
      if (upload->second.bytes + book_->unfinished[id_] + bytes.size() >
          limit) {
        return absl::ResourceExhaustedError(
            absl::StrCat("the upload is larger than ", limit >> 20, " MiB"));
      }
      if (book_->TotalBytes() + bytes.size() > limits_.max_total_bytes) {
        return absl::ResourceExhaustedError(
            "all uploads together are too large: remove some");
      }
      book_->unfinished[id_] += bytes.size();
      bytes_ += bytes.size();
    }
    return file_.Write(bytes);
  }

  absl::Status Commit() override {
    RETURN_IF_ERROR(file_.Commit());
    base::MutexLock lock(&book_->mutex);
    const auto upload = book_->uploads.find(id_);
    if (upload == book_->uploads.end()) {
      return absl::NotFoundError("the upload was removed");
    }
    upload->second.bytes += bytes_;
    ++upload->second.num_files;
    book_->unfinished[id_] -= bytes_;
    bytes_ = 0;
    return absl::OkStatus();
  }

 private:
  const std::shared_ptr<Book> book_;
  const UploadLimits limits_;
  const std::string id_;
  const fs::path path_;
  base::AtomicFile file_;
  std::uint64_t bytes_ = 0;  // counted as unfinished
};

Uploads::Uploads(fs::path root, const UploadLimits& limits)
    : root_(std::move(root)),
      limits_(limits),
      book_(std::make_shared<Book>()) {}

Uploads::~Uploads() = default;

absl::StatusOr<std::unique_ptr<Uploads>> Uploads::Open(
    const fs::path& root, const UploadLimits& limits) {
  std::error_code error;
  fs::create_directories(root, error);
  if (error) {
    return absl::FailedPreconditionError(
        absl::StrCat(root.string(), ": ", error.message()));
  }
  std::unique_ptr<Uploads> uploads(new Uploads(root, limits));
  RETURN_IF_ERROR(uploads->Load());
  return uploads;
}

absl::Status Uploads::Load() {
  std::error_code error;
  base::MutexLock lock(&book_->mutex);
  for (fs::directory_iterator it(root_, error), end; !error && it != end;
       it.increment(error)) {
    if (auto upload = ReadUpload(it->path())) {
      book_->uploads[upload->id] = *std::move(upload);
    }
  }
  if (!error) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(root_.string(), ": ", error.message()));
}

absl::StatusOr<Upload> Uploads::Create(UploadKind kind,
                                       const std::string& name,
                                       const std::string& owner) {
  if (name.empty() || name.size() > kMaxNameBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("name: expected 1 to ", kMaxNameBytes, " bytes"));
  }
  Upload upload;
  upload.id = RandomId();
  upload.kind = kind;
  upload.name = name;
  upload.owner = owner;
  upload.folder = root_ / upload.id / "files";
  {
    base::MutexLock lock(&book_->mutex);
    if (book_->uploads.size() >=
        static_cast<std::size_t>(limits_.max_uploads)) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "there are ", limits_.max_uploads, " uploads: remove some"));
    }
  }
  std::error_code error;
  fs::create_directories(upload.folder, error);
  if (error) {
    return absl::ResourceExhaustedError(
        absl::StrCat("cannot create the upload: ", error.message()));
  }
  RETURN_IF_ERROR(base::WriteFileAtomically(root_ / upload.id / "upload.json",
                                            InfoJson(upload)));
  base::MutexLock lock(&book_->mutex);
  book_->uploads[upload.id] = upload;
  return upload;
}

absl::StatusOr<std::unique_ptr<UploadFile>> Uploads::OpenFile(
    const std::string& id,
    const std::vector<std::string>& path,
    std::uint64_t size) {
  RETURN_IF_ERROR(ValidateUploadPath(path));
  ASSIGN_OR_RETURN(const Upload upload, Find(id));
  fs::path target = upload.folder;
  for (const std::string& segment : path) target /= segment;
  const std::uint64_t limit = upload.kind == UploadKind::kVideo
                                  ? limits_.max_video_bytes
                                  : limits_.max_map_bytes;
  std::error_code error;
  const fs::space_info space = fs::space(root_, error);
  if (size > limit || upload.bytes + size > limit) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the upload is larger than ", limit >> 20, " MiB"));
  }
  if (!error && space.available < size + kMinFreeBytes) {
    return absl::UnavailableError("the dashboard's disk is full");
  }
  if (upload.num_files >= limits_.max_map_files) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the upload has more than ", limits_.max_map_files, " files"));
  }
  fs::create_directories(target.parent_path(), error);
  if (error || fs::is_directory(target)) {
    return absl::AlreadyExistsError("a file and a folder of one name");
  }
  {
    base::MutexLock lock(&book_->mutex);
    if (fs::exists(target) ||
        !book_->open_paths.insert(target.string()).second) {
      return absl::AlreadyExistsError("the file is there already");
    }
  }
  auto file = base::AtomicFile::Create(target);
  if (!file.ok()) {
    base::MutexLock lock(&book_->mutex);
    book_->open_paths.erase(target.string());
    return file.status();
  }
  return std::make_unique<File>(book_, limits_, id, target, *std::move(file));
}

absl::Status Uploads::Remove(const std::string& id) {
  {
    base::MutexLock lock(&book_->mutex);
    if (book_->uploads.erase(id) == 0) {
      return absl::NotFoundError("no such upload");
    }
  }
  std::error_code error;
  fs::remove_all(root_ / id, error);
  if (error)
    spdlog::warn("upload {}: cannot be removed: {}", id, error.message());
  return absl::OkStatus();
}

absl::StatusOr<Upload> Uploads::Find(const std::string& id) const {
  base::MutexLock lock(&book_->mutex);
  const auto found = book_->uploads.find(id);
  if (found == book_->uploads.end()) {
    return absl::NotFoundError("no such upload");
  }
  return found->second;
}

std::vector<Upload> Uploads::List() const {
  base::MutexLock lock(&book_->mutex);
  std::vector<Upload> list;
  for (const auto& [id, upload] : book_->uploads) list.push_back(upload);
  return list;
}

}  // namespace groundlock::dashboard
