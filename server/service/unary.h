// SPDX-License-Identifier: Apache-2.0
// How unary calls are answered: at once, or from an executor.
#ifndef GROUNDLOCK_SERVER_SERVICE_UNARY_H_
#define GROUNDLOCK_SERVER_SERVICE_UNARY_H_

#include <grpcpp/server_context.h>
#include <grpcpp/support/server_callback.h>

#include <exception>
#include <functional>
#include <utility>

#include "absl/status/status.h"
#include "server/service/background_executor.h"
#include "server/service/convert.h"

namespace groundlock::service {

// No exception of third-party code leaves a handler.
template <typename Work>
absl::Status Guard(Work&& work) {
  try {
    return std::forward<Work>(work)();
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError("out of memory");
  } catch (const std::exception& error) {
    return absl::InternalError(error.what());
  }
}

inline grpc::ServerUnaryReactor* Reply(grpc::CallbackServerContext* context,
                                       const absl::Status& status) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpc(status));
  return reactor;
}

// Runs `work` on the executor, unless the call has been cancelled by then, and
// replies with its status.
inline grpc::ServerUnaryReactor* ReplyFrom(BackgroundExecutor* executor,
                                           grpc::CallbackServerContext* context,
                                           std::function<absl::Status()> work) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  const absl::Status posted =
      executor->TryPost([context, reactor, work = std::move(work)] {
        reactor->Finish(ToGrpc(context->IsCancelled()
                                   ? absl::CancelledError("the client has gone")
                                   : Guard(work)));
      });
  if (!posted.ok()) reactor->Finish(ToGrpc(posted));
  return reactor;
}

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_UNARY_H_
