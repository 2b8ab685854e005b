// SPDX-License-Identifier: Apache-2.0
#include "server/service/track_stream.h"

#include <string>
#include <utility>

#include "server/service/convert.h"

namespace groundlock::service {

TrackStream* TrackStream::Start(grpc::CallbackServerContext* context,
                                SessionManager* sessions,
                                const CallTerms& terms,
                                Metrics* metrics) {
  std::shared_ptr<TrackStream> stream(
      new TrackStream(context, sessions, terms, metrics));
  stream->self_ = stream;
  terms.calls->Add(stream.get());
  stream->first_read_.Begin();
  stream->StartRead(&stream->request_);
  return stream.get();
}

TrackStream::TrackStream(grpc::CallbackServerContext* context,
                         SessionManager* sessions,
                         const CallTerms& terms,
                         Metrics* metrics)
    : context_(context),
      sessions_(sessions),
      calls_(terms.calls),
      caller_(terms.caller),
      first_read_(terms),
      farewell_(terms.silence),
      metrics_(metrics) {
  ++metrics_->streams;
}

void TrackStream::OnReadDone(bool ok) {
  base::MutexLock lock(&mutex_);
  // The first message is counted by whoever reads it.
  if (ok && session_ != nullptr) caller_->CountMessage(request_.ByteSizeLong());
  if (finished_) return;
  if (!end_.ok()) {
    Pump();
    return;
  }
  if (session_ == nullptr && ok) {
    const absl::Status first = first_read_.End(ok, request_);
    if (first.ok()) {
      HandleAttach();
    } else {
      EndWith(first, /*drain=*/false);
    }
  } else if (!ok) {
    half_closed_ = true;
    if (session_ == nullptr) {
      EndWith(absl::InvalidArgumentError("the stream ended before its attach"),
              /*drain=*/false);
    }
  } else if (request_.has_frame()) {
    HandleFrame();
  } else {
    EndWith(absl::InvalidArgumentError(
                "message: expected a frame, as the stream is attached"),
            /*drain=*/false);
  }
  Pump();
}

void TrackStream::HandleAttach() {
  if (!request_.has_attach()) {
    EndWith(absl::InvalidArgumentError("message: the first one must be attach"),
            /*drain=*/false);
    return;
  }
  const pb::TrackRequest::Attach& attach = request_.attach();
  auto session =
      sessions_->Find(*caller_->principal, attach.session_id(), Deed::kAct);
  caller_->Tell(attach.session_id(), session.status());
  if (!session.ok()) {
    EndWith(session.status(), /*drain=*/false);
    return;
  }
  std::optional<std::uint64_t> resume_from;
  if (attach.has_resume_from()) resume_from = attach.resume_from();
  const auto next_sequence =
      (*session)->Attach(shared_from_this(), resume_from);
  if (!next_sequence.ok()) {
    EndWith(next_sequence.status(), /*drain=*/false);
    return;
  }
  session_ = *std::move(session);
  response_.mutable_attached()->set_next_sequence(*next_sequence);
  Write();
  StartRead(&request_);
}

void TrackStream::HandleFrame() {
  pending_ = TakeFrame(*request_.mutable_frame());
  if (const auto& account = caller_->principal->account) {
    const absl::Status within = account->TakeFrame(pending_->bytes.size());
    if (!within.ok()) {
      RefusePending(within);
      return;
    }
  }
  const absl::Status held = session_->Hold(*pending_);
  if (!held.ok()) {
    ++metrics_->calls_over_limit;
    RefusePending(held);
    return;
  }
  OfferPending();
}

void TrackStream::RefusePending(const absl::Status& reason) {
  pb::FrameError* error = refusal_.emplace().mutable_error();
  error->set_sequence(pending_->sequence);
  error->set_code(static_cast<int>(reason.code()));
  error->set_message(std::string(reason.message()));
  pending_.reset();
}

void TrackStream::OfferPending() {
  if (!pending_.has_value() || finished_ || !end_.ok()) return;
  const absl::StatusOr<bool> accepted = session_->Offer(this, *pending_);
  if (accepted.ok() && !*accepted) return;  // OnRoom will come
  if (accepted.ok()) {
    StartRead(&request_);
  } else if (accepted.status().code() == absl::StatusCode::kInvalidArgument) {
    RefusePending(accepted.status());
    return;
  } else {
    EndWith(accepted.status(),
            accepted.status().code() == absl::StatusCode::kUnavailable);
  }
  pending_.reset();
}

void TrackStream::Pump() {
  if (finished_ || writing_) return;
  if (cancelled_) {
    FinishNow(absl::CancelledError("the stream broke"));
    return;
  }
  if (session_ != nullptr) {
    if (refusal_.has_value()) {
      response_ = *std::move(refusal_);
      refusal_.reset();
      Write();
      StartRead(&request_);
      return;
    }
    if (const auto answer = session_->NextAnswer(this); answer != nullptr) {
      response_.Clear();
      ToProto(*answer, session_->spec(), session_->map(), &response_);
      Write();
      OfferPending();  // taking an answer may have made room
      return;
    }
  }
  if (!end_.ok()) {
    if (!drain_ || session_->Drained(this)) FinishNow(end_);
  } else if (half_closed_ && session_->Drained(this)) {
    FinishNow(absl::OkStatus());
  }
}

void TrackStream::Write() {
  writing_ = true;
  StartWrite(&response_);
}

void TrackStream::EndWith(const absl::Status& status, bool drain) {
  if (!end_.ok()) return;  // the first reason counts
  end_ = status;
  drain_ = drain && session_ != nullptr;
  farewell_.Begin();
}

void TrackStream::EndAtOnce(const absl::Status& status) {
  pending_.reset();
  EndWith(status, /*drain=*/false);
  drain_ = false;
  if (session_ == nullptr) return;
  session_->Detach(this);
  session_ = nullptr;
}

void TrackStream::FinishNow(const absl::Status& status) {
  finished_ = true;
  if (session_ != nullptr) session_->Detach(this);
  Finish(ToGrpc(status));
}

void TrackStream::OnWriteDone(bool ok) {
  base::MutexLock lock(&mutex_);
  writing_ = false;
  if (finished_) return;
  if (!ok) {
    FinishNow(absl::CancelledError("the stream broke"));
    return;
  }
  Pump();
}

void TrackStream::OnTick(std::chrono::steady_clock::time_point now) {
  if (farewell_.Expire(now)) context_->TryCancel();
  absl::Status end = first_read_.OnTick(now);
  if (end.ok()) end = caller_->principal->CheckValid();
  if (end.ok()) return;
  base::MutexLock lock(&mutex_);
  if (finished_) return;
  EndAtOnce(end);
  Pump();
}

void TrackStream::OnCancel() {
  base::MutexLock lock(&mutex_);
  cancelled_ = true;
  Pump();
}

void TrackStream::OnDone() {
  --metrics_->streams;
  calls_->Remove(this);
  std::shared_ptr<TrackStream> last = std::move(self_);
  base::MutexLock lock(&mutex_);
  if (session_ != nullptr) session_->Detach(this);
}

void TrackStream::OnAnswers() {
  base::MutexLock lock(&mutex_);
  Pump();
}

void TrackStream::OnRoom() {
  base::MutexLock lock(&mutex_);
  OfferPending();
  Pump();
}

void TrackStream::OnEnd(const absl::Status& reason, bool drain) {
  base::MutexLock lock(&mutex_);
  if (drain) {
    pending_.reset();
    EndWith(reason, drain);
  } else {
    EndAtOnce(reason);
  }
  Pump();
}

}  // namespace groundlock::service
