// SPDX-License-Identifier: Apache-2.0
#include "server/service/gate.h"

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
    const MethodRule& /*rule*/,
    const grpc::CallbackServerContext& context) const {
  return gate_.access->Check(context);
}

}  // namespace groundlock::service
