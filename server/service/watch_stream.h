// SPDX-License-Identifier: Apache-2.0
// The stream of a session's results to one that looks on.
#ifndef GROUNDLOCK_SERVER_SERVICE_WATCH_STREAM_H_
#define GROUNDLOCK_SERVER_SERVICE_WATCH_STREAM_H_

#include <grpcpp/support/server_callback.h>

#include <cstdint>
#include <deque>
#include <memory>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/mutex.h"
#include "server/service/background_executor.h"
#include "server/service/session.h"
#include "server/service/session_manager.h"
#include "server/service/unary_call.h"

namespace groundlock::service {

// One WatchSession call. Keeps at most two results back: whoever reads slowly
// gets the newest ones and is told how many were left out. Owns itself as
// TrackStream does.
class WatchStream final
    : public grpc::ServerBidiReactor<groundlock::v1::WatchSessionRequest,
                                     groundlock::v1::WatchSessionResponse>,
      public ResultWatcher,
      public WatchedCall,
      public std::enable_shared_from_this<WatchStream> {
 public:
  // executor: encodes raw images.
  static WatchStream* Start(grpc::CallbackServerContext* context,
                            SessionManager* sessions,
                            const CallTerms& terms,
                            BackgroundExecutor* executor,
                            Metrics* metrics);

  // gRPC's side.
  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnCancel() override;
  void OnDone() override;
  void OnTick(std::chrono::steady_clock::time_point now) override;

  // The session's side.
  bool wants_images() const override { return request_.include_images(); }
  void OnAnswer(const std::shared_ptr<const Answer>& answer) override;
  void OnEnd(const absl::Status& reason) override;

 private:
  WatchStream(grpc::CallbackServerContext* context,
              SessionManager* sessions,
              const CallTerms& terms,
              BackgroundExecutor* executor,
              Metrics* metrics);

  absl::Status StartToWatch();
  void Pump() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void FinishNow(const absl::Status& status)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Write();
  // Fills in the image of `response_`, on the executor, and writes it.
  void WriteWithImage(const FrameJob& frame);

  grpc::CallbackServerContext* const context_;
  SessionManager* const sessions_;
  CallWatch* const calls_;
  const CallerPtr caller_;
  FirstRead first_read_;
  ReadDeadline write_;  // of each message alone
  BackgroundExecutor* const executor_;
  Metrics* const metrics_;
  std::shared_ptr<WatchStream> self_;  // until OnDone
  // Set before the session knows of the stream.
  groundlock::v1::WatchSessionRequest request_;

  base::Mutex mutex_;
  // Likewise; null from the end on, so that a client which does not take its
  // last message keeps nothing alive.
  std::shared_ptr<Session> session_ ABSL_GUARDED_BY(mutex_);
  groundlock::v1::WatchSessionResponse response_;  // busy_: not ours
  FrameMemory::Held image_memory_;                 // response_'s; likewise
  std::deque<std::shared_ptr<const Answer>> waiting_ ABSL_GUARDED_BY(mutex_);
  std::uint64_t skipped_ ABSL_GUARDED_BY(mutex_) = 0;
  bool busy_ ABSL_GUARDED_BY(mutex_) = false;  // a response is being written
  bool finished_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status end_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_WATCH_STREAM_H_
