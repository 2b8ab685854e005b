// SPDX-License-Identifier: Apache-2.0
#include "server/service/gate.h"

#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {

void GatedService::Add(const std::string& method,
                       grpc::internal::RpcMethod::RpcType type,
                       grpc::internal::MethodHandler* handler) {
  // gRPC keeps the pointer to the name: the table's lives for ever.
  const MethodRule& rule = RuleOf(Path(method));
  AddMethod(
      new grpc::internal::RpcServiceMethod(rule.method.data(), type, nullptr));
  MarkMethodCallback(num_methods_++, handler);
}

absl::Status GatedService::Admit(
    const MethodRule& rule, const grpc::CallbackServerContext& context) const {
  const auto principal = gate_.access->Authenticate(context);
  absl::Status status = principal.status();
  if (status.ok() && !(*principal)->May(rule.scope)) {
    status = absl::PermissionDeniedError(absl::StrCat(
        (*principal)->name, " may not call ", base::Abseil(rule.short_name())));
  }
  if (!status.ok()) {
    ++gate_.metrics->calls_refused;
    return status;
  }
  // Where callers have names, it is told who changed what and from where.
  if (rule.changes && !gate_.access->open_to_all()) {
    spdlog::info("audit: {} at {} calls {}",
                 (*principal)->name,
                 context.peer(),
                 rule.short_name());
  }
  return status;
}

}  // namespace groundlock::service
