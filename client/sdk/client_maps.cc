// SPDX-License-Identifier: Apache-2.0
// The client's map calls: catalogue, and transfers in both directions.
#include <algorithm>
#include <chrono>
#include <fstream>
#include <future>
#include <system_error>
#include <utility>

#include "client/sdk/client.h"
#include "client/sdk/connection.h"
#include "client/sdk/convert.h"
#include "client/sdk/file_upload.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {
namespace {

namespace fs = std::filesystem;

// How often `progress` is asked while the server imports.
constexpr std::chrono::milliseconds kPollInterval{100};

// Writes what an export stream brings below `root` (single: to it).
class ExportReceiver {
 public:
  ExportReceiver(fs::path root, const Progress& progress)
      : root_(std::move(root)), progress_(progress) {}

  absl::Status Take(const pb::ExportMapResponse& message) {
    if (message.has_file_start()) return StartFile(message.file_start());
    done_ += message.chunk().size();
    file_.write(message.chunk().data(),
                static_cast<std::streamsize>(message.chunk().size()));
    if (!file_) {
      return absl::ResourceExhaustedError(
          absl::StrCat("cannot write ", path_.string()));
    }
    if (progress_ && !progress_(done_, total_)) {
      return absl::CancelledError("the export was cancelled");
    }
    return absl::OkStatus();
  }

  absl::Status Finish() {
    file_.close();
    if (file_.fail()) {
      return absl::ResourceExhaustedError(
          absl::StrCat("cannot write ", path_.string()));
    }
    if (done_ != total_) {
      return absl::DataLossError("the server sent less than it announced");
    }
    return absl::OkStatus();
  }

 private:
  absl::Status StartFile(const pb::ExportMapResponse::FileStart& start) {
    const fs::path relative = start.path();
    const bool leaves =
        relative.is_absolute() ||
        std::find(relative.begin(), relative.end(), "..") != relative.end();
    if (leaves) {
      return absl::InternalError(absl::StrCat(
          "the server sent a file outside of the export: ", start.path()));
    }
    path_ = start.path().empty() ? root_ / kSingle : root_ / relative;
    std::error_code error;
    fs::create_directories(path_.parent_path(), error);
    if (file_.is_open()) file_.close();
    file_.open(path_, std::ios::binary | std::ios::trunc);
    if (error || !file_) {
      return absl::FailedPreconditionError(
          absl::StrCat("cannot create ", path_.string()));
    }
    total_ += start.size_bytes();
    return absl::OkStatus();
  }

 public:
  // The name of an export that is one file, until it gets its own.
  static constexpr const char* kSingle = ".single";

 private:
  const fs::path root_;
  const Progress& progress_;
  fs::path path_;
  std::ofstream file_;
  std::uint64_t done_ = 0;
  std::uint64_t total_ = 0;
};

// Moves a finished export from the folder it was received in to `path`.
absl::Status PlaceExport(const fs::path& received,
                         MapExportFormat format,
                         const fs::path& path) {
  std::error_code error;
  if (fs::exists(received / ExportReceiver::kSingle, error)) {
    fs::rename(received / ExportReceiver::kSingle, path, error);
  } else if (format == MapExportFormat::kNvm) {
    // The model under the name that was asked for, its features beside.
    for (const auto& entry : fs::directory_iterator(received)) {
      const bool model = entry.path().extension() == ".nvm";
      const fs::path target =
          model ? path : path.parent_path() / entry.path().filename();
      if (fs::exists(target)) {
        return absl::AlreadyExistsError(
            absl::StrCat(target.string(), ": exists"));
      }
      fs::rename(entry.path(), target, error);
      if (error) break;
    }
  } else {
    fs::rename(received, path, error);
    if (!error) fs::permissions(path, fs::perms(0755), error);
  }
  if (error) {
    return absl::FailedPreconditionError(
        absl::StrCat("cannot create ", path.string(), ": ", error.message()));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::uint64_t> TotalBytes(const std::vector<LocalFile>& files) {
  std::uint64_t total = 0;
  for (const LocalFile& file : files) {
    std::error_code error;
    const std::uint64_t size = fs::file_size(file.path, error);
    if (error) {
      return absl::NotFoundError(
          absl::StrCat(file.path.string(), ": ", error.message()));
    }
    total += size;
  }
  return total;
}

absl::StatusOr<ImportReport> Client::ImportMap(const ImportRequest& request,
                                               const Progress& progress) {
  ASSIGN_OR_RETURN(const std::uint64_t total, TotalBytes(request.files));
  grpc::ClientContext context;
  pb::ImportMapResponse response;
  const std::unique_ptr<grpc::ClientWriter<pb::ImportMapRequest>> writer =
      connection_->maps->ImportMap(&context, &response);
  pb::ImportMapRequest message;
  pb::ImportMapRequest::Header* header = message.mutable_header();
  header->set_name(request.name);
  header->set_format(ToProto(request.format));
  header->set_model_path(request.model_path);
  header->set_database_path(request.database_path);
  header->set_images_path(request.images_path);
  if (request.origin) ToProto(*request.origin, header->mutable_origin());
  if (request.world_from_source.has_value()) {
    ToProto(*request.world_from_source, header->mutable_world_from_source());
  }
  header->set_seed(request.seed);
  header->set_num_files(request.files.size());
  absl::Status local;
  if (writer->Write(message)) {
    local = SendFiles<pb::ImportMapRequest>(
        request.files, total, progress, *writer);
  }
  if (!local.ok()) context.TryCancel();
  auto finished = std::async(std::launch::async,
                             [&writer] { return FromGrpc(writer->Finish()); });
  while (finished.wait_for(kPollInterval) != std::future_status::ready) {
    if (local.ok() && progress && !progress(total, total)) {
      local = absl::CancelledError("the import was cancelled");
      context.TryCancel();
    }
  }
  const absl::Status remote = finished.get();
  RETURN_IF_ERROR(local);
  RETURN_IF_ERROR(remote);
  ImportReport report{FromProto(response.map()), {}};
  report.warnings.assign(response.warnings().begin(),
                         response.warnings().end());
  return report;
}

absl::StatusOr<std::vector<MapInfo>> Client::ListMaps() {
  std::vector<MapInfo> maps;
  pb::ListMapsRequest request;
  do {
    pb::ListMapsResponse response;
    RETURN_IF_ERROR(FromGrpc(connection_->maps->ListMaps(
        connection_->Context().get(), request, &response)));
    for (const pb::MapInfo& map : response.maps()) {
      maps.push_back(FromProto(map));
    }
    request.set_page_token(response.next_page_token());
  } while (!request.page_token().empty());
  return maps;
}

absl::StatusOr<MapInfo> Client::GetMap(const std::string& name,
                                       std::uint64_t version) {
  pb::GetMapRequest request;
  pb::GetMapResponse response;
  request.set_name(name);
  request.set_version(version);
  RETURN_IF_ERROR(FromGrpc(connection_->maps->GetMap(
      connection_->Context().get(), request, &response)));
  return FromProto(response.map());
}

absl::Status Client::DeleteMap(const std::string& name) {
  pb::DeleteMapRequest request;
  pb::DeleteMapResponse response;
  request.set_name(name);
  return FromGrpc(connection_->maps->DeleteMap(
      connection_->Context().get(), request, &response));
}

absl::StatusOr<PointCloud> Client::GetPointCloud(const std::string& name,
                                                 std::uint64_t version,
                                                 std::uint64_t max_points) {
  pb::GetPointCloudRequest request;
  request.set_name(name);
  request.set_version(version);
  request.set_max_points(max_points);
  grpc::ClientContext context;
  const auto reader = connection_->maps->GetPointCloud(&context, request);
  PointCloud cloud;
  pb::GetPointCloudResponse block;
  absl::Status local;
  while (local.ok() && reader->Read(&block)) {
    const int count = std::min(block.xyz_m_size() / 3,
                               static_cast<int>(block.rgb().size()) / 3);
    for (int i = 0; i < count; ++i) {
      cloud.xyz_world.emplace_back(
          block.xyz_m(3 * i), block.xyz_m(3 * i + 1), block.xyz_m(3 * i + 2));
      const auto* rgb =
          reinterpret_cast<const std::uint8_t*>(block.rgb().data()) + 3 * i;
      cloud.rgb.push_back({rgb[0], rgb[1], rgb[2]});
    }
    for (const auto& camera : block.cameras()) {
      auto model = FromProto(camera.camera());
      if (!model.ok()) {
        local = model.status();
        context.TryCancel();
        break;
      }
      cloud.cameras.push_back({camera.name(),
                               *std::move(model),
                               FromProto(camera.world_from_camera())});
    }
  }
  const absl::Status remote = FromGrpc(reader->Finish());
  RETURN_IF_ERROR(local);
  RETURN_IF_ERROR(remote);
  return cloud;
}

absl::Status Client::ExportMap(const std::string& name,
                               std::uint64_t version,
                               MapExportFormat format,
                               const fs::path& path,
                               const Progress& progress,
                               std::vector<std::string>* warnings) {
  std::error_code error;
  if (fs::exists(path, error)) {
    return absl::AlreadyExistsError(absl::StrCat(path.string(), ": exists"));
  }
  fs::path target = fs::absolute(path).lexically_normal();
  if (!target.has_filename()) target = target.parent_path();  // "map/"
  ASSIGN_OR_RETURN(auto received,
                   base::TemporaryDirectory::Create(target.parent_path()));
  // The folder itself may be renamed away; its parent is what is cleaned up.
  const fs::path root = received.path() / "export";
  fs::create_directory(root, error);
  pb::ExportMapRequest request;
  request.set_name(name);
  request.set_version(version);
  request.set_format(ToProto(format));
  grpc::ClientContext context;
  const auto reader = connection_->maps->ExportMap(&context, request);
  ExportReceiver receiver(root, progress);
  pb::ExportMapResponse message;
  absl::Status local;
  // The server makes all files before it sends the first, which takes a while.
  auto first =
      std::async(std::launch::async, [&] { return reader->Read(&message); });
  while (first.wait_for(kPollInterval) != std::future_status::ready) {
    if (local.ok() && progress && !progress(0, 0)) {
      local = absl::CancelledError("the export was cancelled");
      context.TryCancel();
    }
  }
  for (bool more = first.get(); local.ok() && more;
       more = local.ok() && reader->Read(&message)) {
    local = receiver.Take(message);
    if (warnings != nullptr) {
      warnings->insert(warnings->end(),
                       message.warnings().begin(),
                       message.warnings().end());
    }
    if (!local.ok()) context.TryCancel();
  }
  const absl::Status remote = FromGrpc(reader->Finish());
  RETURN_IF_ERROR(local);
  RETURN_IF_ERROR(remote);
  RETURN_IF_ERROR(receiver.Finish());
  return PlaceExport(root, format, target);
}

}  // namespace groundlock::sdk
