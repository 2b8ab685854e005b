// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/map_jobs.h"

#include <utility>

#include "absl/strings/str_cat.h"
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

}  // namespace

MapJobs::~MapJobs() {
  base::MutexLock lock(&mutex_);
  for (Job& job : jobs_) *job.cancel = true;
  for (Job& job : jobs_) job.thread.join();
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
    sdk::ClientOptions options;
    options.token = token;
    ASSIGN_OR_RETURN(const auto client, sdk::Client::Connect(server, options));
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

}  // namespace groundlock::dashboard
