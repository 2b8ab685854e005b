// SPDX-License-Identifier: Apache-2.0
// A server stream whose messages are made one after another on an executor.
#ifndef GROUNDLOCK_SERVER_SERVICE_PRODUCING_STREAM_H_
#define GROUNDLOCK_SERVER_SERVICE_PRODUCING_STREAM_H_

#include <grpcpp/support/server_callback.h>

#include <atomic>
#include <functional>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/background_executor.h"
#include "server/service/unary_call.h"

namespace groundlock::service {

// Owns itself until gRPC's last callback. At any time either the executor or
// gRPC has it, so nothing else needs a lock. A client that takes nothing for
// too long is let go, with the files that it holds.
template <typename Request, typename Response>
class ProducingStream final : public grpc::ServerBidiReactor<Request, Response>,
                              public WatchedCall {
 public:
  // Fills the next message and returns true, or returns false at the end.
  using Producer = std::function<absl::StatusOr<bool>(Response&)>;
  using MakeProducer = std::function<Producer(const Caller&, const Request&)>;

  // first: makes the first message, which may take long; then: the others.
  static ProducingStream* Start(grpc::CallbackServerContext* context,
                                const CallTerms& terms,
                                MakeProducer make_producer,
                                BackgroundExecutor* first,
                                BackgroundExecutor* then) {
    auto* stream = new ProducingStream(
        context, terms, std::move(make_producer), first, then);
    terms.calls->Add(stream);
    stream->first_read_.Begin();
    stream->StartRead(&stream->request_);
    return stream;
  }

  void OnReadDone(bool ok) override {
    absl::Status status = first_read_.End(ok, request_);
    if (absl::IsCancelled(status)) return;
    if (status.ok()) status = first_->TryPost([this] { Produce(); });
    if (!status.ok()) End(status);
  }
  void OnWriteDone(bool ok) override {
    if (!ok) cancelled_ = true;
    if (!write_.End(response_.ByteSizeLong())) cancelled_ = true;
    then_->Post([this] { Produce(); });
  }
  void OnCancel() override { cancelled_ = true; }
  void OnTick(std::chrono::steady_clock::time_point now) override {
    const absl::Status late = first_read_.OnTick(now);
    if (!late.ok()) this->Finish(ToGrpc(late));
    // Ends the write under way; OnWriteDone does the rest.
    if (write_.Expire(now) || !caller_->principal->CheckValid().ok()) {
      context_->TryCancel();
    }
  }
  void OnDone() override {
    calls_->Remove(this);
    delete this;
  }

 private:
  ProducingStream(grpc::CallbackServerContext* context,
                  const CallTerms& terms,
                  MakeProducer make_producer,
                  BackgroundExecutor* first,
                  BackgroundExecutor* then)
      : context_(context),
        calls_(terms.calls),
        caller_(terms.caller),
        first_read_(terms),
        write_(terms.silence),
        make_producer_(std::move(make_producer)),
        first_(first),
        then_(then) {}

  void Produce() {
    absl::StatusOr<bool> more = absl::CancelledError("the client has gone");
    if (!cancelled_) {
      response_.Clear();
      const absl::Status status = Guard([this, &more] {
        if (producer_ == nullptr)
          producer_ = make_producer_(*caller_, request_);
        more = producer_(response_);
        return more.status();
      });
      if (!status.ok()) more = status;
    }
    if (more.ok() && *more) {
      write_.Begin();
      this->StartWrite(&response_);
    } else {
      producer_ = nullptr;  // its files go here, on the executor
      End(more.status());
    }
  }
  void End(const absl::Status& status) {
    caller_->Tell(ObjectOf(request_), status);
    this->Finish(ToGrpc(status));
  }

  grpc::CallbackServerContext* const context_;
  CallWatch* const calls_;
  const CallerPtr caller_;
  FirstRead first_read_;
  ReadDeadline write_;
  const MakeProducer make_producer_;
  Producer producer_;
  BackgroundExecutor* const first_;
  BackgroundExecutor* const then_;
  Request request_;
  Response response_;
  std::atomic<bool> cancelled_{false};
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_PRODUCING_STREAM_H_
