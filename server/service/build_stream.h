// SPDX-License-Identifier: Apache-2.0
// One BuildMap call: upload, build, publish; progress meanwhile.
#ifndef GROUNDLOCK_SERVER_SERVICE_BUILD_STREAM_H_
#define GROUNDLOCK_SERVER_SERVICE_BUILD_STREAM_H_

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "groundlock/v1/maps.pb.h"
#include "map_store/base/mutex.h"
#include "map_store/build/build.h"
#include "server/service/background_executor.h"
#include "server/service/import_stream.h"
#include "server/service/map_upload.h"
#include "server/service/scratch_space.h"

namespace groundlock::service {

// What builds share. Everything pointed to outlives them.
struct BuildContext {
  // Takes the files in and publishes; `heavy` is not used.
  ImportContext import;
  // Builds take minutes: on the heavy executor, single images would wait.
  BackgroundExecutor* builds = nullptr;
  std::atomic<int>* num_builds = nullptr;
};

// Owns itself until gRPC's last callback. Up to the client's half-close either
// gRPC or an executor has it. Then the build and gRPC's writes run side by
// side; what both touch is guarded. A client that reads slowly misses progress,
// never the result.
class BuildStream final
    : public grpc::ServerBidiReactor<groundlock::v1::BuildMapRequest,
                                     groundlock::v1::BuildMapResponse>,
      public WatchedCall {
 public:
  static BuildStream* Start(const BuildContext& build,
                            grpc::CallbackServerContext* context,
                            const CallerPtr& caller);

  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnCancel() override { cancelled_ = true; }
  void OnDone() override;
  void OnTick(std::chrono::steady_clock::time_point now) override;

 private:
  BuildStream(const BuildContext& build,
              grpc::CallbackServerContext* context,
              CallerPtr caller);

  void Read();
  // The same once the caller's quota allows it.
  void ReadNext();
  void HandleMessage();
  void HandleEnd();
  absl::Status Store(const groundlock::v1::BuildMapRequest& message);
  absl::Status CheckHeader() const;
  absl::StatusOr<build::BuildOptions> Options() const;
  // Fills the result's message.
  absl::Status Build(groundlock::v1::BuildMapResponse* result);
  absl::Status CheckAlive() const;
  std::string Anonymized(std::string_view message) const;
  // After these `this` may be gone.
  void FinishWith(const absl::Status& status,
                  groundlock::v1::BuildMapResponse* result = nullptr);
  // What gRPC is asked next; whoever finds a write under way leaves that to its
  // end.
  struct Step {
    bool writes = false;
    std::optional<absl::Status> end;
  };
  Step NextStep() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Touches nothing of `this` if there is no step.
  void Take(const Step& step);
  void Tell(const build::BuildProgress& progress) ABSL_LOCKS_EXCLUDED(mutex_);

  const BuildContext build_;
  grpc::CallbackServerContext* const context_;
  const CallerPtr caller_;
  groundlock::v1::BuildMapRequest request_;
  ReadDeadline read_;
  ReadDeadline farewell_;  // from the end on
  groundlock::v1::BuildMapRequest::Header header_;
  std::unique_ptr<MapUpload> upload_;       // from the header on
  std::shared_ptr<void> place_;             // what the caller's account gave
  std::unique_ptr<ScratchDirectory> work_;  // while it builds
  // When the build has to be over.
  std::chrono::steady_clock::time_point build_end_ =
      std::chrono::steady_clock::time_point::max();
  std::atomic<bool> cancelled_{false};
  std::atomic<bool> paused_{false};  // until the quota has recovered

  base::Mutex mutex_;
  groundlock::v1::BuildMapResponse written_;  // gRPC's while is_writing_
  bool is_writing_ ABSL_GUARDED_BY(mutex_) = false;
  std::optional<groundlock::v1::BuildMapResponse> progress_
      ABSL_GUARDED_BY(mutex_);  // the newest
  std::optional<groundlock::v1::BuildMapResponse> result_
      ABSL_GUARDED_BY(mutex_);
  std::optional<absl::Status> end_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_BUILD_STREAM_H_
