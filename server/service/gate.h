// SPDX-License-Identifier: Apache-2.0
// The one way into the server: every method of the API is registered here, with
// the rule that MethodRules has for it, and nothing of a request is read before
// its caller is let in.
#ifndef GROUNDLOCK_SERVER_SERVICE_GATE_H_
#define GROUNDLOCK_SERVER_SERVICE_GATE_H_

#include <grpcpp/impl/codegen/proto_utils.h>
#include <grpcpp/impl/codegen/server_callback_handlers.h>
#include <grpcpp/impl/rpc_service_method.h>
#include <grpcpp/impl/service_type.h>
#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <chrono>
#include <functional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/storage/store.h"
#include "server/service/access.h"
#include "server/service/call_watch.h"
#include "server/service/caller.h"
#include "server/service/convert.h"
#include "server/service/method_rules.h"
#include "server/service/metrics.h"
#include "server/service/open_calls.h"
#include "server/service/unary_call.h"
#include "server/service/whole_messages.h"

namespace groundlock::service {

// What all methods share. Everything pointed to outlives the services.
struct Gate {
  const Access* access = nullptr;
  CallWatch* calls = nullptr;
  const OpenCalls* open_calls = nullptr;
  WholeMessages* whole_messages = nullptr;  // null = nobody wants to know
  Metrics* metrics = nullptr;
  storage::Store* maps = nullptr;  // of all tenants
  // How long a client may keep a call waiting for its request or an upload's
  // next piece (ReadDeadline).
  std::chrono::nanoseconds silence{std::chrono::seconds(60)};
};

// The reactor of a call that is refused. counted: held until that is over.
template <typename Reactor>
Reactor* Refuse(const absl::Status& status, OpenCalls::Call counted) {
  class Refusal final : public Reactor {
   public:
    Refusal(const absl::Status& reason, OpenCalls::Call call)
        : counted_(std::move(call)) {
      this->Finish(ToGrpc(reason));
    }
    void OnDone() override { delete this; }

   private:
    const OpenCalls::Call counted_;
  };
  return new Refusal(status, std::move(counted));
}

// A service whose methods are registered one by one. For gRPC each is a stream,
// whatever the .proto says, which looks the same on the wire: of a unary method
// gRPC would read the whole request, up to the largest message, before anybody
// could ask who sends it.
class GatedService : public grpc::Service {
 protected:
  // service: "package.Service".
  GatedService(std::string service, const Gate& gate)
      : service_(std::move(service)), gate_(gate) {}

  const Gate& gate() const { return gate_; }

  // handler: answers the call, by its Reply or ReplyFrom.
  template <typename Self, typename Request, typename Response>
  void AddUnary(const std::string& method,
                Self* self,
                void (Self::*handler)(UnaryCall<Request, Response>&)) {
    AddStream<Request, Response>(
        method,
        [self, handler](grpc::CallbackServerContext* context,
                        const CallTerms& terms) {
          return UnaryCall<Request, Response>::Start(
              context,
              terms,
              [self, handler](UnaryCall<Request, Response>& call) {
                (self->*handler)(call);
              });
        });
  }

  // start: makes the call's reactor, which reads its first request within the
  // terms' limits.
  template <typename Request, typename Response>
  void AddStream(const std::string& method,
                 std::function<grpc::ServerBidiReactor<Request, Response>*(
                     grpc::CallbackServerContext*, const CallTerms&)> start) {
    using Reactor = grpc::ServerBidiReactor<Request, Response>;
    Add(method,
        grpc::internal::RpcMethod::BIDI_STREAMING,
        new grpc::internal::CallbackBidiHandler<Request, Response>(
            [this, start = std::move(start), rule = &RuleOf(Path(method))](
                grpc::CallbackServerContext* context) -> Reactor* {
              OpenCalls::Call counted;
              auto caller = Admit(*rule, *context, counted);
              if (!caller.ok()) {
                return Refuse<Reactor>(caller.status(), std::move(counted));
              }
              return start(context,
                           {gate_.calls,
                            gate_.silence,
                            rule->max_request_bytes,
                            *std::move(caller)});
            }));
  }

  // The same for a stream of requests that has one answer.
  template <typename Request, typename Response>
  void AddUpload(
      const std::string& method,
      std::function<grpc::ServerReadReactor<Request>*(
          grpc::CallbackServerContext*, const CallerPtr&, Response*)> start) {
    using Reactor = grpc::ServerReadReactor<Request>;
    Add(method,
        grpc::internal::RpcMethod::CLIENT_STREAMING,
        new grpc::internal::CallbackClientStreamingHandler<Request, Response>(
            [this, start = std::move(start), rule = &RuleOf(Path(method))](
                grpc::CallbackServerContext* context,
                Response* response) -> Reactor* {
              OpenCalls::Call counted;
              const auto caller = Admit(*rule, *context, counted);
              if (!caller.ok()) {
                return Refuse<Reactor>(caller.status(), std::move(counted));
              }
              return start(context, *caller, response);
            }));
  }

 private:
  std::string Path(const std::string& method) const {
    return "/" + service_ + "/" + method;
  }
  void Add(const std::string& method,
           grpc::internal::RpcMethod::RpcType type,
           grpc::internal::MethodHandler* handler);
  // counted: the call, unless there are too many; the caller has it, too.
  absl::StatusOr<CallerPtr> Admit(const MethodRule& rule,
                                  const grpc::CallbackServerContext& context,
                                  OpenCalls::Call& counted) const;

  const std::string service_;
  const Gate gate_;
  int num_methods_ = 0;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_GATE_H_
