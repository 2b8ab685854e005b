// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/map_jobs.h"

#include <algorithm>
#include <functional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/media/video_source.h"
#include "client/sdk/client.h"
#include "map_store/base/status.h"
#include "map_store/formats/formats.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

namespace gl = ::groundlock::v1;

// The model may lie in a folder of the upload: pages upload whole folders.
absl::StatusOr<formats::ImportFiles> FindFiles(
    const std::filesystem::path& folder,
    const formats::ImportOptions& options) {
  auto found = formats::FindImportFiles(folder, options);
  if (found.ok()) return found;
  std::error_code error;
  for (std::filesystem::directory_iterator it(folder, error), end;
       !error && it != end;
       it.increment(error)) {
    if (!it->is_directory(error)) continue;
    auto inside = formats::FindImportFiles(it->path(), options);
    if (inside.ok()) return inside;
  }
  return found;
}

// The two enums name the same formats.
sdk::MapFormat ToSdk(formats::Format format) {
  switch (format) {
    case formats::Format::kColmap:
      return sdk::MapFormat::kColmap;
    case formats::Format::kNvm:
      return sdk::MapFormat::kNvm;
    case formats::Format::kBundler:
      return sdk::MapFormat::kBundler;
    case formats::Format::kOpenMvg:
      return sdk::MapFormat::kOpenMvg;
    case formats::Format::kOpenSfm:
      return sdk::MapFormat::kOpenSfm;
    case formats::Format::kGroundlock:
      return sdk::MapFormat::kGroundlock;
    case formats::Format::kAuto:
      break;
  }
  return sdk::MapFormat::kAuto;
}

absl::StatusOr<formats::Format> FromProto(gl::MapFormat format) {
  switch (format) {
    case gl::MAP_FORMAT_UNSPECIFIED:
      return formats::Format::kAuto;
    case gl::MAP_FORMAT_COLMAP:
      return formats::Format::kColmap;
    case gl::MAP_FORMAT_NVM:
      return formats::Format::kNvm;
    case gl::MAP_FORMAT_BUNDLER:
      return formats::Format::kBundler;
    case gl::MAP_FORMAT_OPENMVG:
      return formats::Format::kOpenMvg;
    case gl::MAP_FORMAT_OPENSFM:
      return formats::Format::kOpenSfm;
    case gl::MAP_FORMAT_GROUNDLOCK:
      return formats::Format::kGroundlock;
    default:
      return absl::InvalidArgumentError("format: not a known one");
  }
}

absl::StatusOr<geometry::CameraModel> FromProto(const gl::CameraModel& camera) {
  if (!gl::CameraModelId_IsValid(camera.model()) ||
      camera.model() == gl::CAMERA_MODEL_ID_UNSPECIFIED) {
    return absl::InvalidArgumentError("camera.model: not a known one");
  }
  // The message counts from one.
  auto model = geometry::CameraModel::Create(
      static_cast<geometry::CameraModelId>(camera.model() - 1),
      camera.width_px(),
      camera.height_px(),
      std::vector<double>(camera.params().begin(), camera.params().end()));
  if (!model.ok()) return base::Annotate(model.status(), "camera");
  return model;
}

absl::StatusOr<sdk::ImportRequest> MakeRequest(const pb::ImportMap& request,
                                               const Upload& upload) {
  formats::ImportOptions options;
  ASSIGN_OR_RETURN(options.format, FromProto(request.format()));
  ASSIGN_OR_RETURN(const formats::ImportFiles found,
                   FindFiles(upload.folder, options));
  sdk::ImportRequest out;
  out.name = request.name();
  out.format = ToSdk(found.format);
  for (const formats::ImportFile& file : found.files) {
    out.files.push_back({file.path, file.remote});
  }
  out.model_path = found.model;
  out.database_path = found.database;
  out.images_path = found.images;
  if (request.has_world_from_source()) {
    const gl::SimilarityTransform& from = request.world_from_source();
    out.world_from_source = geometry::Similarity3{from.scale(),
                                                  {from.rotation().w(),
                                                   from.rotation().x(),
                                                   from.rotation().y(),
                                                   from.rotation().z()},
                                                  {from.translation().x(),
                                                   from.translation().y(),
                                                   from.translation().z()}};
  }
  if (request.has_origin()) {
    out.origin = geometry::GeodeticPosition{request.origin().latitude_deg(),
                                            request.origin().longitude_deg(),
                                            request.origin().height_m()};
  }
  return out;
}

// One file that is no image is a video; else all images are photos.
absl::StatusOr<sdk::BuildRequest> MakeRequest(const pb::BuildMap& request,
                                              const Upload& upload) {
  sdk::BuildRequest out;
  out.name = request.name();
  std::error_code error;
  std::filesystem::recursive_directory_iterator it(upload.folder, error);
  for (const std::filesystem::recursive_directory_iterator end;
       !error && it != end;
       it.increment(error)) {
    if (!it->is_regular_file(error)) continue;
    out.files.push_back({it->path(), it->path().filename().string()});
  }
  if (error) {
    return absl::NotFoundError("upload_id: its files cannot be read");
  }
  const auto is_image = [](const sdk::LocalFile& file) {
    return media::HasImageExtension(file.path);
  };
  if (out.files.size() == 1 && !is_image(out.files.front())) {
    out.video_path = out.files.front().remote_path;
  } else {
    std::erase_if(out.files, std::not_fn(is_image));
    if (out.files.empty()) {
      return absl::InvalidArgumentError(
          "upload_id: neither one video nor photos");
    }
  }
  if (request.has_camera()) {
    ASSIGN_OR_RETURN(out.camera, FromProto(request.camera()));
  }
  out.max_images = request.max_images();
  return out;
}

}  // namespace

MapJobs::~MapJobs() {
  base::MutexLock lock(&mutex_);
  for (Job& job : jobs_) *job.cancel = true;
  for (Job& job : jobs_) job.thread.join();
}

std::size_t MapJobs::num_working() const {
  base::MutexLock lock(&mutex_);
  return static_cast<std::size_t>(std::count_if(
      jobs_.begin(), jobs_.end(), [](const Job& job) { return !job.over; }));
}

absl::Status MapJobs::Start(Work work,
                            const CancelFlag& cancel,
                            MapJobCallbacks callbacks) {
  base::MutexLock lock(&mutex_);
  for (auto job = jobs_.begin(); job != jobs_.end();) {
    if (!job->over) {
      ++job;
      continue;
    }
    job->thread.join();
    job = jobs_.erase(job);
  }
  if (jobs_.size() >= static_cast<std::size_t>(max_jobs_)) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the dashboard imports ", max_jobs_, " maps already: wait for one"));
  }
  Job& job = jobs_.emplace_back();
  job.cancel = cancel;
  job.thread = std::thread(
      [&job, work = std::move(work), cancel, callbacks = std::move(callbacks)] {
        auto result = work([&](const pb::Progress& progress) {
          callbacks.progress(progress);
          return !*cancel;
        });
        if (*cancel && !result.ok()) {
          result = absl::CancelledError("cancelled on request");
        }
        callbacks.done(std::move(result));
        job.over = true;
      });
  return absl::OkStatus();
}

absl::Status MapJobs::Import(const pb::ImportMap& request,
                             const Upload& upload,
                             const std::string& token,
                             const CancelFlag& cancel,
                             MapJobCallbacks callbacks) {
  auto work = [server = server_, request, upload, token](
                  const auto& go_on) -> absl::StatusOr<pb::MapImported> {
    ASSIGN_OR_RETURN(const sdk::ImportRequest files,
                     MakeRequest(request, upload));
    ASSIGN_OR_RETURN(const auto client, server.Connect(token));
    pb::Progress progress;
    // A page has no use for more than a few a second.
    int percent = -1;
    bool waiting = false;
    ASSIGN_OR_RETURN(
        const sdk::ImportReport report,
        client->ImportMap(files, [&](std::uint64_t done, std::uint64_t total) {
          const bool all = done >= total;
          const int now =
              total == 0 ? 100 : static_cast<int>(100.0 * done / total);
          if (now == percent && all == waiting) {
            progress.set_stage(all ? "importing" : "uploading");
            return go_on(progress);
          }
          percent = now;
          waiting = all;
          progress.set_stage(all ? "importing" : "uploading");
          progress.set_fraction(all ? 0.0 : 0.01 * now);
          return go_on(progress);
        }));
    spdlog::info(
        "map {}: imported as version {}", report.map.name, report.map.version);
    pb::MapImported imported;
    imported.mutable_map()->set_name(report.map.name);
    imported.mutable_map()->set_version(report.map.version);
    for (const std::string& warning : report.warnings) {
      imported.add_warnings(warning);
    }
    return imported;
  };
  return Start(std::move(work), cancel, std::move(callbacks));
}

absl::Status MapJobs::Build(const pb::BuildMap& request,
                            const Upload& upload,
                            const std::string& token,
                            const CancelFlag& cancel,
                            MapJobCallbacks callbacks) {
  auto work = [server = server_, request, upload, token](
                  const auto& go_on) -> absl::StatusOr<pb::MapImported> {
    ASSIGN_OR_RETURN(const sdk::BuildRequest files,
                     MakeRequest(request, upload));
    ASSIGN_OR_RETURN(const auto client, server.Connect(token));
    ASSIGN_OR_RETURN(const sdk::BuildReport report,
                     client->BuildMap(files,
                                      [&](std::string_view stage,
                                          double fraction,
                                          const std::string& note) {
                                        pb::Progress progress;
                                        progress.set_stage(std::string(stage));
                                        progress.set_fraction(fraction);
                                        progress.set_note(note);
                                        return go_on(progress);
                                      }));
    spdlog::info(
        "map {}: built as version {}", report.map.name, report.map.version);
    pb::MapImported built;
    built.mutable_map()->set_name(report.map.name);
    built.mutable_map()->set_version(report.map.version);
    for (const std::string& warning : report.warnings) {
      built.add_warnings(warning);
    }
    built.set_report_json(report.report_json);
    return built;
  };
  return Start(std::move(work), cancel, std::move(callbacks));
}

}  // namespace groundlock::dashboard
