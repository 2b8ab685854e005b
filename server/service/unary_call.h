// SPDX-License-Identifier: Apache-2.0
// A call with one request and one answer.
#ifndef GROUNDLOCK_SERVER_SERVICE_UNARY_CALL_H_
#define GROUNDLOCK_SERVER_SERVICE_UNARY_CALL_H_

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <functional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "server/service/background_executor.h"
#include "server/service/call_watch.h"
#include "server/service/caller.h"
#include "server/service/convert.h"
#include "server/service/guard.h"

namespace groundlock::service {

// Whose call it is, and how its request is read.
struct CallTerms {
  CallWatch* calls = nullptr;
  std::chrono::nanoseconds silence{0};
  std::size_t max_bytes = 0;  // 0 = as large as a message may be
  CallerPtr caller;
};

// The session or map that a request is about, as it names it.
template <typename Request>
std::string ObjectOf(const Request& request) {
  if constexpr (requires { request.session_id(); }) {
    return request.session_id();
  } else if constexpr (requires { request.name(); }) {
    return request.name();
  } else {
    return "";
  }
}

// Reads the first request of a stream, and no longer than it may take. A part
// of a reactor; told of its OnReadDone and OnTick.
class FirstRead {
 public:
  explicit FirstRead(const CallTerms& terms)
      : max_bytes_(terms.max_bytes),
        caller_(terms.caller),
        deadline_(terms.silence) {}

  void Begin() { deadline_.Begin(); }
  // What OnReadDone(ok) of `request` means; kCancelled: it does not matter any
  // more.
  template <typename Request>
  absl::Status End(bool ok, const Request& request) {
    if (!deadline_.End(0)) return absl::CancelledError("too late");
    if (!ok) return absl::InvalidArgumentError("message: there was none");
    const std::size_t size = request.ByteSizeLong();
    if (caller_ != nullptr) caller_->CountMessage(size);
    if (max_bytes_ == 0 || size <= max_bytes_) return absl::OkStatus();
    return absl::ResourceExhaustedError(
        absl::StrCat("message: has ", size, " bytes, more than ", max_bytes_));
  }
  // Not OK, once, when the client has kept the call waiting for too long.
  absl::Status OnTick(std::chrono::steady_clock::time_point now) {
    if (!deadline_.Expire(now)) return absl::OkStatus();
    return absl::DeadlineExceededError("message: it did not arrive in time");
  }

 private:
  const std::size_t max_bytes_;
  const CallerPtr caller_;  // null = one that nobody knows
  ReadDeadline deadline_;
};

// Owns itself until gRPC's last callback. At any time either gRPC, a handler or
// an executor has it, and each call is answered once.
template <typename Request, typename Response>
class UnaryCall final : public grpc::ServerBidiReactor<Request, Response>,
                        public WatchedCall {
 public:
  using Handler = std::function<void(UnaryCall&)>;

  static UnaryCall* Start(grpc::CallbackServerContext* context,
                          const CallTerms& terms,
                          Handler handler) {
    auto* call = new UnaryCall(context, terms, std::move(handler));
    terms.calls->Add(call);
    call->first_read_.Begin();
    call->StartRead(&call->request_);
    return call;
  }

  // Valid until Reply.
  const Request& request() const { return request_; }
  Response& response() { return response_; }
  const grpc::CallbackServerContext& context() const { return *context_; }
  const Caller& caller() const { return *caller_; }

  // Once; after it `this` may be gone.
  void Reply(const absl::Status& status) {
    caller_->Tell(Object(), status);
    if (status.ok()) {
      answer_.Begin();
      this->StartWriteAndFinish(
          &response_, grpc::WriteOptions(), grpc::Status::OK);
    } else {
      this->Finish(ToGrpc(status));
    }
  }
  // Runs `work` on the executor, unless the call has been cancelled by then,
  // and replies with its status.
  void ReplyFrom(BackgroundExecutor* executor,
                 std::function<absl::Status()> work) {
    const absl::Status posted =
        executor->TryPost([this, work = std::move(work)]() mutable {
          const absl::Status status =
              context_->IsCancelled()
                  ? absl::CancelledError("the client has gone")
                  : Guard([&] {
                      const base::LogFields fields = caller_->Fields();
                      return work();
                    });
          work = nullptr;  // what it holds goes before the client hears
          Reply(status);
        });
    if (!posted.ok()) Reply(posted);
  }

  // gRPC's and the watch's side.
  void OnReadDone(bool ok) override {
    const absl::Status status = first_read_.End(ok, request_);
    if (absl::IsCancelled(status)) return;
    if (!status.ok()) {
      Reply(status);
      return;
    }
    const absl::Status handled = Guard([this] {
      const base::LogFields fields = caller_->Fields();
      handler_(*this);
      return absl::OkStatus();
    });
    // A handler that throws has not replied.
    if (!handled.ok()) Reply(handled);
  }
  void OnTick(std::chrono::steady_clock::time_point now) override {
    const absl::Status late = first_read_.OnTick(now);
    if (!late.ok()) this->Finish(ToGrpc(late));
    // It does not take its answer.
    if (answer_.Expire(now)) context_->TryCancel();
  }
  void OnDone() override {
    calls_->Remove(this);
    delete this;
  }

 private:
  // A session may only have got its name by this call.
  std::string Object() const {
    std::string object = ObjectOf(request_);
    if constexpr (requires { response_.session().session_id(); }) {
      if (object.empty()) object = response_.session().session_id();
    }
    return object;
  }
  UnaryCall(grpc::CallbackServerContext* context,
            const CallTerms& terms,
            Handler handler)
      : context_(context),
        calls_(terms.calls),
        caller_(terms.caller),
        handler_(std::move(handler)),
        first_read_(terms),
        answer_(terms.silence) {}

  grpc::CallbackServerContext* const context_;
  CallWatch* const calls_;
  const CallerPtr caller_;
  const Handler handler_;
  FirstRead first_read_;
  ReadDeadline answer_;
  Request request_;
  Response response_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_UNARY_CALL_H_
