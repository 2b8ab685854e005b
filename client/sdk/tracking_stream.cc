// SPDX-License-Identifier: Apache-2.0
#include "client/sdk/tracking_stream.h"

#include <algorithm>
#include <deque>
#include <limits>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "client/sdk/connection.h"
#include "client/sdk/convert.h"
#include "map_store/base/mutex.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {
namespace {

using Stub = pb::TrackingService::Stub;
using Call = grpc::ClientReaderWriter<pb::TrackRequest, pb::TrackResponse>;

// After these another attempt could bring something else.
bool IsTransient(absl::StatusCode code) {
  switch (code) {
    case absl::StatusCode::kUnavailable:
    case absl::StatusCode::kCancelled:
    case absl::StatusCode::kUnknown:
    case absl::StatusCode::kInternal:
    case absl::StatusCode::kDeadlineExceeded:
      return true;
    default:
      return false;
  }
}

class Stream final : public TrackingStream {
 public:
  Stream(std::shared_ptr<Stub> stub,
         std::string session_id,
         const TrackingStreamOptions& options)
      : stub_(std::move(stub)),
        session_id_(std::move(session_id)),
        options_(options),
        thread_([this] { Run(); }) {}

  ~Stream() override {
    Cancel();
    thread_.join();
  }

  // Waits for the first connection.
  absl::Status WaitUntilAttached() {
    base::MutexLock lock(&mutex_);
    const auto ready = [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
      return attached_ || over_;
    };
    mutex_.Await(ready);
    return attached_ ? absl::OkStatus() : end_;
  }

  std::uint64_t next_sequence() const override {
    base::MutexLock lock(&mutex_);
    return first_sequence_;
  }
  int num_reconnects() const override {
    base::MutexLock lock(&mutex_);
    return num_reconnects_;
  }

  absl::Status Send(Frame frame) override;
  void CloseSend() override {
    base::MutexLock lock(&mutex_);
    closed_ = true;
  }
  absl::StatusOr<std::optional<FrameReply>> Next() override {
    return NextBefore(std::nullopt);
  }
  absl::StatusOr<std::optional<FrameReply>> NextWithin(
      std::chrono::milliseconds timeout) override {
    return NextBefore(timeout);
  }
  absl::Status Finish() override;
  void Cancel() override;

 private:
  absl::StatusOr<std::optional<FrameReply>> NextBefore(
      std::optional<std::chrono::nanoseconds> timeout);
  void Run();
  // One connection, from attaching to its end. Sets *connected once attached.
  absl::Status Connect(bool* connected);
  absl::Status Attach(Call& call) ABSL_LOCKS_EXCLUDED(mutex_);
  void WriteFrames(Call& call, const bool& stop);
  absl::Status ReadAnswers(Call& call);
  void Take(FrameReply reply);
  // After the server has ended the stream in good order: false if it did so too
  // early; answers that it did not send are lost.
  bool GiveUpUnanswered();
  void Deliver(std::vector<FrameReply> replies);
  bool Backoff(int attempt, absl::Time give_up_at);
  void End(const absl::Status& status);

  const std::shared_ptr<Stub> stub_;
  const std::string session_id_;
  const TrackingStreamOptions options_;

  mutable base::Mutex mutex_;
  std::shared_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mutex_);
  // Frames without an answer, in order; the first num_written_ of them are on
  // their way on the present connection, or with the server since an earlier
  // one.
  std::deque<std::shared_ptr<const Frame>> unanswered_ ABSL_GUARDED_BY(mutex_);
  std::size_t num_written_ ABSL_GUARDED_BY(mutex_) = 0;
  std::deque<FrameReply> replies_ ABSL_GUARDED_BY(mutex_);
  std::uint64_t first_sequence_ ABSL_GUARDED_BY(mutex_) = 0;
  std::uint64_t min_sequence_ ABSL_GUARDED_BY(mutex_) = 0;  // of the next Send
  int num_reconnects_ ABSL_GUARDED_BY(mutex_) = 0;
  bool attached_ ABSL_GUARDED_BY(mutex_) = false;  // at least once
  bool closed_ ABSL_GUARDED_BY(mutex_) = false;
  bool cancelled_ ABSL_GUARDED_BY(mutex_) = false;
  bool over_ ABSL_GUARDED_BY(mutex_) = false;
  absl::Status end_ ABSL_GUARDED_BY(mutex_);

  std::thread thread_;
};

absl::Status Stream::Send(Frame frame) {
  base::MutexLock lock(&mutex_);
  const auto ready = [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    return over_ || closed_ ||
           static_cast<int>(unanswered_.size() + replies_.size()) <
               options_.max_in_flight;
  };
  if (frame.sequence < min_sequence_) {
    return absl::InvalidArgumentError(
        absl::StrCat("frame.sequence: ",
                     frame.sequence,
                     " is below ",
                     min_sequence_,
                     ", the next that may be sent"));
  }
  mutex_.Await(ready);
  if (over_) {
    return end_.ok() ? absl::FailedPreconditionError("the stream has ended")
                     : end_;
  }
  if (closed_) {
    return absl::FailedPreconditionError("frames were declared complete");
  }
  min_sequence_ = frame.sequence + 1;
  unanswered_.push_back(std::make_shared<const Frame>(std::move(frame)));
  return absl::OkStatus();
}

absl::StatusOr<std::optional<FrameReply>> Stream::NextBefore(
    std::optional<std::chrono::nanoseconds> timeout) {
  base::MutexLock lock(&mutex_);
  const auto ready = [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    return over_ || !replies_.empty();
  };
  if (!timeout.has_value()) {
    mutex_.Await(ready);
  } else if (!mutex_.AwaitFor(*timeout, ready)) {
    return absl::DeadlineExceededError("no answer came in time");
  }
  if (!replies_.empty()) {
    std::optional<FrameReply> reply = std::move(replies_.front());
    replies_.pop_front();
    return reply;
  }
  if (!end_.ok()) return end_;
  return std::nullopt;
}

absl::Status Stream::Finish() {
  CloseSend();
  base::MutexLock lock(&mutex_);
  mutex_.Await([this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return over_; });
  return end_;
}

void Stream::Cancel() {
  std::shared_ptr<grpc::ClientContext> context;
  {
    base::MutexLock lock(&mutex_);
    cancelled_ = true;
    context = context_;
  }
  if (context != nullptr) context->TryCancel();
}

void Stream::End(const absl::Status& status) {
  base::MutexLock lock(&mutex_);
  over_ = true;
  end_ = status;
}

void Stream::Run() {
  int attempt = 0;
  absl::Time give_up_at =
      absl::Now() + absl::FromChrono(options_.give_up_after);
  for (;;) {
    bool connected = false;
    const absl::Status status = Connect(&connected);
    bool first = false;
    {
      base::MutexLock lock(&mutex_);
      if (cancelled_) {
        over_ = true;
        end_ = absl::CancelledError("the stream was cancelled");
        return;
      }
      first = !attached_;
    }
    // The first connection is the caller's to repeat.
    if (status.ok() || first || !IsTransient(status.code())) {
      End(status);
      return;
    }
    if (connected) {
      attempt = 0;
      give_up_at = absl::Now() + absl::FromChrono(options_.give_up_after);
    }
    if (!Backoff(attempt++, give_up_at)) {
      End(absl::UnavailableError(
          absl::StrCat("the connection was lost and could not be restored: ",
                       status.message())));
      return;
    }
  }
}

bool Stream::Backoff(int attempt, absl::Time give_up_at) {
  const absl::Duration wait =
      std::min(absl::FromChrono(options_.first_backoff) *
                   static_cast<double>(1U << std::min(attempt, 16)),
               absl::FromChrono(options_.last_backoff));
  if (absl::Now() + wait > give_up_at) return false;
  base::MutexLock lock(&mutex_);
  mutex_.AwaitFor(absl::ToChronoNanoseconds(wait),
                  [this]()
                      ABSL_NO_THREAD_SAFETY_ANALYSIS { return cancelled_; });
  return true;
}

absl::Status Stream::Connect(bool* connected) {
  auto context = std::make_shared<grpc::ClientContext>();
  {
    base::MutexLock lock(&mutex_);
    if (cancelled_) return absl::CancelledError("the stream was cancelled");
    context_ = context;
  }
  const std::unique_ptr<Call> call = stub_->Track(context.get());
  absl::Status local = Attach(*call);
  if (local.ok()) {
    *connected = true;
    bool stop = false;
    std::thread writer([this, &call, &stop] { WriteFrames(*call, stop); });
    local = ReadAnswers(*call);
    if (!local.ok()) context->TryCancel();
    {
      base::MutexLock lock(&mutex_);
      stop = true;
    }
    writer.join();
  } else if (!absl::IsUnavailable(local)) {
    // Only a call that goes on: cancelling would hide why it has ended.
    context->TryCancel();
  }
  absl::Status remote = FromGrpc(call->Finish());
  {
    base::MutexLock lock(&mutex_);
    context_ = nullptr;
  }
  // The server's word says more, except that we cancelled.
  if (!local.ok() && local.code() != absl::StatusCode::kUnavailable) {
    return local;
  }
  if (!remote.ok()) return remote;
  RETURN_IF_ERROR(local);
  if (GiveUpUnanswered()) return absl::OkStatus();
  return absl::UnavailableError("the server ended the stream");
}

absl::Status Stream::Attach(Call& call) {
  pb::TrackRequest request;
  request.mutable_attach()->set_session_id(session_id_);
  {
    base::MutexLock lock(&mutex_);
    if (!unanswered_.empty()) {
      request.mutable_attach()->set_resume_from(unanswered_.front()->sequence);
    } else {
      // Answers to an earlier client's frames are not ours to deliver.
      request.mutable_attach()->set_resume_from(
          attached_ ? min_sequence_
                    : std::numeric_limits<std::uint64_t>::max());
    }
  }
  pb::TrackResponse response;
  if (!call.Write(request) || !call.Read(&response)) {
    return absl::UnavailableError("the connection was lost");
  }
  if (!response.has_attached()) {
    return absl::InternalError("the server did not say that it is attached");
  }
  const std::uint64_t next = response.attached().next_sequence();
  base::MutexLock lock(&mutex_);
  if (attached_) {
    ++num_reconnects_;
  } else {
    attached_ = true;
    first_sequence_ = next;
    min_sequence_ = next;
  }
  // Frames that have arrived before are not sent again.
  num_written_ = static_cast<std::size_t>(
      std::find_if(unanswered_.begin(),
                   unanswered_.end(),
                   [next](const auto& f) { return f->sequence >= next; }) -
      unanswered_.begin());
  return absl::OkStatus();
}

void Stream::WriteFrames(Call& call, const bool& stop) {
  const auto ready = [this, &stop]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    return stop || closed_ || num_written_ < unanswered_.size();
  };
  for (;;) {
    std::shared_ptr<const Frame> frame;
    {
      base::MutexLock lock(&mutex_);
      mutex_.Await(ready);
      if (stop) return;
      // Counted before it is written: its answer may be there sooner than we.
      if (num_written_ < unanswered_.size()) {
        frame = unanswered_[num_written_++];
      }
    }
    if (frame == nullptr) {
      call.WritesDone();
      return;
    }
    pb::TrackRequest request;
    ToProto(*frame, request.mutable_frame());
    if (!call.Write(request)) return;  // the reader finds out why
  }
}

absl::Status Stream::ReadAnswers(Call& call) {
  pb::TrackResponse response;
  while (call.Read(&response)) {
    ASSIGN_OR_RETURN(FrameReply reply, FromProto(response));
    Take(std::move(reply));
  }
  return absl::OkStatus();
}

bool Stream::GiveUpUnanswered() {
  std::vector<FrameReply> replies;
  {
    base::MutexLock lock(&mutex_);
    if (!closed_ || num_written_ != unanswered_.size()) return false;
    for (const auto& frame : unanswered_) {
      replies.emplace_back(FrameError{
          frame->sequence,
          absl::DataLossError("the server no longer has the answer")});
    }
    unanswered_.clear();
    num_written_ = 0;
  }
  Deliver(std::move(replies));
  return true;
}

void Stream::Take(FrameReply reply) {
  const std::uint64_t sequence = SequenceOf(reply);
  std::vector<FrameReply> replies;
  {
    base::MutexLock lock(&mutex_);
    while (!unanswered_.empty() && num_written_ > 0 &&
           unanswered_.front()->sequence <= sequence) {
      const std::uint64_t answered = unanswered_.front()->sequence;
      unanswered_.pop_front();
      --num_written_;
      if (answered == sequence) {
        replies.push_back(std::move(reply));
        break;
      }
      // Answers come in order, so this one will not come any more.
      replies.emplace_back(FrameError{
          answered,
          absl::DataLossError("the server no longer has the answer")});
    }
  }
  Deliver(std::move(replies));
}

void Stream::Deliver(std::vector<FrameReply> replies) {
  if (options_.on_reply) {
    for (const FrameReply& reply : replies) options_.on_reply(reply);
    return;
  }
  base::MutexLock lock(&mutex_);
  for (FrameReply& reply : replies) replies_.push_back(std::move(reply));
}

class Watcher final : public SessionWatcher {
 public:
  Watcher(std::shared_ptr<Stub> stub,
          const std::string& session_id,
          bool include_images,
          std::uint32_t image_width_px)
      : stub_(std::move(stub)) {
    pb::WatchSessionRequest request;
    request.set_session_id(session_id);
    request.set_include_images(include_images);
    request.set_image_width_px(image_width_px);
    reader_ = stub_->WatchSession(&context_, request);
  }
  ~Watcher() override {
    context_.TryCancel();
    if (!finished_) reader_->Finish();
  }

  // The server sends its headers when it watches; an error comes without.
  absl::Status WaitUntilWatching() {
    reader_->WaitForInitialMetadata();
    if (context_.GetServerInitialMetadata().count("groundlock-watching") > 0) {
      return absl::OkStatus();
    }
    finished_ = true;
    // The status comes after the last message, of which there is none.
    pb::WatchSessionResponse none;
    while (reader_->Read(&none)) {
    }
    const absl::Status status = FromGrpc(reader_->Finish());
    return status.ok() ? absl::UnavailableError("the server does not watch")
                       : status;
  }

  absl::StatusOr<std::optional<WatchUpdate>> Next() override {
    if (finished_) return absl::FailedPreconditionError("the watch is over");
    pb::WatchSessionResponse response;
    if (reader_->Read(&response)) {
      WatchUpdate update{
          FromProto(response.result()), std::nullopt, response.skipped()};
      if (response.has_image()) update.image = FromProto(response.image());
      return update;
    }
    finished_ = true;
    const absl::Status status = FromGrpc(reader_->Finish());
    // Deleted or expired: nothing is wrong with that.
    if (status.ok() || absl::IsNotFound(status)) return std::nullopt;
    return status;
  }
  void Cancel() override { context_.TryCancel(); }

 private:
  const std::shared_ptr<Stub> stub_;
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReader<pb::WatchSessionResponse>> reader_;
  bool finished_ = false;
};

}  // namespace

absl::Status TrackingStreamOptions::Validate() const {
  // The server keeps 256 answers to be sent again.
  if (max_in_flight < 1 || max_in_flight > 256) {
    return absl::InvalidArgumentError(
        absl::StrCat("max_in_flight: ", max_in_flight, " is not in [1, 256]"));
  }
  if (first_backoff.count() <= 0 || last_backoff < first_backoff) {
    return absl::InvalidArgumentError(
        "first_backoff, last_backoff: must be above 0 and not decrease");
  }
  if (give_up_after.count() < 0) {
    return absl::InvalidArgumentError("give_up_after: must not be negative");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<TrackingStream>> OpenTrackingStream(
    std::shared_ptr<Stub> tracking,
    const std::string& session_id,
    const TrackingStreamOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  auto stream =
      std::make_unique<Stream>(std::move(tracking), session_id, options);
  RETURN_IF_ERROR(stream->WaitUntilAttached());
  return stream;
}

absl::StatusOr<std::unique_ptr<SessionWatcher>> OpenWatcher(
    std::shared_ptr<Stub> tracking,
    const std::string& session_id,
    bool include_images,
    std::uint32_t image_width_px) {
  auto watcher = std::make_unique<Watcher>(
      std::move(tracking), session_id, include_images, image_width_px);
  RETURN_IF_ERROR(watcher->WaitUntilWatching());
  return watcher;
}

}  // namespace groundlock::sdk
