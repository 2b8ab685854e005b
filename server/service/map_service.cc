// SPDX-License-Identifier: Apache-2.0
#include "server/service/map_service.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "map_store/base/status.h"
#include "map_store/map/alignment.h"
#include "map_store/map/ground_relief.h"
#include "server/service/convert.h"
#include "server/service/map_download.h"
#include "server/service/producing_stream.h"
#include "server/service/tenant_store.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {

MapService::MapService(const ImportContext& import,
                       const Gate& gate,
                       BackgroundExecutor* builds,
                       BackgroundExecutor* opening)
    : GatedService("groundlock.v1.MapService", gate),
      import_(import),
      builds_(builds),
      opening_(opening) {
  import_.num_uploads = &num_uploads_;
  import_.calls = gate.calls;
  import_.silence = gate.silence;
  AddUnary("ListMaps", this, &MapService::ListMaps);
  AddUnary("GetMap", this, &MapService::GetMap);
  AddUnary("DeleteMap", this, &MapService::DeleteMap);
  AddUnary("AlignMap", this, &MapService::AlignMap);
  AddUnary("CheckMap", this, &MapService::CheckMap);
  AddUpload<pb::ImportMapRequest, pb::ImportMapResponse>(
      "ImportMap",
      [this](grpc::CallbackServerContext* context,
             const CallerPtr& caller,
             pb::ImportMapResponse* response) {
        return ImportStream::Start(import_, context, caller, response);
      });
  AddStream<pb::BuildMapRequest, pb::BuildMapResponse>(
      "BuildMap",
      [this](grpc::CallbackServerContext* context, const CallTerms& terms) {
        return BuildStream::Start(
            {import_, builds_, &num_builds_}, context, terms.caller);
      });
  AddStream<pb::GetPointCloudRequest, pb::GetPointCloudResponse>(
      "GetPointCloud",
      [this](grpc::CallbackServerContext* context, const CallTerms& terms) {
        using Stream = ProducingStream<pb::GetPointCloudRequest,
                                       pb::GetPointCloudResponse>;
        return Stream::Start(
            context,
            terms,
            [](const Caller& caller, const pb::GetPointCloudRequest& request) {
              return [producer = std::make_shared<PointCloudProducer>(
                          caller.maps.get(), request)](
                         pb::GetPointCloudResponse& out) {
                return producer->Next(out);
              };
            },
            opening_,
            opening_);
      });
  AddStream<pb::ExportMapRequest, pb::ExportMapResponse>(
      "ExportMap",
      [this](grpc::CallbackServerContext* context, const CallTerms& terms) {
        using Stream =
            ProducingStream<pb::ExportMapRequest, pb::ExportMapResponse>;
        return Stream::Start(
            context,
            terms,
            [this](const Caller& caller, const pb::ExportMapRequest& request) {
              return [producer = std::make_shared<ExportProducer>(
                          caller.maps.get(),
                          import_.scratch,
                          request,
                          &num_exports_,
                          import_.limits.max_concurrent_exports)](
                         pb::ExportMapResponse& out) {
                return producer->Next(out);
              };
            },
            import_.heavy,
            import_.disk);
      });
}

void MapService::ListMaps(
    Call<pb::ListMapsRequest, pb::ListMapsResponse>& call) {
  call.ReplyFrom(import_.disk, [this, &call] {
    return DoListMaps(*call.caller().maps, call.request(), &call.response());
  });
}

absl::Status MapService::DoListMaps(storage::Store& store,
                                    const pb::ListMapsRequest& request,
                                    pb::ListMapsResponse* response) {
  ASSIGN_OR_RETURN(const int size, PageSize(request.page_size()));
  ASSIGN_OR_RETURN(const auto maps, store.List());
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

void MapService::GetMap(Call<pb::GetMapRequest, pb::GetMapResponse>& call) {
  call.ReplyFrom(import_.disk, [&call]() -> absl::Status {
    const pb::GetMapRequest& request = call.request();
    storage::Store& store = *call.caller().maps;
    RETURN_IF_ERROR(
        base::Annotate(storage::ValidateMapName(request.name()), "name"));
    ASSIGN_OR_RETURN(storage::MapVersion map,
                     store.Get(request.name(), request.version()));
    if (!map.info.lens) {
      // Rows that older programs wrote do not have it; the file does.
      const auto opened = store.Open(map.name, map.version);
      if (opened.ok()) map.info.lens = (*opened)->info().lens;
    }
    ToProto(map, call.response().mutable_map());
    return absl::OkStatus();
  });
}

void MapService::DeleteMap(
    Call<pb::DeleteMapRequest, pb::DeleteMapResponse>& call) {
  call.ReplyFrom(import_.disk, [&call]() -> absl::Status {
    const std::string& name = call.request().name();
    RETURN_IF_ERROR(base::Annotate(storage::ValidateMapName(name), "name"));
    RETURN_IF_ERROR(call.caller().maps->Delete(name));
    spdlog::info("map {}: deleted",
                 NameOfTenant(call.caller().principal->tenant, name));
    return absl::OkStatus();
  });
}

void MapService::AlignMap(
    Call<pb::AlignMapRequest, pb::AlignMapResponse>& call) {
  call.ReplyFrom(import_.heavy, [this, &call] {
    return DoAlignMap(
        call.context(), call.caller(), call.request(), &call.response());
  });
}

absl::Status MapService::DoAlignMap(const grpc::CallbackServerContext& context,
                                    const Caller& caller,
                                    const pb::AlignMapRequest& request,
                                    pb::AlignMapResponse* response) {
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(request.name()), "name"));
  ASSIGN_OR_RETURN(const map::AlignmentRequest alignment, FromProto(request));
  ASSIGN_OR_RETURN(storage::MapVersion version,
                   caller.maps->Get(request.name(), request.version()));
  ASSIGN_OR_RETURN(const auto source,
                   caller.maps->Open(request.name(), version.version));
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
    version.info.ground_height_sigma = data.ground_height_sigma;
    version.info.ground_relief_given = !data.given_relief.empty();
    version.info.ground_relief_m =
        (version.info.ground_relief_given ? data.given_relief
                                          : map::EstimateGroundRelief(data))
            .Range();
    version.info.origin = data.origin;
  } else {
    ASSIGN_OR_RETURN(version,
                     caller.maps->Publish(request.name(), data, [&context] {
                       return context.IsCancelled()
                                  ? absl::CancelledError("the client has gone")
                                  : absl::OkStatus();
                     }));
    spdlog::info("map {} version {}: aligned",
                 NameOfTenant(caller.principal->tenant, version.name),
                 version.version);
  }
  ToProto(version, response->mutable_map());
  return absl::OkStatus();
}

void MapService::CheckMap(
    Call<pb::CheckMapRequest, pb::CheckMapResponse>& call) {
  call.ReplyFrom(import_.heavy, [this, &call] {
    return DoCheckMap(*call.caller().maps, call.request(), &call.response());
  });
}

absl::Status MapService::DoCheckMap(storage::Store& store,
                                    const pb::CheckMapRequest& request,
                                    pb::CheckMapResponse* response) {
  RETURN_IF_ERROR(
      base::Annotate(storage::ValidateMapName(request.name()), "name"));
  ASSIGN_OR_RETURN(const storage::MapVersion version,
                   store.Get(request.name(), request.version()));
  ToProto(version, response->mutable_map());
  absl::Status status = store.Check(request.name(), version.version);
  if (status.ok()) {
    const auto opened = store.Open(request.name(), version.version);
    status = opened.ok() ? (*opened)->Verify() : opened.status();
  }
  if (absl::IsDataLoss(status) || absl::IsUnimplemented(status)) {
    response->add_problems(std::string(status.message()));
    return absl::OkStatus();
  }
  return status;
}

}  // namespace groundlock::service
