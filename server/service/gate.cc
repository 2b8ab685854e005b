// SPDX-License-Identifier: Apache-2.0
#include "server/service/gate.h"

#include <atomic>
#include <random>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "server/service/tenant_store.h"

namespace groundlock::service {
namespace {

// Unlike those of this server's other calls, and of other servers' in one log.
std::string NextRequestId() {
  static const unsigned server = std::random_device()();
  static std::atomic<std::uint64_t> number{0};
  return absl::StrFormat("%08x-%x", server, ++number);
}

}  // namespace

void GatedService::Add(const std::string& method,
                       grpc::internal::RpcMethod::RpcType type,
                       grpc::internal::MethodHandler* handler) {
  // gRPC keeps the pointer to the name: the table's lives for ever.
  const MethodRule& rule = RuleOf(Path(method));
  AddMethod(
      new grpc::internal::RpcServiceMethod(rule.method.data(), type, nullptr));
  MarkMethodCallback(num_methods_++, handler);
}

absl::StatusOr<CallerPtr> GatedService::Admit(
    const MethodRule& rule,
    const grpc::CallbackServerContext& context,
    OpenCalls::Call& counted) const {
  const std::string peer = context.peer();
  ASSIGN_OR_RETURN(counted, gate_.open_calls->Enter(peer));
  auto principal = gate_.access->Authenticate(context);
  if (!principal.ok()) {
    ++gate_.metrics->calls_unauthenticated;
    return principal.status();
  }
  if (rule.any_of != kNoScopes && ((*principal)->scopes & rule.any_of) == 0) {
    ++gate_.metrics->calls_denied;
    return absl::PermissionDeniedError(
        absl::StrCat((*principal)->name,
                     " may not call ",
                     base::Abseil(rule.short_name()),
                     ", which wants ",
                     absl::StrJoin(ScopeNames(rule.any_of), " or ")));
  }
  auto caller = std::make_shared<Caller>();
  caller->principal = *std::move(principal);
  caller->maps = std::make_shared<TenantStore>(
      gate_.maps, caller->principal->tenant, caller->principal->account);
  caller->peer = peer;
  caller->counted = counted;
  caller->whole_messages = gate_.whole_messages;
  caller->request_id = NextRequestId();
  caller->method = rule.short_name();
  if (SpanQueue* spans = gate_.metrics->spans; spans != nullptr) {
    const auto& metadata = context.client_metadata();
    const auto header = metadata.find("traceparent");
    const auto parent =
        header == metadata.end()
            ? std::nullopt
            : ParseTraceParent({header->second.data(), header->second.size()});
    caller->span = std::make_shared<CallSpan>(
        spans, std::string(rule.short_name()), parent.value_or(SpanContext()));
  }
  // Where callers have no names there is nobody to tell of.
  caller->is_audited = rule.changes && !gate_.access->open_to_all();
  return CallerPtr(std::move(caller));
}

}  // namespace groundlock::service
