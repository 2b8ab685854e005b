// SPDX-License-Identifier: Apache-2.0
// groundlock.v1.TrackingService: converts, enqueues, replies.
#ifndef GROUNDLOCK_SERVER_SERVICE_TRACKING_SERVICE_H_
#define GROUNDLOCK_SERVER_SERVICE_TRACKING_SERVICE_H_

#include <atomic>
#include <cstdint>

#include "groundlock/v1/tracking.pb.h"
#include "map_store/storage/store.h"
#include "server/service/background_executor.h"
#include "server/service/gate.h"
#include "server/service/metrics.h"
#include "server/service/options.h"
#include "server/service/session_manager.h"

namespace groundlock::service {

// Where calls that take a while run, so that gRPC's threads never wait.
struct Executors {
  BackgroundExecutor* disk;     // short: catalogue, files
  BackgroundExecutor* opening;  // waits: maps that are opened
  BackgroundExecutor* heavy;    // long: imports, exports, single images
};

class TrackingService final : public GatedService {
 public:
  // Everything pointed to must outlive the service.
  TrackingService(const ServerOptions& options,
                  const Gate& gate,
                  SessionManager* sessions,
                  const Executors& executors,
                  Metrics* metrics);

 private:
  template <typename Request, typename Response>
  using Call = UnaryCall<Request, Response>;

  void CreateSession(Call<groundlock::v1::CreateSessionRequest,
                          groundlock::v1::CreateSessionResponse>& call);
  void ListSessions(Call<groundlock::v1::ListSessionsRequest,
                         groundlock::v1::ListSessionsResponse>& call);
  void GetSession(Call<groundlock::v1::GetSessionRequest,
                       groundlock::v1::GetSessionResponse>& call);
  void DeleteSession(Call<groundlock::v1::DeleteSessionRequest,
                          groundlock::v1::DeleteSessionResponse>& call);
  void SetTarget(Call<groundlock::v1::SetTargetRequest,
                      groundlock::v1::SetTargetResponse>& call);
  void MoveTarget(Call<groundlock::v1::MoveTargetRequest,
                       groundlock::v1::MoveTargetResponse>& call);
  void DropTarget(Call<groundlock::v1::DropTargetRequest,
                       groundlock::v1::DropTargetResponse>& call);
  void Localize(Call<groundlock::v1::LocalizeRequest,
                     groundlock::v1::LocalizeResponse>& call);
  void GetCaller(Call<groundlock::v1::GetCallerRequest,
                      groundlock::v1::GetCallerResponse>& call);

  absl::Status DoSetTarget(Call<groundlock::v1::SetTargetRequest,
                                groundlock::v1::SetTargetResponse>& call);
  absl::Status DoLocalize(storage::Store& maps,
                          const groundlock::v1::LocalizeRequest& request,
                          groundlock::v1::LocalizeResponse* response);

  const ServerOptions options_;
  SessionManager* const sessions_;
  const Executors executors_;
  Metrics* const metrics_;
  // Of the images that wait for Localize.
  std::atomic<std::int64_t> waiting_image_bytes_{0};
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_TRACKING_SERVICE_H_
