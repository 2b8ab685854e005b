// SPDX-License-Identifier: Apache-2.0
// What the dashboard counts about itself, in Prometheus' text format.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_DASHBOARD_METRICS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_DASHBOARD_METRICS_H_

#include <array>
#include <atomic>
#include <cstdint>
#include <string>

namespace groundlock::dashboard {

struct Core;

// Counted without locks. Thread-safe.
struct DashboardCounters {
  // By the hundreds of their status; files that are sent in parts are not
  // among them.
  std::array<std::atomic<std::uint64_t>, 6> answers{};
  std::atomic<std::uint64_t> messages_sent{0};  // to viewers
  std::atomic<std::uint64_t> bytes_sent{0};
  // Viewers were too slow for them.
  std::atomic<std::uint64_t> results_left_out{0};
  std::atomic<std::uint64_t> images_left_out{0};
  std::atomic<std::uint64_t> viewers_stalled{0};  // and were disconnected
};

// The page, as it is now. Thread-safe.
std::string MetricsText(const Core& core);

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_DASHBOARD_METRICS_H_
