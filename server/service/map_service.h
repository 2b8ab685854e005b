// SPDX-License-Identifier: Apache-2.0
// groundlock.v1.MapService over a store.
#ifndef GROUNDLOCK_SERVER_SERVICE_MAP_SERVICE_H_
#define GROUNDLOCK_SERVER_SERVICE_MAP_SERVICE_H_

#include <atomic>

#include "groundlock/v1/maps.pb.h"
#include "map_store/storage/store.h"
#include "server/service/build_stream.h"
#include "server/service/gate.h"
#include "server/service/import_stream.h"
#include "server/service/options.h"
#include "server/service/scratch_space.h"

namespace groundlock::service {

class MapService final : public GatedService {
 public:
  // import.num_uploads is filled in here.
  //   opening  opens maps, and reads them for viewers.
  MapService(const ImportContext& import,
             const Gate& gate,
             BackgroundExecutor* builds,
             BackgroundExecutor* opening);

 private:
  template <typename Request, typename Response>
  using Call = UnaryCall<Request, Response>;

  void ListMaps(Call<groundlock::v1::ListMapsRequest,
                     groundlock::v1::ListMapsResponse>& call);
  void GetMap(Call<groundlock::v1::GetMapRequest,
                   groundlock::v1::GetMapResponse>& call);
  void DeleteMap(Call<groundlock::v1::DeleteMapRequest,
                      groundlock::v1::DeleteMapResponse>& call);
  void AlignMap(Call<groundlock::v1::AlignMapRequest,
                     groundlock::v1::AlignMapResponse>& call);
  void CheckMap(Call<groundlock::v1::CheckMapRequest,
                     groundlock::v1::CheckMapResponse>& call);

  absl::Status DoAlignMap(const grpc::CallbackServerContext& context,
                          const Caller& caller,
                          const groundlock::v1::AlignMapRequest& request,
                          groundlock::v1::AlignMapResponse* response);
  absl::Status DoCheckMap(storage::Store& store,
                          const groundlock::v1::CheckMapRequest& request,
                          groundlock::v1::CheckMapResponse* response);
  absl::Status DoListMaps(storage::Store& store,
                          const groundlock::v1::ListMapsRequest& request,
                          groundlock::v1::ListMapsResponse* response);

  std::atomic<int> num_uploads_{0};
  std::atomic<int> num_builds_{0};
  std::atomic<int> num_exports_{0};
  ImportContext import_;
  BackgroundExecutor* const builds_;
  BackgroundExecutor* const opening_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_MAP_SERVICE_H_
