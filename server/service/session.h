// SPDX-License-Identifier: Apache-2.0
// A session as the service sees it: a bounded queue of frames, a strand that
// works it off, and the answers until a client has taken them. Knows neither
// gRPC nor protobuf.
#ifndef GROUNDLOCK_SERVER_SERVICE_SESSION_H_
#define GROUNDLOCK_SERVER_SERVICE_SESSION_H_

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "server/service/frame_memory.h"
#include "server/service/metrics.h"
#include "server/service/options.h"
#include "server/service/session_types.h"
#include "server/service/worker_pool.h"
#include "server/tracking/tracking_session.h"

namespace groundlock::service {

// Thread-safe. Its lock is held for moments only, never while a frame is
// processed. Every accepted frame is answered once, in order.
class Session : public std::enable_shared_from_this<Session> {
 public:
  // core: does the work. map: what its results refer to; null = none. memory:
  // that its images may take; null = as much as the queue's limits leave.
  static std::shared_ptr<Session> Create(
      SessionSpec spec,
      std::shared_ptr<const map::Map> map,
      std::unique_ptr<tracking::TrackingSession> core,
      const SessionLimits& limits,
      WorkerPool* pool,
      Metrics* metrics,
      std::shared_ptr<FrameMemory::Share> memory = nullptr);
  ~Session();

  const SessionSpec& spec() const { return spec_; }
  const map::Map* map() const { return map_.get(); }
  SessionDescription Describe() const;
  // Whether nothing has happened for so long that the session may go.
  bool Expired() const;

  // Makes `sink` the session's stream; an older one ends with kAborted. Answers
  // begin at the first one not taken yet, or, with `resume_from`, at the first
  // kept one of that sequence number or above. Returns the next sequence number
  // that is accepted. kUnavailable while the server is stopping.
  absl::StatusOr<std::uint64_t> Attach(
      std::shared_ptr<FrameSink> sink,
      std::optional<std::uint64_t> resume_from);
  // The stream is gone; frames already accepted are processed all the same.
  void Detach(const FrameSink* sink);
  // Takes the memory that the frame needs from its arrival on, which goes with
  // it. kResourceExhausted: the server's sessions hold too much.
  absl::Status Hold(FrameJob& job) const;
  // The same for an image that a watcher gets; null = there is none.
  FrameMemory::Held HoldForWatcher(std::size_t bytes) const;
  // Accepts the frame (true; `job` is moved from), or has no room (false: the
  // sink will be told). kInvalidArgument: the sequence number is not above the
  // last accepted one; kAborted, kNotFound, kUnavailable: no longer the stream.
  absl::StatusOr<bool> Offer(const FrameSink* sink, FrameJob& job);
  // The next answer to be sent, or null. Counts as taken.
  std::shared_ptr<const Answer> NextAnswer(const FrameSink* sink);
  // Everything accepted is answered and taken.
  bool Drained(const FrameSink* sink) const;

  // Target operations run on the strand, before the next frame. `done` is
  // called once, whatever happens: from there, at once when too many wait or
  // the session has ended, or by whoever ends the session before it gets there.
  using Done = std::function<void(const absl::Status&)>;
  // sequence: see SetTargetRequest; kFailedPrecondition if it is over.
  void SetTarget(std::string id,
                 const geometry::Box2& box_px,
                 std::optional<std::uint64_t> sequence,
                 tracking::TargetBody body,
                 Done done);
  void MoveTarget(std::string id, const geometry::Box2& box_px, Done done);
  void DropTarget(std::string id, Done done);
  // An id that no target of this session has had.
  std::string MakeTargetId();

  // kResourceExhausted: too many.
  absl::Status AddWatcher(std::shared_ptr<ResultWatcher> watcher);
  void RemoveWatcher(const ResultWatcher* watcher);

  // The server stops: waiting frames are answered as dropped, waiting target
  // operations as refused, nothing more is accepted, stream and watchers end.
  void Drain();
  // The session ends now; waiting frames are not answered, target operations
  // are.
  void Close(const absl::Status& reason);

 private:
  using Core = tracking::TrackingSession;
  struct Command {
    std::function<absl::Status(Core&)> run;
    Done done;
  };
  // An accepted frame on its way to its answer.
  struct Slot {
    std::uint64_t sequence = 0;
    std::shared_ptr<FrameJob> waiting;  // null once taken by a worker
    std::shared_ptr<const Answer> answer;
  };
  // Whom to tell, once the lock is released.
  struct Notice {
    std::shared_ptr<FrameSink> sink;
    bool room = false;
    std::vector<std::shared_ptr<ResultWatcher>> watchers;
    std::vector<std::shared_ptr<const Answer>> answers;
    void Send() const;
  };

  Session(SessionSpec spec,
          std::shared_ptr<const map::Map> map,
          std::unique_ptr<Core> core,
          const SessionLimits& limits,
          Metrics* metrics,
          std::shared_ptr<FrameMemory::Share> memory);

  static void Refuse(const std::vector<Command>& commands,
                     const absl::Status& reason);
  void Enqueue(const Command& command);
  bool Step();
  void RunCommands(const std::vector<Command>& commands);
  std::shared_ptr<const Answer> Process(const std::shared_ptr<FrameJob>& job,
                                        bool keep_frame);
  // If the frame is one of those that get spans.
  void AddSpans(const FrameJob& job,
                const absl::StatusOr<FrameOutcome>& outcome) const;
  // Whether a frame that waited so long, or those before it, came too fast.
  bool IsLate(std::chrono::nanoseconds wait);
  absl::StatusOr<FrameOutcome> ProcessFrame(const FrameJob& job);
  bool HasRoom(const FrameJob& job) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // The frame waits no more.
  std::shared_ptr<FrameJob> TakeWaiting(Slot& slot)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void DropWaiting(Slot& slot, DropReason reason)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // What is known of the way to a dropped frame, to the frame after it.
  void HandOn(const FrameJob& dropped, FrameJob& newest)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  Notice Publish() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool WantsImages() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Touch() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const SessionSpec spec_;
  const std::shared_ptr<const map::Map> map_;
  const SessionLimits limits_;
  Metrics* const metrics_;
  const std::shared_ptr<FrameMemory::Share> memory_;
  const std::chrono::system_clock::time_point created_;
  std::shared_ptr<Strand> strand_;

  // On the strand alone.
  const std::unique_ptr<Core> core_;
  std::optional<std::uint64_t> last_processed_;
  double mean_wait_s_ = 0.0;  // of the last frames

  mutable base::Mutex mutex_;
  std::deque<Slot> slots_ ABSL_GUARDED_BY(mutex_);
  int num_waiting_ ABSL_GUARDED_BY(mutex_) = 0;
  std::int64_t waiting_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<Command> commands_ ABSL_GUARDED_BY(mutex_);
  // answers_[i] is the session's answer number first_answer_ + i.
  std::deque<std::shared_ptr<const Answer>> answers_ ABSL_GUARDED_BY(mutex_);
  std::uint64_t first_answer_ ABSL_GUARDED_BY(mutex_) = 0;
  std::uint64_t next_answer_ ABSL_GUARDED_BY(mutex_) = 0;  // not yet taken
  std::shared_ptr<FrameSink> sink_ ABSL_GUARDED_BY(mutex_);
  bool room_wanted_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<std::shared_ptr<ResultWatcher>> watchers_ ABSL_GUARDED_BY(mutex_);
  std::uint64_t next_sequence_ ABSL_GUARDED_BY(mutex_) = 0;
  std::uint64_t frames_processed_ ABSL_GUARDED_BY(mutex_) = 0;
  std::uint64_t frames_dropped_ ABSL_GUARDED_BY(mutex_) = 0;
  std::uint64_t frames_failed_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<std::string> target_ids_ ABSL_GUARDED_BY(mutex_);
  int made_up_ids_ ABSL_GUARDED_BY(mutex_) = 0;
  // Not OK: why the session takes nothing more.
  absl::Status ended_ ABSL_GUARDED_BY(mutex_);
  std::chrono::steady_clock::time_point last_activity_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SESSION_H_
