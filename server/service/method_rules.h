// SPDX-License-Identifier: Apache-2.0
// What each method of the API asks of its caller: the one table.
#ifndef GROUNDLOCK_SERVER_SERVICE_METHOD_RULES_H_
#define GROUNDLOCK_SERVER_SERVICE_METHOD_RULES_H_

#include <cstddef>
#include <span>
#include <string_view>

#include "server/service/principal.h"

namespace groundlock::service {

struct MethodRule {
  // As it is on the wire: "/package.Service/Method".
  std::string_view method;
  // Its caller must have one of them; none: must be known.
  Scopes any_of = kNoScopes;
  bool changes = false;  // something: such calls are logged
  // Largest (first) request; 0 = the server's limit of messages. Only images
  // and chunks of files need more than some kilobytes.
  std::size_t max_request_bytes = 0;

  // "Method".
  std::string_view short_name() const {
    return method.substr(method.rfind('/') + 1);
  }
};

std::span<const MethodRule> MethodRules();

// The rule of a method of ours; it must have one.
const MethodRule& RuleOf(std::string_view method);

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_METHOD_RULES_H_
