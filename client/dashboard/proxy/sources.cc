// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/sources.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/geometry/camera_model.h"

namespace groundlock::dashboard {
namespace {

namespace gl = ::groundlock::v1;

namespace fs = std::filesystem;

constexpr std::size_t kMaxSources = 1'000;
constexpr std::uint64_t kMaxCameraBytes = 64 << 10;

bool IsVideo(const fs::path& path) {
  constexpr std::array<std::string_view, 8> kExtensions = {
      ".mp4", ".mov", ".mkv", ".avi", ".m4v", ".webm", ".ts", ".mpg"};
  const std::string extension =
      absl::AsciiStrToLower(path.extension().string());
  return std::find(kExtensions.begin(), kExtensions.end(), extension) !=
         kExtensions.end();
}

bool IsImage(const fs::path& path) {
  const std::string extension =
      absl::AsciiStrToLower(path.extension().string());
  return extension == ".jpg" || extension == ".jpeg" || extension == ".png";
}

bool HoldsImages(const fs::path& folder) {
  std::error_code error;
  int looked_at = 0;
  for (fs::directory_iterator it(folder, error), end;
       !error && it != end && looked_at < 16;
       it.increment(error), ++looked_at) {
    if (IsImage(it->path())) return true;
  }
  return false;
}

void FillCamera(const fs::path& path, pb::Source* source) {
  const auto text = base::ReadFile(path, kMaxCameraBytes);
  if (!text.ok()) return;
  const auto camera = geometry::CameraModelFromJson(*text);
  if (!camera.ok()) return;
  // The API's numbers are COLMAP's plus one.
  source->mutable_camera()->set_model(
      static_cast<gl::CameraModelId>(static_cast<int>(camera->id()) + 1));
  source->mutable_camera()->set_width_px(camera->width_px());
  source->mutable_camera()->set_height_px(camera->height_px());
  for (const double param : camera->params()) {
    source->mutable_camera()->add_params(param);
  }
}

// Beside a video: VIDEO.camera.json, else camera.json.
void FindCamera(const fs::path& video, pb::Source* source) {
  FillCamera(fs::path(video).replace_extension(".camera.json"), source);
  if (!source->has_camera()) {
    FillCamera(video.parent_path() / "camera.json", source);
  }
}

Sources::Found FromFolder(const fs::path& path, bool is_folder) {
  Sources::Found found;
  const std::string name = path.filename().string();
  found.source.set_source_id(absl::StrCat("file:", name));
  found.source.set_name(name);
  found.source.set_kind(is_folder ? pb::Source::KIND_FOLDER
                                  : pb::Source::KIND_FILE);
  found.input = path.string();
  if (is_folder) {
    FillCamera(path / "camera.json", &found.source);
  } else {
    std::error_code error;
    const std::uintmax_t size = fs::file_size(path, error);
    found.source.set_size_bytes(error ? 0 : size);
  }
  if (!found.source.has_camera()) FindCamera(path, &found.source);
  return found;
}

}  // namespace

std::vector<Sources::Found> Sources::List() const {
  std::vector<Found> list;
  for (const StreamSource& stream : streams_) {
    Found found;
    found.source.set_source_id(absl::StrCat("stream:", stream.name));
    found.source.set_name(stream.name);
    found.source.set_kind(pb::Source::KIND_STREAM);
    found.input = stream.input;
    if (!stream.camera.empty()) FillCamera(stream.camera, &found.source);
    list.push_back(std::move(found));
  }
  std::error_code error;
  std::vector<fs::path> entries;
  if (!folder_.empty()) {
    for (fs::directory_iterator it(folder_, error), end;
         !error && it != end && entries.size() < kMaxSources;
         it.increment(error)) {
      entries.push_back(it->path());
    }
  }
  std::sort(entries.begin(), entries.end());
  for (const fs::path& path : entries) {
    if (fs::is_directory(path, error)) {
      if (HoldsImages(path)) list.push_back(FromFolder(path, true));
    } else if (IsVideo(path)) {
      list.push_back(FromFolder(path, false));
    }
  }
  if (uploads_ == nullptr) return list;
  for (const Upload& upload : uploads_->List()) {
    if (upload.kind != UploadKind::kVideo) continue;
    for (fs::directory_iterator it(upload.folder, error), end;
         !error && it != end;
         it.increment(error)) {
      if (!IsVideo(it->path())) continue;
      Found found = FromFolder(it->path(), false);
      found.source.set_source_id(absl::StrCat("upload:", upload.id));
      found.source.set_kind(pb::Source::KIND_UPLOAD);
      found.source.set_name(upload.name);
      found.source.set_upload_id(upload.id);
      list.push_back(std::move(found));
      break;
    }
  }
  return list;
}

absl::StatusOr<Sources::Found> Sources::Find(
    const std::string& source_id) const {
  for (Found& found : List()) {
    if (found.source.source_id() == source_id) return std::move(found);
  }
  return absl::NotFoundError(
      absl::StrCat("source_id: there is no source \"", source_id, "\""));
}

}  // namespace groundlock::dashboard
