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
#include "server/service/convert.h"
#include "server/service/unary.h"

namespace groundlock::service {

// Owns itself until gRPC's last callback. At any time either the executor or
// gRPC has it, so nothing needs a lock.
template <typename Response>
class ProducingStream final : public grpc::ServerWriteReactor<Response> {
 public:
  // Fills the next message and returns true, or returns false at the end.
  using Producer = std::function<absl::StatusOr<bool>(Response&)>;

  // first: makes the first message, which may take long; then: the others.
  static ProducingStream* Start(Producer producer,
                                BackgroundExecutor* first,
                                BackgroundExecutor* then) {
    auto* stream = new ProducingStream(std::move(producer), then);
    const absl::Status posted = first->TryPost([stream] { stream->Produce(); });
    if (!posted.ok()) stream->Finish(ToGrpc(posted));
    return stream;
  }

  void OnWriteDone(bool ok) override {
    if (!ok) cancelled_ = true;
    then_->Post([this] { Produce(); });
  }
  void OnCancel() override { cancelled_ = true; }
  void OnDone() override { delete this; }

 private:
  ProducingStream(Producer producer, BackgroundExecutor* then)
      : producer_(std::move(producer)), then_(then) {}

  void Produce() {
    absl::StatusOr<bool> more = absl::CancelledError("the client has gone");
    if (!cancelled_) {
      response_.Clear();
      const absl::Status status = Guard([this, &more] {
        more = producer_(response_);
        return more.status();
      });
      if (!status.ok()) more = status;
    }
    if (more.ok() && *more) {
      this->StartWrite(&response_);
    } else {
      producer_ = nullptr;  // its files go here, on the executor
      this->Finish(ToGrpc(more.status()));
    }
  }

  Producer producer_;
  BackgroundExecutor* const then_;
  Response response_;
  std::atomic<bool> cancelled_{false};
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_PRODUCING_STREAM_H_
