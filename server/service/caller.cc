// SPDX-License-Identifier: Apache-2.0
#include "server/service/caller.h"

#include "absl/strings/str_cat.h"
#include "server/service/whole_messages.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {

std::string Caller::Who() const {
  return principal->tenant.empty()
             ? principal->name
             : absl::StrCat(principal->name, " of ", principal->tenant);
}

base::LogFields Caller::Fields(std::string_view session) const {
  return base::LogFields({{"request_id", request_id},
                          {"principal", principal->name},
                          {"tenant", principal->tenant},
                          {"peer", peer},
                          {"session", session}});
}

void Caller::CountMessage(std::size_t bytes) const {
  if (whole_messages != nullptr) whole_messages->Add(peer, bytes);
}

void Caller::Tell(std::string_view object, const absl::Status& status) const {
  constexpr std::size_t kMaxObject = 128;
  object = object.substr(0, kMaxObject);
  if (span != nullptr) {
    span->End(
        status,
        {{"rpc.system", std::string("grpc")},
         {"rpc.method", std::string(method)},
         {"rpc.grpc.status_code", static_cast<std::int64_t>(status.code())},
         {"groundlock.request_id", request_id},
         {"groundlock.principal", principal->name},
         {"groundlock.tenant", principal->tenant},
         {method.ends_with("Map") ? "groundlock.map" : "groundlock.session",
          std::string(object)},
         {"client.address", peer}});
  }
  if (!is_audited) return;
  const base::LogFields who = Fields();
  const base::LogFields what(
      {{"method", method},
       {method.ends_with("Map") ? "map" : "session", object},
       {"status", absl::StatusCodeToString(status.code())}});
  spdlog::info("audit: {} at {} calls {}{}{}: {} [{}]",
               Who(),
               peer,
               method,
               object.empty() ? "" : " of ",
               object,
               absl::StatusCodeToString(status.code()),
               request_id);
}

}  // namespace groundlock::service
