// SPDX-License-Identifier: Apache-2.0
// The dashboard: a web page for browsers, gRPC to the Groundlock server.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_DASHBOARD_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_DASHBOARD_H_

#include <memory>

#include "absl/status/statusor.h"
#include "client/dashboard/proxy/options.h"

namespace groundlock::dashboard {

class Dashboard {
 public:
  // Starts to listen; the server need not be there yet. kInvalidArgument
  // (options), kUnavailable (the address cannot be bound), kFailedPrecondition
  // (a folder cannot be used).
  static absl::StatusOr<std::unique_ptr<Dashboard>> Start(
      const DashboardOptions& options);
  // Closes all connections and finishes recordings.
  ~Dashboard();
  Dashboard(const Dashboard&) = delete;
  Dashboard& operator=(const Dashboard&) = delete;

  int port() const;
  int metrics_port() const;  // 0 = none
  int num_viewers() const;

 private:
  struct Parts;
  explicit Dashboard(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_DASHBOARD_H_
