// SPDX-License-Identifier: Apache-2.0
// Sends spans to a collector by OTLP over HTTP, as JSON. Debian 12 has no
// OpenTelemetry library for C++.
// Source: OpenTelemetry Protocol Specification 1.0, "OTLP/HTTP" (JSON encoding,
// responses, retrying).
#ifndef GROUNDLOCK_SERVER_APP_OTLP_EXPORTER_H_
#define GROUNDLOCK_SERVER_APP_OTLP_EXPORTER_H_

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <thread>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/spans.h"

namespace groundlock::app {

// The body of an export request.
std::string OtlpJson(std::span<const service::Span> spans,
                     const std::string& instance);

class OtlpExporter {
 public:
  // Sends until destroyed, then once more what is left. queue must outlive it.
  //   endpoint  http://HOST[:PORT][/PATH], of a collector nearby: there is no
  //             TLS; port 4318 and /v1/traces unless told otherwise
  //   instance  what tells this server from others
  // kInvalidArgument: it is none. A collector that is away is no error: what it
  // misses is counted.
  static absl::StatusOr<std::unique_ptr<OtlpExporter>> Start(
      const std::string& endpoint,
      const std::string& instance,
      service::SpanQueue* queue);
  ~OtlpExporter();
  OtlpExporter(const OtlpExporter&) = delete;
  OtlpExporter& operator=(const OtlpExporter&) = delete;

  std::uint64_t num_sent() const { return num_sent_; }
  // The collector was away, or did not want them.
  std::uint64_t num_failed() const { return num_failed_; }

 private:
  struct Endpoint {
    std::string host;
    std::string port = "4318";
    std::string path = "/v1/traces";
  };
  OtlpExporter(Endpoint endpoint,
               std::string instance,
               service::SpanQueue* queue);

  static absl::StatusOr<Endpoint> Parse(const std::string& endpoint);
  void Work();
  // kUnavailable: another try may succeed.
  absl::Status Send(const std::string& body) const;

  const Endpoint endpoint_;
  const std::string instance_;
  service::SpanQueue* const queue_;
  std::atomic<std::uint64_t> num_sent_{0};
  std::atomic<std::uint64_t> num_failed_{0};
  std::thread thread_;
};

}  // namespace groundlock::app

#endif  // GROUNDLOCK_SERVER_APP_OTLP_EXPORTER_H_
