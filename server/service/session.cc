// SPDX-License-Identifier: Apache-2.0
#include "server/service/session.h"

#include <algorithm>
#include <utility>

#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

// Target operations that may wait for the frame in work.
constexpr std::size_t kMaxCommands = 256;
// Accepted frames without an answer, dropped ones included: bounds what a live
// client can pile up while a single frame is processed.
constexpr std::size_t kMaxSlots = 4'096;

std::int64_t BytesOf(const FrameJob& job) {
  return static_cast<std::int64_t>(job.bytes.size() +
                                   job.sensors.inertial.size() *
                                       sizeof(localization::InertialSample));
}

// The way between two frames that are processed goes over those dropped between
// them.
void CarryInertial(const std::vector<localization::InertialSample>& dropped,
                   FrameJob& job) {
  auto& samples = job.sensors.inertial;
  std::size_t carried = dropped.size();
  // Of a sender that sends samples twice, the earlier ones count.
  while (carried > 0 && !samples.empty() &&
         dropped[carried - 1].time >= samples.front().time) {
    --carried;
  }
  const std::size_t room =
      localization::kMaxInertialSamples -
      std::min(localization::kMaxInertialSamples, samples.size());
  const auto end = dropped.begin() + static_cast<std::ptrdiff_t>(carried);
  const auto begin = end - static_cast<std::ptrdiff_t>(std::min(carried, room));
  samples.insert(samples.begin(), begin, end);
}

}  // namespace

void Session::Notice::Send() const {
  if (sink != nullptr) {
    if (!answers.empty()) sink->OnAnswers();
    if (room) sink->OnRoom();
  }
  for (const auto& watcher : watchers) {
    for (const auto& answer : answers) watcher->OnAnswer(answer);
  }
}

std::shared_ptr<Session> Session::Create(
    SessionSpec spec,
    std::shared_ptr<const map::Map> map,
    std::unique_ptr<tracking::TrackingSession> core,
    const SessionLimits& limits,
    WorkerPool* pool,
    Metrics* metrics,
    std::shared_ptr<FrameMemory::Share> memory) {
  std::shared_ptr<Session> session(new Session(std::move(spec),
                                               std::move(map),
                                               std::move(core),
                                               limits,
                                               metrics,
                                               std::move(memory)));
  std::weak_ptr<Session> weak = session;
  session->strand_ = Strand::Create(pool, [weak] {
    const std::shared_ptr<Session> self = weak.lock();
    return self != nullptr && self->Step();
  });
  return session;
}

Session::Session(SessionSpec spec,
                 std::shared_ptr<const map::Map> map,
                 std::unique_ptr<Core> core,
                 const SessionLimits& limits,
                 Metrics* metrics,
                 std::shared_ptr<FrameMemory::Share> memory)
    : spec_(std::move(spec)),
      map_(std::move(map)),
      limits_(limits),
      metrics_(metrics),
      memory_(std::move(memory)),
      created_(std::chrono::system_clock::now()),
      core_(std::move(core)),
      last_activity_(std::chrono::steady_clock::now()) {}

Session::~Session() {
  // Whoever forgot to end the session: those that wait hear of it.
  Refuse(commands_, absl::CancelledError("the session is gone"));
}

void Session::Refuse(const std::vector<Command>& commands,
                     const absl::Status& reason) {
  for (const Command& command : commands) command.done(reason);
}

void Session::Touch() { last_activity_ = std::chrono::steady_clock::now(); }

SessionDescription Session::Describe() const {
  base::MutexLock lock(&mutex_);
  return {spec_,
          created_,
          next_sequence_,
          frames_processed_,
          frames_dropped_,
          frames_failed_,
          target_ids_,
          sink_ != nullptr};
}

bool Session::Expired() const {
  base::MutexLock lock(&mutex_);
  if (!slots_.empty()) return false;
  return std::chrono::steady_clock::now() - last_activity_ >=
         (sink_ == nullptr ? limits_.idle_timeout
                           : limits_.stream_idle_timeout);
}

absl::StatusOr<std::uint64_t> Session::Attach(
    std::shared_ptr<FrameSink> sink, std::optional<std::uint64_t> resume_from) {
  std::shared_ptr<FrameSink> previous;
  std::uint64_t next_sequence = 0;
  {
    base::MutexLock lock(&mutex_);
    if (!ended_.ok()) return ended_;
    previous = std::exchange(sink_, std::move(sink));
    room_wanted_ = false;
    Touch();
    if (resume_from.has_value()) {
      const auto first = std::find_if(
          answers_.begin(), answers_.end(), [&](const auto& answer) {
            return answer->sequence >= *resume_from;
          });
      next_answer_ =
          first_answer_ + static_cast<std::uint64_t>(first - answers_.begin());
    }
    next_sequence = next_sequence_;
  }
  if (previous != nullptr) {
    previous->OnEnd(absl::AbortedError(absl::StrCat(
                        "another stream took over session ", spec_.id)),
                    /*drain=*/false);
  }
  return next_sequence;
}

void Session::Detach(const FrameSink* sink) {
  base::MutexLock lock(&mutex_);
  if (sink_.get() != sink) return;
  sink_ = nullptr;
  room_wanted_ = false;
  Touch();
}

absl::Status Session::Hold(FrameJob& job) const {
  if (memory_ == nullptr) return absl::OkStatus();
  job.memory = memory_->Take(BytesOf(job));
  if (job.memory != nullptr) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      "the server's sessions hold too many large images; send this one again "
      "later, or smaller");
}

FrameMemory::Held Session::HoldForWatcher(std::size_t bytes) const {
  if (memory_ == nullptr) return std::make_shared<char>();
  return memory_->Take(static_cast<std::int64_t>(bytes));
}

bool Session::HasRoom(const FrameJob& job) const {
  const std::uint64_t unread = first_answer_ + answers_.size() - next_answer_;
  if (slots_.size() + unread >=
          static_cast<std::uint64_t>(limits_.max_unread_answers) ||
      slots_.size() >= kMaxSlots) {
    return false;
  }
  if (spec_.live || num_waiting_ == 0) return true;
  return num_waiting_ < limits_.lossless_queue_frames &&
         (memory_ == nullptr || !memory_->IsScarce()) &&
         waiting_bytes_ + BytesOf(job) <= limits_.max_queued_bytes;
}

absl::StatusOr<bool> Session::Offer(const FrameSink* sink, FrameJob& job) {
  Notice notice;
  {
    base::MutexLock lock(&mutex_);
    if (!ended_.ok()) return ended_;
    if (sink_.get() != sink) {
      return absl::AbortedError("the stream is no longer the session's");
    }
    if (job.sequence < next_sequence_) {
      return absl::InvalidArgumentError(
          absl::StrCat("frame.sequence: ",
                       job.sequence,
                       " is not above ",
                       next_sequence_ - 1,
                       ", that of the last accepted frame"));
    }
    if (!HasRoom(job)) {
      room_wanted_ = true;
      return false;
    }
    if (spec_.live) {
      for (Slot& slot : slots_) {
        const bool full = num_waiting_ >= limits_.live_queue_frames ||
                          (num_waiting_ > 0 && waiting_bytes_ + BytesOf(job) >
                                                   limits_.max_queued_bytes);
        if (!full) break;
        if (slot.waiting == nullptr) continue;
        const auto dropped = slot.waiting;
        DropWaiting(slot, DropReason::kOverload);
        HandOn(*dropped, job);
      }
    }
    next_sequence_ = job.sequence + 1;
    ++num_waiting_;
    waiting_bytes_ += BytesOf(job);
    slots_.push_back(
        {job.sequence, std::make_shared<FrameJob>(std::move(job)), nullptr});
    Touch();
    notice = Publish();
    // The stream itself is asking: it looks for answers after this call.
    notice.room = false;
  }
  strand_->Wake();
  // Called under the stream's own lock: only watchers are told from here.
  notice.sink = nullptr;
  notice.Send();
  return true;
}

std::shared_ptr<const Answer> Session::NextAnswer(const FrameSink* sink) {
  base::MutexLock lock(&mutex_);
  if (sink_.get() != sink) return nullptr;
  if (next_answer_ >= first_answer_ + answers_.size()) return nullptr;
  return answers_[next_answer_++ - first_answer_];
}

bool Session::Drained(const FrameSink* sink) const {
  base::MutexLock lock(&mutex_);
  return sink_.get() != sink ||
         (slots_.empty() && next_answer_ == first_answer_ + answers_.size());
}

void Session::Enqueue(const Command& command) {
  absl::Status status;
  {
    base::MutexLock lock(&mutex_);
    status = ended_;
    if (status.ok() && commands_.size() >= kMaxCommands) {
      status = absl::ResourceExhaustedError(
          "too many target operations wait in this session");
    }
    if (status.ok()) {
      commands_.push_back(command);
      Touch();
    }
  }
  if (status.ok()) {
    strand_->Wake();
  } else {
    command.done(status);
  }
}

void Session::SetTarget(std::string id,
                        const geometry::Box2& box_px,
                        std::optional<std::uint64_t> sequence,
                        tracking::TargetBody body,
                        Done done) {
  Enqueue({[this, id = std::move(id), box_px, sequence, body = std::move(body)](
               Core& core) {
             if (sequence.has_value() && last_processed_.has_value() &&
                 *sequence <= *last_processed_) {
               return absl::FailedPreconditionError(absl::StrCat(
                   "sequence: frame ",
                   *sequence,
                   " has been processed already, the last one was ",
                   *last_processed_));
             }
             return core.SetTarget(id, box_px, sequence, body);
           },
           std::move(done)});
}

void Session::MoveTarget(std::string id,
                         const geometry::Box2& box_px,
                         Done done) {
  Enqueue({[id = std::move(id), box_px](Core& core) {
             return core.MoveTarget(id, box_px);
           },
           std::move(done)});
}

void Session::DropTarget(std::string id, Done done) {
  Enqueue({[id = std::move(id)](Core& core) { return core.DropTarget(id); },
           std::move(done)});
}

std::string Session::MakeTargetId() {
  base::MutexLock lock(&mutex_);
  for (;;) {
    std::string id = absl::StrCat("target-", ++made_up_ids_);
    if (std::find(target_ids_.begin(), target_ids_.end(), id) ==
        target_ids_.end()) {
      return id;
    }
  }
}

absl::Status Session::AddWatcher(std::shared_ptr<ResultWatcher> watcher) {
  base::MutexLock lock(&mutex_);
  if (!ended_.ok()) return ended_;
  if (static_cast<int>(watchers_.size()) >= limits_.max_watchers) {
    return absl::ResourceExhaustedError(
        absl::StrCat("session ",
                     spec_.id,
                     " has ",
                     watchers_.size(),
                     " watchers, the most that are allowed"));
  }
  watchers_.push_back(std::move(watcher));
  return absl::OkStatus();
}

void Session::RemoveWatcher(const ResultWatcher* watcher) {
  base::MutexLock lock(&mutex_);
  std::erase_if(watchers_, [watcher](const auto& candidate) {
    return candidate.get() == watcher;
  });
}

bool Session::WantsImages() const {
  return std::any_of(
      watchers_.begin(), watchers_.end(), [](const auto& watcher) {
        return watcher->wants_images();
      });
}

std::shared_ptr<FrameJob> Session::TakeWaiting(Slot& slot) {
  --num_waiting_;
  waiting_bytes_ -= BytesOf(*slot.waiting);
  return std::exchange(slot.waiting, nullptr);
}

void Session::DropWaiting(Slot& slot, DropReason reason) {
  TakeWaiting(slot);
  slot.answer =
      std::make_shared<const Answer>(Answer{slot.sequence, reason, nullptr});
}

void Session::HandOn(const FrameJob& dropped, FrameJob& newest) {
  const auto next =
      std::find_if(slots_.begin(), slots_.end(), [](const Slot& slot) {
        return slot.waiting != nullptr;
      });
  if (next == slots_.end()) {
    CarryInertial(dropped.sensors.inertial, newest);
    return;
  }
  waiting_bytes_ -= BytesOf(*next->waiting);
  CarryInertial(dropped.sensors.inertial, *next->waiting);
  waiting_bytes_ += BytesOf(*next->waiting);
}

// Moves what is answered from the head of the queue to the answers.
Session::Notice Session::Publish() {
  Notice notice;
  notice.sink = sink_;
  while (!slots_.empty() && slots_.front().answer != nullptr) {
    std::shared_ptr<const Answer> answer = std::move(slots_.front().answer);
    slots_.pop_front();
    if (std::holds_alternative<DropReason>(answer->content)) {
      ++frames_dropped_;
      ++metrics_->frames_dropped;
    } else if (std::holds_alternative<absl::Status>(answer->content)) {
      ++frames_failed_;
      ++metrics_->frames_failed;
    } else {
      ++frames_processed_;
      ++metrics_->frames_processed;
    }
    notice.answers.push_back(answer);
    if (answer->frame != nullptr) {
      // Images are for watchers alone: they are not kept.
      answer = std::make_shared<const Answer>(
          Answer{answer->sequence, answer->content, nullptr});
    }
    answers_.push_back(std::move(answer));
  }
  while (answers_.size() > static_cast<std::size_t>(limits_.kept_answers)) {
    answers_.pop_front();
    ++first_answer_;
    next_answer_ = std::max(next_answer_, first_answer_);
  }
  if (!notice.answers.empty()) notice.watchers = watchers_;
  notice.room = std::exchange(room_wanted_, false);
  return notice;
}

void Session::Drain() {
  Notice notice;
  std::shared_ptr<FrameSink> sink;
  std::vector<std::shared_ptr<ResultWatcher>> watchers;
  std::vector<Command> commands;
  const absl::Status reason = absl::UnavailableError("the server is stopping");
  {
    base::MutexLock lock(&mutex_);
    if (!ended_.ok()) return;
    ended_ = reason;
    for (Slot& slot : slots_) {
      if (slot.waiting != nullptr) DropWaiting(slot, DropReason::kShutdown);
    }
    notice = Publish();
    notice.room = false;
    sink = sink_;
    watchers = watchers_;
    commands = std::exchange(commands_, {});
  }
  Refuse(commands, reason);
  notice.Send();
  if (sink != nullptr) sink->OnEnd(reason, /*drain=*/true);
  for (const auto& watcher : watchers) watcher->OnEnd(reason);
}

void Session::Close(const absl::Status& reason) {
  std::shared_ptr<FrameSink> sink;
  std::vector<std::shared_ptr<ResultWatcher>> watchers;
  std::vector<Command> commands;
  {
    base::MutexLock lock(&mutex_);
    ended_ = reason;
    for (Slot& slot : slots_) slot.waiting = nullptr;
    num_waiting_ = 0;
    waiting_bytes_ = 0;
    sink = std::exchange(sink_, nullptr);
    watchers = std::exchange(watchers_, {});
    commands = std::exchange(commands_, {});
  }
  strand_->Retire();
  Refuse(commands, reason);
  if (sink != nullptr) sink->OnEnd(reason, /*drain=*/false);
  for (const auto& watcher : watchers) watcher->OnEnd(reason);
}

}  // namespace groundlock::service
