// SPDX-License-Identifier: Apache-2.0
// What a viewer may ask for, before anything is done about it.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_REQUEST_RULES_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_REQUEST_RULES_H_

#include <chrono>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"

namespace groundlock::dashboard {

namespace pb = ::groundlock::dashboard::v1;

// A message as it came. kInvalidArgument: not a ClientMessage, without
// request_id or request, or a field at fault, which is named. What only the
// server can know is left to it.
absl::StatusOr<pb::ClientMessage> ParseRequest(std::string_view bytes);

// So many requests a second, with bursts of twice as many. Not thread-safe.
class RateLimit {
 public:
  explicit RateLimit(double per_second)
      : per_second_(per_second), left_(2.0 * per_second) {}
  // Whether one more is within the limit at this time.
  bool Take(std::chrono::steady_clock::time_point now);

 private:
  const double per_second_;
  double left_;
  std::chrono::steady_clock::time_point last_{};
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_REQUEST_RULES_H_
