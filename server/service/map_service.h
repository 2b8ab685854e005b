// SPDX-License-Identifier: Apache-2.0
// groundlock.v1.MapService over a store.
#ifndef GROUNDLOCK_SERVER_SERVICE_MAP_SERVICE_H_
#define GROUNDLOCK_SERVER_SERVICE_MAP_SERVICE_H_

#include <atomic>

#include "groundlock/v1/maps.grpc.pb.h"
#include "map_store/storage/store.h"
#include "server/service/access.h"
#include "server/service/build_stream.h"
#include "server/service/import_stream.h"
#include "server/service/options.h"
#include "server/service/scratch_space.h"

namespace groundlock::service {

class MapService final : public groundlock::v1::MapService::CallbackService {
 public:
  // import.num_uploads is filled in here.
  MapService(const ImportContext& import,
             BackgroundExecutor* builds,
             const Access* access);

  grpc::ServerReadReactor<groundlock::v1::ImportMapRequest>* ImportMap(
      grpc::CallbackServerContext* context,
      groundlock::v1::ImportMapResponse* response) override;
  grpc::ServerBidiReactor<groundlock::v1::BuildMapRequest,
                          groundlock::v1::BuildMapResponse>*
  BuildMap(grpc::CallbackServerContext* context) override;
  grpc::ServerUnaryReactor* ListMaps(
      grpc::CallbackServerContext* context,
      const groundlock::v1::ListMapsRequest* request,
      groundlock::v1::ListMapsResponse* response) override;
  grpc::ServerUnaryReactor* GetMap(
      grpc::CallbackServerContext* context,
      const groundlock::v1::GetMapRequest* request,
      groundlock::v1::GetMapResponse* response) override;
  grpc::ServerUnaryReactor* DeleteMap(
      grpc::CallbackServerContext* context,
      const groundlock::v1::DeleteMapRequest* request,
      groundlock::v1::DeleteMapResponse* response) override;
  grpc::ServerWriteReactor<groundlock::v1::GetPointCloudResponse>*
  GetPointCloud(grpc::CallbackServerContext* context,
                const groundlock::v1::GetPointCloudRequest* request) override;
  grpc::ServerWriteReactor<groundlock::v1::ExportMapResponse>* ExportMap(
      grpc::CallbackServerContext* context,
      const groundlock::v1::ExportMapRequest* request) override;
  grpc::ServerUnaryReactor* AlignMap(
      grpc::CallbackServerContext* context,
      const groundlock::v1::AlignMapRequest* request,
      groundlock::v1::AlignMapResponse* response) override;
  grpc::ServerUnaryReactor* CheckMap(
      grpc::CallbackServerContext* context,
      const groundlock::v1::CheckMapRequest* request,
      groundlock::v1::CheckMapResponse* response) override;

 private:
  absl::Status DoAlignMap(const grpc::CallbackServerContext& context,
                          const groundlock::v1::AlignMapRequest& request,
                          groundlock::v1::AlignMapResponse* response);
  absl::Status DoCheckMap(const groundlock::v1::CheckMapRequest& request,
                          groundlock::v1::CheckMapResponse* response);
  absl::Status DoListMaps(const groundlock::v1::ListMapsRequest& request,
                          groundlock::v1::ListMapsResponse* response);

  std::atomic<int> num_uploads_{0};
  std::atomic<int> num_builds_{0};
  ImportContext import_;
  BackgroundExecutor* const builds_;
  const Access* const access_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_MAP_SERVICE_H_
