// SPDX-License-Identifier: Apache-2.0
#include "server/service/open_calls.h"

#include "absl/status/status.h"

namespace groundlock::service {

absl::StatusOr<OpenCalls::Call> OpenCalls::Enter(
    const std::string& peer) const {
  if (peer.starts_with("unix:")) return Call();
  bool is_let_in = false;
  {
    base::MutexLock lock(&counts_->mutex);
    const auto count = counts_->calls.try_emplace(peer).first;
    is_let_in = count->second < max_calls_;
    if (is_let_in) ++count->second;
  }
  if (!is_let_in) {
    end_(peer);
    return absl::ResourceExhaustedError(
        "more calls than a connection may have: the server ends it");
  }
  return Call(nullptr, [counts = counts_, peer](std::nullptr_t) {
    base::MutexLock lock(&counts->mutex);
    const auto count = counts->calls.find(peer);
    if (--count->second == 0) counts->calls.erase(count);
  });
}

}  // namespace groundlock::service
