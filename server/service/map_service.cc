// SPDX-License-Identifier: Apache-2.0
#include "server/service/map_service.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "map_store/base/status.h"
#include "map_store/map/alignment.h"
#include "server/service/access.h"
#include "server/service/convert.h"
#include "server/service/map_download.h"
#include "server/service/producing_stream.h"
#include "server/service/unary.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {

MapService::MapService(const ImportContext& import,
                       BackgroundExecutor* builds,
                       const Access* access)
    : import_(import), builds_(builds), access_(access) {
  import_.num_uploads = &num_uploads_;
}

grpc::ServerReadReactor<pb::ImportMapRequest>* MapService::ImportMap(
    grpc::CallbackServerContext* context, pb::ImportMapResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Refuse<grpc::ServerReadReactor<pb::ImportMapRequest>>(status);
  }
  return ImportStream::Start(import_, context, response);
}

grpc::ServerBidiReactor<pb::BuildMapRequest, pb::BuildMapResponse>*
MapService::BuildMap(grpc::CallbackServerContext* context) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Refuse<
        grpc::ServerBidiReactor<pb::BuildMapRequest, pb::BuildMapResponse>>(
        status);
  }
  return BuildStream::Start({import_, builds_, &num_builds_}, context);
}

grpc::ServerUnaryReactor* MapService::ListMaps(
    grpc::CallbackServerContext* context,
    const pb::ListMapsRequest* request,
    pb::ListMapsResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return ReplyFrom(import_.disk, context, [this, request, response] {
    return DoListMaps(*request, response);
  });
}

absl::Status MapService::DoListMaps(const pb::ListMapsRequest& request,
                                    pb::ListMapsResponse* response) {
  ASSIGN_OR_RETURN(const int size, PageSize(request.page_size()));
  ASSIGN_OR_RETURN(const auto maps, import_.store->List());
  auto it = std::upper_bound(
      maps.begin(),
      maps.end(),
      request.page_token(),
      [](const std::string& after, const storage::MapVersion& map) {
        return after < map.name;
      });
  for (; it != maps.end() && response->maps_size() < size; ++it) {
    ToProto(*it, response->add_maps());
  }
  if (it != maps.end()) {
    response->set_next_page_token(response->maps(size - 1).name());
  }
  return absl::OkStatus();
}

grpc::ServerUnaryReactor* MapService::GetMap(
    grpc::CallbackServerContext* context,
    const pb::GetMapRequest* request,
    pb::GetMapResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return ReplyFrom(import_.disk, context, [this, request, response] {
    RETURN_IF_ERROR(
        base::Annotate(storage::ValidateMapName(request->name()), "name"));
    ASSIGN_OR_RETURN(storage::MapVersion map,
                     import_.store->Get(request->name(), request->version()));
    if (!map.info.lens) {
      // Rows that older programs wrote do not have it; the file does.
      const auto opened = import_.store->Open(map.name, map.version);
      if (opened.ok()) map.info.lens = (*opened)->info().lens;
    }
    ToProto(map, response->mutable_map());
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* MapService::DeleteMap(
    grpc::CallbackServerContext* context,
    const pb::DeleteMapRequest* request,
    pb::DeleteMapResponse* /*response*/) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return ReplyFrom(import_.disk, context, [this, request] {
    RETURN_IF_ERROR(
        base::Annotate(storage::ValidateMapName(request->name()), "name"));
    RETURN_IF_ERROR(import_.store->Delete(request->name()));
    spdlog::info("map {}: deleted", request->name());
    return absl::OkStatus();
  });
}

grpc::ServerWriteReactor<pb::GetPointCloudResponse>* MapService::GetPointCloud(
    grpc::CallbackServerContext* context,
    const pb::GetPointCloudRequest* request) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Refuse<grpc::ServerWriteReactor<pb::GetPointCloudResponse>>(status);
  }
  auto producer = std::make_shared<PointCloudProducer>(import_.store, *request);
  return ProducingStream<pb::GetPointCloudResponse>::Start(
      [producer](pb::GetPointCloudResponse& out) {
        return producer->Next(out);
      },
      import_.disk,
      import_.disk);
}

grpc::ServerWriteReactor<pb::ExportMapResponse>* MapService::ExportMap(
    grpc::CallbackServerContext* context, const pb::ExportMapRequest* request) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Refuse<grpc::ServerWriteReactor<pb::ExportMapResponse>>(status);
  }
  auto producer = std::make_shared<ExportProducer>(
      import_.store, import_.scratch, *request);
  return ProducingStream<pb::ExportMapResponse>::Start(
      [producer](pb::ExportMapResponse& out) { return producer->Next(out); },
      import_.heavy,
      import_.disk);
}

grpc::ServerUnaryReactor* MapService::AlignMap(
    grpc::CallbackServerContext* context,
    const pb::AlignMapRequest* request,
    pb::AlignMapResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return ReplyFrom(import_.heavy, context, [this, context, request, response] {
    return DoAlignMap(*context, *request, response);
  });
}

absl::Status MapService::DoAlignMap(const grpc::CallbackServerContext& context,
                                    const pb::AlignMapRequest& request,
                                    pb::AlignMapResponse* response) {
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(request.name()), "name"));
  ASSIGN_OR_RETURN(const map::AlignmentRequest alignment, FromProto(request));
  ASSIGN_OR_RETURN(storage::MapVersion version,
                   import_.store->Get(request.name(), request.version()));
  ASSIGN_OR_RETURN(const auto source,
                   import_.store->Open(request.name(), version.version));
  map::MapData data = source->ToData();
  ASSIGN_OR_RETURN(const map::AlignmentReport report,
                   map::AlignMap(alignment, data));
  ToProto(report, response);
  if (request.report_only()) {
    version.info.metric = data.metric;
    version.info.world_from_source = data.world_from_source;
    version.info.ground_world = data.ground;
    version.info.ground_state = data.ground_state;
    version.info.ground_sigma_rad = data.ground_sigma_rad;
    version.info.origin = data.origin;
  } else {
    ASSIGN_OR_RETURN(version,
                     import_.store->Publish(request.name(), data, [&context] {
                       return context.IsCancelled()
                                  ? absl::CancelledError("the client has gone")
                                  : absl::OkStatus();
                     }));
    spdlog::info("map {} version {}: aligned", version.name, version.version);
  }
  ToProto(version, response->mutable_map());
  return absl::OkStatus();
}

grpc::ServerUnaryReactor* MapService::CheckMap(
    grpc::CallbackServerContext* context,
    const pb::CheckMapRequest* request,
    pb::CheckMapResponse* response) {
  if (const absl::Status status = access_->Check(*context); !status.ok()) {
    return Reply(context, status);
  }
  return ReplyFrom(import_.heavy, context, [this, request, response] {
    return DoCheckMap(*request, response);
  });
}

absl::Status MapService::DoCheckMap(const pb::CheckMapRequest& request,
                                    pb::CheckMapResponse* response) {
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(request.name()), "name"));
  ASSIGN_OR_RETURN(const storage::MapVersion version,
                   import_.store->Get(request.name(), request.version()));
  ToProto(version, response->mutable_map());
  absl::Status status = import_.store->Check(request.name(), version.version);
  if (status.ok()) {
    const auto opened = import_.store->Open(request.name(), version.version);
    status = opened.ok() ? (*opened)->Verify() : opened.status();
  }
  if (absl::IsDataLoss(status) || absl::IsUnimplemented(status)) {
    response->add_problems(std::string(status.message()));
    return absl::OkStatus();
  }
  return status;
}

}  // namespace groundlock::service
