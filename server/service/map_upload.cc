// SPDX-License-Identifier: Apache-2.0
#include "server/service/map_upload.h"

#include <algorithm>
#include <system_error>
#include <utility>

#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

namespace fs = std::filesystem;

template <typename... Parts>
absl::Status Invalid(std::string_view field, const Parts&... parts) {
  return absl::InvalidArgumentError(
      absl::StrCat(base::Abseil(field), ": ", parts...));
}

}  // namespace

absl::Status ValidateRelativePath(std::string_view path,
                                  std::string_view field) {
  if (path.empty() || path.size() > 1'024) {
    return Invalid(field, "must have 1 to 1024 bytes");
  }
  const bool strange = std::any_of(path.begin(), path.end(), [](char c) {
    return static_cast<unsigned char>(c) < 0x20 || c == 0x7f || c == '\\';
  });
  if (strange) {
    return Invalid(field, "holds a backslash or a control character");
  }
  std::size_t begin = 0;
  while (begin <= path.size()) {
    const std::size_t end = std::min(path.find('/', begin), path.size());
    const std::string_view part = path.substr(begin, end - begin);
    if (part.empty() || part == "." || part == ".." || part.size() > 255) {
      return Invalid(
          field, "'", base::Abseil(path), "' is not a plain relative path");
    }
    begin = end + 1;
  }
  return absl::OkStatus();
}

MapUpload::MapUpload(std::unique_ptr<ScratchDirectory> directory,
                     const MapLimits& limits)
    : directory_(std::move(directory)), limits_(limits) {}

absl::StatusOr<std::unique_ptr<MapUpload>> MapUpload::Create(
    const ScratchSpace& scratch, const MapLimits& limits) {
  ASSIGN_OR_RETURN(auto directory, scratch.Create());
  return std::unique_ptr<MapUpload>(
      new MapUpload(std::move(directory), limits));
}

absl::Status MapUpload::CloseFile() {
  if (num_files_ == 0) return absl::OkStatus();
  if (file_missing_bytes_ > 0) {
    return Invalid("chunk",
                   "file '",
                   file_path_,
                   "' lacks ",
                   file_missing_bytes_,
                   " bytes of those announced");
  }
  if (!file_.is_open()) return absl::OkStatus();
  file_.close();
  if (file_.fail()) {
    return absl::ResourceExhaustedError(
        absl::StrCat("cannot write file '", file_path_, "': disk full?"));
  }
  return absl::OkStatus();
}

absl::Status MapUpload::CheckDisk(std::uint64_t more_bytes) const {
  std::error_code error;
  const fs::space_info space = fs::space(directory_->path(), error);
  if (error || (space.available > limits_.min_free_bytes &&
                space.available - limits_.min_free_bytes >= more_bytes)) {
    return absl::OkStatus();
  }
  return absl::ResourceExhaustedError("the server's disk is full");
}

// Those that a file's path names and that are not there yet.
absl::Status MapUpload::MakeFolders(std::string_view path) {
  for (std::size_t end = path.find('/'); end != std::string_view::npos;
       end = path.find('/', end + 1)) {
    const std::string_view folder = path.substr(0, end);
    std::error_code error;
    const bool is_new =
        fs::create_directory(directory_->path() / folder, error);
    if (error) {
      return Invalid("file_start.path",
                     "'",
                     base::Abseil(path),
                     "' collides with another file of this import");
    }
    if (is_new && ++num_folders_ > limits_.max_files) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "file_start: more than ", limits_.max_files, " folders"));
    }
  }
  return absl::OkStatus();
}

absl::Status MapUpload::StartFile(const std::string& path,
                                  std::uint64_t size_bytes) {
  RETURN_IF_ERROR(CloseFile());
  RETURN_IF_ERROR(ValidateRelativePath(path, "file_start.path"));
  if (num_files_ >= limits_.max_files) {
    return absl::ResourceExhaustedError(
        absl::StrCat("file_start: more than ", limits_.max_files, " files"));
  }
  if (size_bytes > limits_.max_file_bytes) {
    return absl::ResourceExhaustedError(
        absl::StrCat("file_start.size_bytes: file '",
                     path,
                     "' has ",
                     size_bytes,
                     ", more than ",
                     limits_.max_file_bytes));
  }
  if (size_bytes > limits_.max_total_bytes - total_bytes_) {
    return absl::ResourceExhaustedError(
        absl::StrCat("file_start.size_bytes: with file '",
                     path,
                     "' the files have more than ",
                     limits_.max_total_bytes));
  }
  RETURN_IF_ERROR(CheckDisk(size_bytes));
  RETURN_IF_ERROR(MakeFolders(path));
  const fs::path target = directory_->path() / path;
  std::error_code error;
  if (fs::exists(target, error)) {
    return Invalid("file_start.path",
                   "'",
                   path,
                   "' collides with another file of this import");
  }
  file_.open(target, std::ios::binary | std::ios::trunc);
  if (!file_) {
    return absl::InternalError(absl::StrCat("cannot create file '", path, "'"));
  }
  file_path_ = path;
  file_missing_bytes_ = size_bytes;
  total_bytes_ += size_bytes;
  ++num_files_;
  return absl::OkStatus();
}

absl::Status MapUpload::AddChunk(std::string_view chunk) {
  if (num_files_ == 0) return Invalid("chunk", "comes before a file_start");
  if (chunk.size() > kMaxChunkBytes) {
    return Invalid(
        "chunk", "has ", chunk.size(), " bytes, more than ", kMaxChunkBytes);
  }
  if (chunk.size() > file_missing_bytes_) {
    return Invalid(
        "chunk", "file '", file_path_, "' has more bytes than announced");
  }
  RETURN_IF_ERROR(CheckDisk(chunk.size()));
  file_.write(chunk.data(), static_cast<std::streamsize>(chunk.size()));
  if (!file_) {
    return absl::ResourceExhaustedError(
        absl::StrCat("cannot write file '", file_path_, "': disk full?"));
  }
  file_missing_bytes_ -= chunk.size();
  return absl::OkStatus();
}

absl::Status MapUpload::Finish(std::uint64_t announced_files) {
  if (num_files_ == 0) return Invalid("file_start", "no file was sent");
  if (announced_files != 0 &&
      announced_files != static_cast<std::uint64_t>(num_files_)) {
    return Invalid("header.num_files",
                   announced_files,
                   " files were announced, ",
                   num_files_,
                   " were sent");
  }
  return CloseFile();
}

absl::StatusOr<fs::path> MapUpload::Resolve(std::string_view path,
                                            std::string_view field) const {
  if (path == ".") return directory_->path();
  RETURN_IF_ERROR(ValidateRelativePath(path, field));
  const fs::path resolved = directory_->path() / path;
  std::error_code error;
  if (!fs::exists(resolved, error)) {
    return Invalid(field,
                   "'",
                   base::Abseil(path),
                   "' is not among the files that were sent");
  }
  return resolved;
}

std::string MapUpload::Anonymized(std::string_view message) const {
  return WithoutFolder(message, directory_->path());
}

std::string WithoutFolder(std::string_view message, const fs::path& folder) {
  std::string result(message);
  const std::string own = folder.string();
  for (const std::string& prefix : {own + "/", own}) {
    for (std::size_t at = result.find(prefix); at != std::string::npos;
         at = result.find(prefix, at)) {
      result.erase(at, prefix.size());
    }
  }
  return result;
}

}  // namespace groundlock::service
