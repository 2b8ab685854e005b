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

namespace groundlock::service {

// One WatchSession call. Keeps at most two results back: whoever reads slowly
// gets the newest ones and is told how many were left out. Owns itself as
// TrackStream does.
class WatchStream final
    : public grpc::ServerWriteReactor<groundlock::v1::WatchSessionResponse>,
      public ResultWatcher,
      public std::enable_shared_from_this<WatchStream> {
 public:
  // session: an error finishes the call with it. image_width_px: as in the
  // request. executor: encodes raw images.
  static WatchStream* Start(absl::StatusOr<std::shared_ptr<Session>> session,
                            bool include_images,
                            std::uint32_t image_width_px,
                            BackgroundExecutor* executor,
                            Metrics* metrics);

  // gRPC's side.
  void OnWriteDone(bool ok) override;
  void OnCancel() override;
  void OnDone() override;

  // The session's side.
  bool wants_images() const override { return include_images_; }
  void OnAnswer(const std::shared_ptr<const Answer>& answer) override;
  void OnEnd(const absl::Status& reason) override;

 private:
  WatchStream(bool include_images,
              std::uint32_t image_width_px,
              BackgroundExecutor* executor,
              Metrics* metrics);

  void Pump() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void FinishNow(const absl::Status& status)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Fills in the image of `response_`, on the executor, and writes it.
  void WriteWithImage(const FrameJob& frame);

  const bool include_images_;
  const std::uint32_t image_width_px_;
  BackgroundExecutor* const executor_;
  Metrics* const metrics_;
  std::shared_ptr<WatchStream> self_;  // until OnDone
  std::shared_ptr<Session> session_;   // set before anything else runs

  base::Mutex mutex_;
  groundlock::v1::WatchSessionResponse response_;  // busy_: not ours
  std::deque<std::shared_ptr<const Answer>> waiting_ ABSL_GUARDED_BY(mutex_);
  std::uint64_t skipped_ ABSL_GUARDED_BY(mutex_) = 0;
  bool busy_ ABSL_GUARDED_BY(mutex_) = false;  // a response is being written
  bool finished_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status end_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_WATCH_STREAM_H_
