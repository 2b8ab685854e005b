// SPDX-License-Identifier: Apache-2.0
#include "server/service/caller.h"

#include "absl/strings/str_cat.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {

std::string Caller::Who() const {
  return principal->tenant.empty()
             ? principal->name
             : absl::StrCat(principal->name, " of ", principal->tenant);
}

void Caller::Audit(std::string_view object, const absl::Status& status) const {
  if (!is_audited) return;
  constexpr std::size_t kMaxObject = 128;
  spdlog::info("audit: {} at {} calls {}{}{}: {} [{}]",
               Who(),
               peer,
               method,
               object.empty() ? "" : " of ",
               object.substr(0, kMaxObject),
               absl::StatusCodeToString(status.code()),
               request_id);
}

}  // namespace groundlock::service
