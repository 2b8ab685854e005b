// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SERVER_ADDRESS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SERVER_ADDRESS_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "client/sdk/client.h"

namespace groundlock::dashboard {

// The Groundlock server, and how it is spoken to.
struct ServerAddress {
  std::string target = "127.0.0.1:50551";  // as for sdk::Client::Connect
  sdk::ClientTls tls;

  // A connection in the name of whoever has the token.
  absl::StatusOr<std::unique_ptr<sdk::Client>> Connect(
      const std::string& token) const {
    sdk::ClientOptions options;
    options.tls = tls;
    options.token = token;
    return sdk::Client::Connect(target, options);
  }
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SERVER_ADDRESS_H_
