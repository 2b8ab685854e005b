// SPDX-License-Identifier: Apache-2.0
#include "server/service/health_service.h"

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "grpc/health/v1/health.pb.h"

namespace groundlock::service {
namespace {

namespace health = grpc::health::v1;
using Reactor = grpc::ServerBidiReactor<health::HealthCheckRequest,
                                        health::HealthCheckResponse>;

constexpr std::size_t kMaxRequestBytes = 4 << 10;

}  // namespace

// A Check or a Watch. Owns itself until gRPC's last callback.
class HealthService::HealthCall final : public Reactor, public WatchedCall {
 public:
  HealthCall(HealthService* service,
             grpc::CallbackServerContext* context,
             bool watches,
             const CallTerms& terms,
             OpenCalls::Call counted)
      : service_(service),
        context_(context),
        watches_(watches),
        calls_(terms.calls),
        counted_(std::move(counted)),
        first_read_(terms),
        write_(terms.silence) {
    calls_->Add(this);
    first_read_.Begin();
    StartRead(&request_);
  }

  void OnReadDone(bool ok) override {
    const absl::Status status = first_read_.End(ok, request_);
    if (absl::IsCancelled(status)) return;
    if (!status.ok()) {
      Finish(ToGrpc(status));
      return;
    }
    known_ = service_->Knows(request_.service());
    if (watches_) {
      const base::MutexLock lock(&service_->mutex_);
      service_->watchers_.insert(this);
      watching_ = true;
      Pump();
    } else if (known_) {
      const base::MutexLock lock(&service_->mutex_);
      response_.set_status(Status());
      write_.Begin();
      StartWriteAndFinish(&response_, grpc::WriteOptions(), grpc::Status::OK);
    } else {
      Finish(ToGrpc(absl::NotFoundError(
          absl::StrCat("service: there is no ", request_.service()))));
    }
  }
  void OnTick(std::chrono::steady_clock::time_point now) override {
    const absl::Status late = first_read_.OnTick(now);
    if (!late.ok()) Finish(ToGrpc(late));
    // It does not take what it has asked for.
    if (write_.Expire(now)) context_->TryCancel();
  }
  void OnWriteDone(bool ok) override {
    write_.End(ReadDeadline::kAllBack);
    const base::MutexLock lock(&service_->mutex_);
    writing_ = false;
    if (ok) {
      Pump();
    } else {
      End(grpc::Status::CANCELLED);
    }
  }
  void OnCancel() override {
    const base::MutexLock lock(&service_->mutex_);
    if (watching_) End(grpc::Status::CANCELLED);
  }
  void OnDone() override {
    {
      const base::MutexLock lock(&service_->mutex_);
      service_->watchers_.erase(this);
    }
    calls_->Remove(this);
    delete this;
  }

  static void PumpAll(HealthService* service)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(service->mutex_) {
    for (HealthCall* watcher : service->watchers_) {
      watcher->service_->mutex_.AssertHeld();
      watcher->Pump();
    }
  }

 private:
  // Writes what is new.
  void Pump() ABSL_EXCLUSIVE_LOCKS_REQUIRED(service_->mutex_) {
    if (writing_ || ended_) return;
    if (context_->IsCancelled()) {
      End(grpc::Status::CANCELLED);
    } else if (written_ != Status()) {
      written_ = Status();
      response_.set_status(*written_);
      writing_ = true;
      write_.Begin();
      StartWrite(&response_);
    } else if (service_->shut_down_) {
      End(ToGrpc(absl::UnavailableError("the server is shutting down")));
    }
  }
  health::HealthCheckResponse::ServingStatus Status() const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(service_->mutex_) {
    if (!known_) return health::HealthCheckResponse::SERVICE_UNKNOWN;
    return service_->serving_ ? health::HealthCheckResponse::SERVING
                              : health::HealthCheckResponse::NOT_SERVING;
  }
  void End(const grpc::Status& status)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(service_->mutex_) {
    if (std::exchange(ended_, true)) return;
    Finish(status);
  }

  HealthService* const service_;
  grpc::CallbackServerContext* const context_;
  const bool watches_;
  CallWatch* const calls_;
  const OpenCalls::Call counted_;
  FirstRead first_read_;
  ReadDeadline write_;
  health::HealthCheckRequest request_;
  health::HealthCheckResponse response_;
  bool known_ = false;
  bool watching_ ABSL_GUARDED_BY(service_->mutex_) = false;
  bool writing_ ABSL_GUARDED_BY(service_->mutex_) = false;
  bool ended_ ABSL_GUARDED_BY(service_->mutex_) = false;
  std::optional<health::HealthCheckResponse::ServingStatus> written_
      ABSL_GUARDED_BY(service_->mutex_);
};

HealthService::HealthService(const Gate& gate,
                             std::vector<std::string> services)
    : gate_(gate), services_(std::move(services)) {
  Add("/grpc.health.v1.Health/Check", /*watches=*/false);
  Add("/grpc.health.v1.Health/Watch", /*watches=*/true);
}

void HealthService::Add(const char* method, bool watches) {
  AddMethod(new grpc::internal::RpcServiceMethod(
      method, grpc::internal::RpcMethod::BIDI_STREAMING, nullptr));
  MarkMethodCallback(
      num_methods_++,
      new grpc::internal::CallbackBidiHandler<health::HealthCheckRequest,
                                              health::HealthCheckResponse>(
          [this, watches](grpc::CallbackServerContext* context) -> Reactor* {
            auto counted = gate_.open_calls->EnterUnknown(context->peer());
            if (!counted.ok()) {
              return Refuse<Reactor>(counted.status(), nullptr);
            }
            return new HealthCall(
                this,
                context,
                watches,
                {gate_.calls, gate_.silence, kMaxRequestBytes, nullptr},
                *std::move(counted));
          }));
}

bool HealthService::Knows(const std::string& service) const {
  return service.empty() ||
         std::find(services_.begin(), services_.end(), service) !=
             services_.end();
}

void HealthService::SetServing(bool serving) {
  const base::MutexLock lock(&mutex_);
  if (shut_down_) return;
  serving_ = serving;
  HealthCall::PumpAll(this);
}

void HealthService::Shutdown() {
  const base::MutexLock lock(&mutex_);
  serving_ = false;
  shut_down_ = true;
  HealthCall::PumpAll(this);
}

}  // namespace groundlock::service
