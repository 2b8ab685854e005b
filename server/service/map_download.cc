// SPDX-License-Identifier: Apache-2.0
#include "server/service/map_download.h"

#include <algorithm>
#include <string>
#include <utility>

#include "map_store/base/status.h"
#include "map_store/formats/formats.h"
#include "server/service/convert.h"

namespace groundlock::service {
namespace {

namespace fs = std::filesystem;

// Blocks of some hundred kilobytes: far below gRPC's default limit of 4 MiB,
// large enough for the cost per message not to count.
constexpr std::uint64_t kBlockPoints = 20'000;
constexpr std::uint64_t kBlockViews = 2'000;
constexpr std::uint64_t kChunkBytes = 256 << 10;

}  // namespace

PointCloudProducer::PointCloudProducer(storage::Store* store,
                                       pb::GetPointCloudRequest request)
    : store_(store), request_(std::move(request)) {}

absl::StatusOr<bool> PointCloudProducer::Next(pb::GetPointCloudResponse& out) {
  const bool first = map_ == nullptr;
  if (first) {
    RETURN_IF_ERROR(
        base::Annotate(storage::ValidateMapName(request_.name()), "name"));
    ASSIGN_OR_RETURN(map_, store_->Open(request_.name(), request_.version()));
    total_points_ = map_->landmarks().size();
    if (request_.max_points() != 0) {
      total_points_ =
          std::min<std::uint64_t>(total_points_, request_.max_points());
    }
  }
  if (!first && next_point_ == total_points_ &&
      next_view_ == map_->num_views()) {
    return false;
  }
  out.set_total_points(total_points_);
  const auto landmarks = map_->landmarks();
  const std::uint64_t end = std::min(total_points_, next_point_ + kBlockPoints);
  for (; next_point_ < end; ++next_point_) {
    // Even over the whole map; in double, as the product may exceed 64 bits.
    const auto index = std::min<std::uint64_t>(
        landmarks.size() - 1,
        static_cast<std::uint64_t>(static_cast<double>(next_point_) *
                                   static_cast<double>(landmarks.size()) /
                                   static_cast<double>(total_points_)));
    const map::Landmark& landmark = landmarks[index];
    for (const double coordinate : landmark.p_world) {
      out.add_xyz_m(static_cast<float>(coordinate));
    }
    out.mutable_rgb()->append(reinterpret_cast<const char*>(landmark.rgb), 3);
  }
  const std::uint64_t views_end =
      std::min<std::uint64_t>(map_->num_views(), next_view_ + kBlockViews);
  for (; next_view_ < views_end; ++next_view_) {
    const map::MapView& view = map_->view(next_view_);
    pb::GetPointCloudResponse::MapCamera* camera = out.add_cameras();
    camera->set_name(std::string(view.name));
    ToProto(map_->camera(view.camera), camera->mutable_camera());
    ToProto(view.camera_from_world.Inverse(),
            camera->mutable_world_from_camera());
  }
  return true;
}

ExportProducer::ExportProducer(storage::Store* store,
                               const ScratchSpace* scratch,
                               pb::ExportMapRequest request,
                               std::atomic<int>* num_exports,
                               int max_exports)
    : store_(store),
      scratch_(scratch),
      request_(std::move(request)),
      num_exports_(num_exports),
      place_(++*num_exports <= max_exports
                 ? absl::OkStatus()
                 : absl::ResourceExhaustedError(
                       absl::StrCat("the server makes ",
                                    max_exports,
                                    " exports at a time; try again later"))) {}

absl::Status ExportProducer::Export() {
  RETURN_IF_ERROR(place_);
  ASSIGN_OR_RETURN(const auto format, FromProto(request_.format(), "format"));
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(request_.name()), "name"));
  ASSIGN_OR_RETURN(const auto map,
                   store_->Open(request_.name(), request_.version()));
  ASSIGN_OR_RETURN(directory_, scratch_->Create());
  const bool folder = format == formats::ExportFormat::kColmapBinary ||
                      format == formats::ExportFormat::kColmapText;
  const std::string name =
      format == formats::ExportFormat::kNvm ? "map.nvm" : "map.single";
  const fs::path target = directory_->path() / (folder ? "map" : name);
  RETURN_IF_ERROR(formats::Export(map->ToData(), format, target, &warnings_));
  root_ = folder ? target : directory_->path();
  for (const auto& entry : fs::recursive_directory_iterator(root_)) {
    if (entry.is_regular_file()) files_.push_back(entry.path());
  }
  std::sort(files_.begin(), files_.end());
  return absl::OkStatus();
}

absl::StatusOr<bool> ExportProducer::Next(pb::ExportMapResponse& out) {
  if (directory_ == nullptr) RETURN_IF_ERROR(Export());
  if (missing_bytes_ > 0) {
    std::string chunk(std::min(missing_bytes_, kChunkBytes), '\0');
    if (!file_.read(chunk.data(), static_cast<std::streamsize>(chunk.size()))) {
      return absl::InternalError("cannot read an exported file");
    }
    missing_bytes_ -= chunk.size();
    out.set_chunk(std::move(chunk));
    return true;
  }
  if (next_file_ == files_.size()) return false;
  const fs::path& path = files_[next_file_++];
  file_ = std::ifstream(path, std::ios::binary);
  missing_bytes_ = fs::file_size(path);
  // A format that is one file has no name of its own: the client chose one.
  const bool single = files_.size() == 1 && root_ == directory_->path();
  out.mutable_file_start()->set_path(
      single ? "" : path.lexically_relative(root_).generic_string());
  out.mutable_file_start()->set_size_bytes(missing_bytes_);
  for (std::string& warning : warnings_) out.add_warnings(std::move(warning));
  warnings_.clear();
  return true;
}

}  // namespace groundlock::service
