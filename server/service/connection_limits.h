// SPDX-License-Identifier: Apache-2.0
// How many connections there may be, and what each may do.
#ifndef GROUNDLOCK_SERVER_SERVICE_CONNECTION_LIMITS_H_
#define GROUNDLOCK_SERVER_SERVICE_CONNECTION_LIMITS_H_

#include <chrono>

namespace groundlock::service {

struct ConnectionLimits {
  int max_connections = 1'024;
  // Of one IPv4 address, or one IPv6 network of 64 bits; 0 = no limit. Who
  // stands before the server as a proxy has one address for everybody.
  int max_per_address = 256;
  // Calls at a time; gRPC's clients hold back what is more, others are
  // disconnected.
  int max_streams = 1'000;
  // For getting as far as HTTP/2's settings, TLS included.
  std::chrono::milliseconds handshake_timeout = std::chrono::seconds(20);
  // A connection without a call is closed after it; clients make another when
  // they need one.
  std::chrono::milliseconds idle_timeout = std::chrono::minutes(10);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_CONNECTION_LIMITS_H_
