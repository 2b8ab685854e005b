// SPDX-License-Identifier: Apache-2.0
// The server's metrics in Prometheus' text format over HTTP (/metrics), and
// whether it lives (/livez) and takes new work (/readyz).
#ifndef GROUNDLOCK_SERVER_APP_METRICS_EXPOSER_H_
#define GROUNDLOCK_SERVER_APP_METRICS_EXPOSER_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/app/measured_store.h"
#include "server/app/otlp_exporter.h"
#include "server/service/metrics.h"

namespace groundlock::app {

// Whom the page asks; null = not there.
struct Measured {
  const service::Metrics* metrics = nullptr;  // always there
  const MeasuredStore* store = nullptr;
  const OtlpExporter* exporter = nullptr;
};

class MetricsExposer {
 public:
  // Serves until destroyed. What `measured` points to must outlive it.
  // kUnavailable if the address (host:port) cannot be bound.
  static absl::StatusOr<std::unique_ptr<MetricsExposer>> Start(
      const std::string& address, const Measured& measured);
  ~MetricsExposer();
  MetricsExposer(const MetricsExposer&) = delete;
  MetricsExposer& operator=(const MetricsExposer&) = delete;

  int port() const;

 private:
  struct Parts;
  explicit MetricsExposer(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace groundlock::app

#endif  // GROUNDLOCK_SERVER_APP_METRICS_EXPOSER_H_
