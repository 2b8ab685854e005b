// SPDX-License-Identifier: Apache-2.0
// Who makes a call that the gate has let in.
#ifndef GROUNDLOCK_SERVER_SERVICE_CALLER_H_
#define GROUNDLOCK_SERVER_SERVICE_CALLER_H_

#include <cstddef>
#include <memory>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "map_store/base/logging.h"
#include "server/service/open_calls.h"
#include "server/service/principal.h"
#include "server/service/spans.h"

namespace groundlock::service {

class TenantStore;
class WholeMessages;

// Immutable, so thread-safe; calls share it.
struct Caller {
  std::shared_ptr<const Principal> principal;
  std::shared_ptr<TenantStore> maps;  // of its tenant
  std::string peer;                   // "ipv4:192.0.2.1:40000"
  std::string request_id;             // of the call, in the log
  std::string_view method;            // "DeleteMap"
  // Whether what this call does is told to the audit log.
  bool is_audited = false;
  std::shared_ptr<CallSpan> span;  // of the call
  // For as long as anybody has this, the call is open.
  OpenCalls::Call counted;
  WholeMessages* whole_messages = nullptr;

  // A message of `bytes` of this call has been read.
  void CountMessage(std::size_t bytes) const;
  // What came of the call: ends its span and, if it is audited, writes one
  // line: who has done what to which of theirs, from where. Of a stream that
  // stays, when it is let in. object: a session or a map; empty = none.
  void Tell(std::string_view object, const absl::Status& status) const;
  // "PRINCIPAL", or "PRINCIPAL of TENANT"; for the log.
  std::string Who() const;
  // Who and which call, for all that this thread logs meanwhile; session:
  // that the call is about; empty = none, or not known.
  base::LogFields Fields(std::string_view session = {}) const;
};
using CallerPtr = std::shared_ptr<const Caller>;

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_CALLER_H_
