// SPDX-License-Identifier: Apache-2.0
// groundlock.v1.TrackingService: converts, enqueues, replies.
#ifndef GROUNDLOCK_SERVER_SERVICE_TRACKING_SERVICE_H_
#define GROUNDLOCK_SERVER_SERVICE_TRACKING_SERVICE_H_

#include "groundlock/v1/tracking.grpc.pb.h"
#include "map_store/storage/store.h"
#include "server/service/access.h"
#include "server/service/background_executor.h"
#include "server/service/metrics.h"
#include "server/service/options.h"
#include "server/service/session_manager.h"

namespace groundlock::service {

// Where calls that take a while run, so that gRPC's threads never wait.
struct Executors {
  BackgroundExecutor* disk;   // short: catalogue, files
  BackgroundExecutor* heavy;  // long: imports, exports, single images
};

class TrackingService final
    : public groundlock::v1::TrackingService::CallbackService {
 public:
  // Everything pointed to must outlive the service.
  TrackingService(const ServerOptions& options,
                  SessionManager* sessions,
                  storage::Store* store,
                  const Executors& executors,
                  const Access* access,
                  Metrics* metrics);

  grpc::ServerUnaryReactor* CreateSession(
      grpc::CallbackServerContext* context,
      const groundlock::v1::CreateSessionRequest* request,
      groundlock::v1::CreateSessionResponse* response) override;
  grpc::ServerUnaryReactor* ListSessions(
      grpc::CallbackServerContext* context,
      const groundlock::v1::ListSessionsRequest* request,
      groundlock::v1::ListSessionsResponse* response) override;
  grpc::ServerUnaryReactor* GetSession(
      grpc::CallbackServerContext* context,
      const groundlock::v1::GetSessionRequest* request,
      groundlock::v1::GetSessionResponse* response) override;
  grpc::ServerUnaryReactor* DeleteSession(
      grpc::CallbackServerContext* context,
      const groundlock::v1::DeleteSessionRequest* request,
      groundlock::v1::DeleteSessionResponse* response) override;
  grpc::ServerUnaryReactor* SetTarget(
      grpc::CallbackServerContext* context,
      const groundlock::v1::SetTargetRequest* request,
      groundlock::v1::SetTargetResponse* response) override;
  grpc::ServerUnaryReactor* MoveTarget(
      grpc::CallbackServerContext* context,
      const groundlock::v1::MoveTargetRequest* request,
      groundlock::v1::MoveTargetResponse* response) override;
  grpc::ServerUnaryReactor* DropTarget(
      grpc::CallbackServerContext* context,
      const groundlock::v1::DropTargetRequest* request,
      groundlock::v1::DropTargetResponse* response) override;
  grpc::ServerBidiReactor<groundlock::v1::TrackRequest,
                          groundlock::v1::TrackResponse>*
  Track(grpc::CallbackServerContext* context) override;
  grpc::ServerWriteReactor<groundlock::v1::WatchSessionResponse>* WatchSession(
      grpc::CallbackServerContext* context,
      const groundlock::v1::WatchSessionRequest* request) override;
  grpc::ServerUnaryReactor* Localize(
      grpc::CallbackServerContext* context,
      const groundlock::v1::LocalizeRequest* request,
      groundlock::v1::LocalizeResponse* response) override;

 private:
  absl::Status DoCreateSession(
      const groundlock::v1::CreateSessionRequest& request,
      groundlock::v1::CreateSessionResponse* response);
  absl::Status DoLocalize(const groundlock::v1::LocalizeRequest& request,
                          groundlock::v1::LocalizeResponse* response);

  const ServerOptions options_;
  SessionManager* const sessions_;
  storage::Store* const store_;
  const Executors executors_;
  const Access* const access_;
  Metrics* const metrics_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_TRACKING_SERVICE_H_
