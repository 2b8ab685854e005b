// SPDX-License-Identifier: Apache-2.0
// The bidirectional stream of frames and answers.
#ifndef GROUNDLOCK_SERVER_SERVICE_TRACK_STREAM_H_
#define GROUNDLOCK_SERVER_SERVICE_TRACK_STREAM_H_

#include <grpcpp/support/server_callback.h>

#include <memory>
#include <optional>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/mutex.h"
#include "server/service/session.h"
#include "server/service/session_manager.h"
#include "server/service/unary_call.h"

namespace groundlock::service {

// One Track call. Owns itself: gRPC's last callback lets it go, and so does the
// session when it has told it something. Reads the next frame only when the
// session has room for it: that is how a lossless sender is held back.
class TrackStream final
    : public grpc::ServerBidiReactor<groundlock::v1::TrackRequest,
                                     groundlock::v1::TrackResponse>,
      public FrameSink,
      public WatchedCall,
      public std::enable_shared_from_this<TrackStream> {
 public:
  // terms: of its first message.
  static TrackStream* Start(grpc::CallbackServerContext* context,
                            SessionManager* sessions,
                            const CallTerms& terms,
                            Metrics* metrics);

  // gRPC's side.
  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnCancel() override;
  void OnDone() override;
  void OnTick(std::chrono::steady_clock::time_point now) override;

  // The session's side.
  void OnAnswers() override;
  void OnRoom() override;
  void OnEnd(const absl::Status& reason, bool drain) override;

 private:
  TrackStream(grpc::CallbackServerContext* context,
              SessionManager* sessions,
              const CallTerms& terms,
              Metrics* metrics);

  void HandleAttach() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void HandleFrame() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RefusePending(const absl::Status& reason)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void OfferPending() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Writes what there is to write, and finishes when that is all.
  void Pump() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Write() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void EndWith(const absl::Status& status, bool drain)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Ends without what is still to be sent; keeps nothing of the session alive,
  // however long the client leaves the last message where it is.
  void EndAtOnce(const absl::Status& status)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void FinishNow(const absl::Status& status)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  grpc::CallbackServerContext* const context_;
  SessionManager* const sessions_;
  CallWatch* const calls_;
  const CallerPtr caller_;
  FirstRead first_read_;
  // From the end on: a client that takes nothing is not waited for.
  ReadDeadline farewell_;
  Metrics* const metrics_;
  std::shared_ptr<TrackStream> self_;  // until OnDone

  base::Mutex mutex_;
  std::shared_ptr<Session> session_ ABSL_GUARDED_BY(mutex_);
  groundlock::v1::TrackRequest request_;    // gRPC's while a read is under way
  groundlock::v1::TrackResponse response_;  // gRPC's while a write is under way
  bool writing_ ABSL_GUARDED_BY(mutex_) = false;
  bool cancelled_ ABSL_GUARDED_BY(mutex_) = false;
  bool half_closed_ ABSL_GUARDED_BY(mutex_) = false;
  bool finished_ ABSL_GUARDED_BY(mutex_) = false;
  // A frame that has arrived but found no room yet.
  std::optional<FrameJob> pending_ ABSL_GUARDED_BY(mutex_);
  // The answer to a frame that was refused; reading goes on once it is written.
  std::optional<groundlock::v1::TrackResponse> refusal_ ABSL_GUARDED_BY(mutex_);
  // Not OK: how to finish, once drained if so asked for.
  absl::Status end_ ABSL_GUARDED_BY(mutex_);
  bool drain_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_TRACK_STREAM_H_
