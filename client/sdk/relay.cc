// SPDX-License-Identifier: Apache-2.0
#include "client/sdk/relay.h"

#include <grpcpp/client_context.h>
#include <grpcpp/support/client_callback.h>

#include <chrono>
#include <map>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "client/sdk/channel.h"
#include "client/sdk/convert.h"
#include "groundlock/v1/maps.grpc.pb.h"
#include "groundlock/v1/tracking.grpc.pb.h"
#include "map_store/base/mutex.h"
#include "map_store/base/status.h"

namespace groundlock::sdk {
namespace {

using Clock = std::chrono::system_clock;

void AddToken(const std::string& token, grpc::ClientContext& context) {
  if (!token.empty()) {
    context.AddMetadata("authorization", absl::StrCat("Bearer ", token));
  }
}

// The calls under way, so that the relay can end them.
class CallBook {
 public:
  // cancel: how to end it; null = TryCancel.
  void Enter(grpc::ClientContext* context,
             std::function<void()> cancel = nullptr) {
    base::MutexLock lock(&mutex_);
    calls_[context] = std::move(cancel);
    if (closing_) context->TryCancel();
  }
  void Leave(grpc::ClientContext* context) {
    base::MutexLock lock(&mutex_);
    calls_.erase(context);
  }
  void CancelAllAndWait() {
    base::MutexLock lock(&mutex_);
    closing_ = true;
    for (const auto& [context, cancel] : calls_) {
      if (cancel) {
        cancel();
      } else {
        context->TryCancel();
      }
    }
    mutex_.Await([this]()
                     ABSL_NO_THREAD_SAFETY_ANALYSIS { return calls_.empty(); });
  }

 private:
  base::Mutex mutex_;
  std::map<grpc::ClientContext*, std::function<void()>> calls_
      ABSL_GUARDED_BY(mutex_);
  bool closing_ ABSL_GUARDED_BY(mutex_) = false;
};

template <typename Request, typename Response>
struct UnaryCall {
  grpc::ClientContext context;
  Request request;
  Response response;
  Reply<Response> reply;
};

// method: a call of the generated asynchronous stub.
template <typename Request, typename Response, typename Async>
void Start(Async* stub,
           void (Async::*method)(grpc::ClientContext*,
                                 const Request*,
                                 Response*,
                                 std::function<void(grpc::Status)>),
           CallBook* book,
           const std::string& token,
           std::chrono::milliseconds timeout,
           const Request& request,
           Reply<Response> reply) {
  auto* call = new UnaryCall<Request, Response>;
  AddToken(token, call->context);
  if (timeout.count() > 0) call->context.set_deadline(Clock::now() + timeout);
  call->request = request;
  call->reply = std::move(reply);
  book->Enter(&call->context);
  (stub->*method)(&call->context,
                  &call->request,
                  &call->response,
                  [call, book](const grpc::Status& status) {
                    if (status.ok()) {
                      call->reply(std::move(call->response));
                    } else {
                      call->reply(FromGrpc(status));
                    }
                    call->reply = nullptr;
                    book->Leave(&call->context);
                    delete call;
                  });
}

class WatchCall final
    : public grpc::ClientReadReactor<pb::WatchSessionResponse>,
      public RelayedWatch {
 public:
  WatchCall(CallBook* book,
            std::function<void()> on_start,
            std::function<void(pb::WatchSessionResponse)> on_message,
            std::function<void(absl::Status)> on_end)
      : book_(book),
        on_start_(std::move(on_start)),
        on_message_(std::move(on_message)),
        on_end_(std::move(on_end)) {}

  void Start(pb::TrackingService::Stub& stub,
             const std::string& token,
             const pb::WatchSessionRequest& request,
             std::shared_ptr<WatchCall> self) {
    AddToken(token, context_);
    request_ = request;
    self_ = std::move(self);
    book_->Enter(&context_, [this] { Cancel(); });
    stub.async()->WatchSession(&context_, &request_, this);
    // Reads are started from outside of gRPC's callbacks too.
    AddHold();
    StartRead(&response_);
    StartCall();
  }

  void OnReadInitialMetadataDone(bool ok) override {
    // An error comes without it.
    if (ok &&
        context_.GetServerInitialMetadata().count("groundlock-watching") > 0) {
      on_start_();
    }
  }
  void OnReadDone(bool ok) override {
    if (!ok) {
      RemoveHold();
      return;
    }
    // Before anybody may start the next read.
    pb::WatchSessionResponse message = std::exchange(response_, {});
    bool cancelled = false;
    {
      base::MutexLock lock(&mutex_);
      cancelled = cancelled_;
      idle_ = !cancelled;
    }
    if (cancelled) {
      StartRead(&response_);
      return;
    }
    on_message_(std::move(message));
  }
  // Between OnReadDone and Continue() no read is under way, and the hold keeps
  // the call from being over.
  void Continue() override {
    if (TakeIdle(/*cancel=*/false)) StartRead(&response_);
  }
  void Cancel() override {
    const bool idle = TakeIdle(/*cancel=*/true);
    context_.TryCancel();
    // It fails, and that ends the call.
    if (idle) StartRead(&response_);
  }

  void OnDone(const grpc::Status& status) override {
    const std::shared_ptr<WatchCall> last = std::move(self_);
    on_end_(FromGrpc(status));
    on_start_ = nullptr;
    on_message_ = nullptr;
    on_end_ = nullptr;
    book_->Leave(&context_);
  }

 private:
  // Whether no read was under way; the caller starts one.
  bool TakeIdle(bool cancel) {
    base::MutexLock lock(&mutex_);
    cancelled_ |= cancel;
    return std::exchange(idle_, false);
  }

  CallBook* const book_;
  std::function<void()> on_start_;
  std::function<void(pb::WatchSessionResponse)> on_message_;
  std::function<void(absl::Status)> on_end_;
  grpc::ClientContext context_;
  pb::WatchSessionRequest request_;
  pb::WatchSessionResponse response_;
  std::shared_ptr<WatchCall> self_;  // until OnDone
  base::Mutex mutex_;
  bool idle_ ABSL_GUARDED_BY(mutex_) = false;  // no read is under way
  bool cancelled_ ABSL_GUARDED_BY(mutex_) = false;
};

class PointCloudCall final
    : public grpc::ClientReadReactor<pb::GetPointCloudResponse> {
 public:
  PointCloudCall(CallBook* book,
                 std::function<bool(pb::GetPointCloudResponse)> on_block,
                 std::function<void(absl::Status)> on_end)
      : book_(book),
        on_block_(std::move(on_block)),
        on_end_(std::move(on_end)) {}

  void Start(pb::MapService::Stub& stub,
             const std::string& token,
             const pb::GetPointCloudRequest& request) {
    AddToken(token, context_);
    request_ = request;
    book_->Enter(&context_);
    stub.async()->GetPointCloud(&context_, &request_, this);
    StartRead(&response_);
    StartCall();
  }

  void OnReadDone(bool ok) override {
    if (!ok) return;
    if (!on_block_(std::exchange(response_, {}))) {
      context_.TryCancel();
      return;
    }
    StartRead(&response_);
  }
  void OnDone(const grpc::Status& status) override {
    on_end_(FromGrpc(status));
    on_end_ = nullptr;
    on_block_ = nullptr;
    book_->Leave(&context_);
    delete this;
  }

 private:
  CallBook* const book_;
  std::function<bool(pb::GetPointCloudResponse)> on_block_;
  std::function<void(absl::Status)> on_end_;
  grpc::ClientContext context_;
  pb::GetPointCloudRequest request_;
  pb::GetPointCloudResponse response_;
};

}  // namespace

struct Relay::Parts {
  ClientOptions options;
  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<pb::MapService::Stub> maps;
  std::unique_ptr<pb::TrackingService::Stub> tracking;
  CallBook book;
};

absl::StatusOr<std::unique_ptr<Relay>> Relay::Create(
    const std::string& target, const ClientOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  if (!options.token.empty()) {
    return absl::InvalidArgumentError("token: each call brings its own");
  }
  auto parts = std::make_unique<Parts>();
  parts->options = options;
  ASSIGN_OR_RETURN(parts->channel, MakeChannel(target, options));
  parts->maps = pb::MapService::NewStub(parts->channel);
  parts->tracking = pb::TrackingService::NewStub(parts->channel);
  return std::unique_ptr<Relay>(new Relay(std::move(parts)));
}

Relay::Relay(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}

Relay::~Relay() { parts_->book.CancelAllAndWait(); }

// A call of `service` that is over after `timeout`.
#define GROUNDLOCK_RELAY(service, name, timeout)               \
  void Relay::Call(const std::string& token,                   \
                   const pb::name##Request& request,           \
                   Reply<pb::name##Response> reply) {          \
    using Async = pb::service::StubInterface::async_interface; \
    Start<pb::name##Request, pb::name##Response, Async>(       \
        GROUNDLOCK_STUB_##service->async(),                    \
        &Async::name,                                          \
        &parts_->book,                                         \
        token,                                                 \
        timeout,                                               \
        request,                                               \
        std::move(reply));                                     \
  }
#define GROUNDLOCK_STUB_TrackingService parts_->tracking
#define GROUNDLOCK_STUB_MapService parts_->maps
GROUNDLOCK_RELAY(TrackingService, CreateSession, parts_->options.call_timeout)
GROUNDLOCK_RELAY(TrackingService, ListSessions, parts_->options.call_timeout)
GROUNDLOCK_RELAY(TrackingService, GetSession, parts_->options.call_timeout)
GROUNDLOCK_RELAY(TrackingService, GetCaller, parts_->options.call_timeout)
GROUNDLOCK_RELAY(TrackingService, DeleteSession, parts_->options.call_timeout)
GROUNDLOCK_RELAY(TrackingService, SetTarget, parts_->options.call_timeout)
GROUNDLOCK_RELAY(TrackingService, MoveTarget, parts_->options.call_timeout)
GROUNDLOCK_RELAY(TrackingService, DropTarget, parts_->options.call_timeout)
GROUNDLOCK_RELAY(MapService, ListMaps, parts_->options.call_timeout)
GROUNDLOCK_RELAY(MapService, GetMap, parts_->options.call_timeout)
GROUNDLOCK_RELAY(MapService, DeleteMap, parts_->options.call_timeout)
GROUNDLOCK_RELAY(MapService, AlignMap, std::chrono::milliseconds(0))
GROUNDLOCK_RELAY(MapService, CheckMap, std::chrono::milliseconds(0))
#undef GROUNDLOCK_STUB_MapService
#undef GROUNDLOCK_STUB_TrackingService
#undef GROUNDLOCK_RELAY

std::shared_ptr<RelayedWatch> Relay::Watch(
    const std::string& token,
    const pb::WatchSessionRequest& request,
    std::function<void()> on_start,
    std::function<void(pb::WatchSessionResponse)> on_message,
    std::function<void(absl::Status)> on_end) {
  auto call = std::make_shared<WatchCall>(&parts_->book,
                                          std::move(on_start),
                                          std::move(on_message),
                                          std::move(on_end));
  call->Start(*parts_->tracking, token, request, call);
  return call;
}

void Relay::GetPointCloud(
    const std::string& token,
    const pb::GetPointCloudRequest& request,
    std::function<bool(pb::GetPointCloudResponse)> on_block,
    std::function<void(absl::Status)> on_end) {
  auto* call =
      new PointCloudCall(&parts_->book, std::move(on_block), std::move(on_end));
  call->Start(*parts_->maps, token, request);
}

}  // namespace groundlock::sdk
