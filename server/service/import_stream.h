// SPDX-License-Identifier: Apache-2.0
// One ImportMap call: upload, import, publish.
#ifndef GROUNDLOCK_SERVER_SERVICE_IMPORT_STREAM_H_
#define GROUNDLOCK_SERVER_SERVICE_IMPORT_STREAM_H_

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <atomic>
#include <chrono>
#include <memory>

#include "absl/status/status.h"
#include "groundlock/v1/maps.pb.h"
#include "map_store/storage/store.h"
#include "server/service/account.h"
#include "server/service/background_executor.h"
#include "server/service/call_watch.h"
#include "server/service/caller.h"
#include "server/service/map_upload.h"
#include "server/service/metrics.h"
#include "server/service/options.h"
#include "server/service/scratch_space.h"

namespace groundlock::service {

// What imports share. Everything pointed to outlives them.
struct ImportContext {
  MapLimits limits;
  const ScratchSpace* scratch = nullptr;
  BackgroundExecutor* disk = nullptr;
  BackgroundExecutor* heavy = nullptr;
  Metrics* metrics = nullptr;
  std::atomic<int>* num_uploads = nullptr;
  CallWatch* calls = nullptr;
  // How long a client may be silent (ReadDeadline).
  std::chrono::nanoseconds silence{0};
};

// Owns itself until gRPC's last callback. The next message is read when the
// last one is on the disk, so at any time either gRPC or an executor has it,
// and nothing needs a lock. A client that is silent for too long is let go.
class ImportStream final
    : public grpc::ServerReadReactor<groundlock::v1::ImportMapRequest>,
      public WatchedCall {
 public:
  static ImportStream* Start(const ImportContext& import,
                             grpc::CallbackServerContext* context,
                             const CallerPtr& caller,
                             groundlock::v1::ImportMapResponse* response);

  void OnReadDone(bool ok) override;
  void OnCancel() override { cancelled_ = true; }
  void OnDone() override;
  void OnTick(std::chrono::steady_clock::time_point now) override;

 private:
  ImportStream(const ImportContext& import,
               grpc::CallbackServerContext* context,
               CallerPtr caller,
               groundlock::v1::ImportMapResponse* response);

  void Read();
  // The same once the caller's quota allows it.
  void ReadNext();
  void HandleMessage();
  void HandleEnd();
  absl::Status Store(const groundlock::v1::ImportMapRequest& message);
  absl::Status CheckHeader() const;
  absl::Status Import();
  absl::Status CheckAlive() const;
  void FinishWith(const absl::Status& status);

  const ImportContext import_;
  grpc::CallbackServerContext* const context_;
  const CallerPtr caller_;
  groundlock::v1::ImportMapResponse* const response_;
  groundlock::v1::ImportMapRequest request_;
  ReadDeadline read_;
  ReadDeadline farewell_;  // from the end on
  groundlock::v1::ImportMapRequest::Header header_;
  std::unique_ptr<MapUpload> upload_;  // from the header on
  // When the import has to be over.
  std::chrono::steady_clock::time_point import_end_ =
      std::chrono::steady_clock::time_point::max();
  std::atomic<bool> cancelled_{false};
  std::atomic<bool> paused_{false};  // until the quota has recovered
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_IMPORT_STREAM_H_
