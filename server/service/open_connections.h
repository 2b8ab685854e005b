// SPDX-License-Identifier: Apache-2.0
// The connections of clients, how many they are and what lies half received.
#ifndef GROUNDLOCK_SERVER_SERVICE_OPEN_CONNECTIONS_H_
#define GROUNDLOCK_SERVER_SERVICE_OPEN_CONNECTIONS_H_

#include <sys/types.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "server/service/whole_messages.h"

namespace groundlock::service {

struct ConnectionLimits {
  // At a time, of all clients. Never more than three quarters of the files that
  // the process may have open, as maps and sessions need some, too.
  int max_connections = 4'000;
  // Of one IPv4 address, or of one IPv6 network of 64 bits; 0 = no more than in
  // total.
  int max_connections_per_address = 1'000;
};

// gRPC keeps what has come of a message until the message is whole. When that
// fills its memory it sends away whoever has no call just then, which is who
// has just come, and only then breaks calls off: those who send half a message
// and fall silent stay, and nobody else gets in. So it must not come to that.
struct PartialMessageLimit {
  // What calls have read; null = there is no limit.
  const WholeMessages* whole = nullptr;
  // Of all connections together.
  std::int64_t max_bytes = 0;
  // A message that is that old has been given up (ReadDeadline).
  std::chrono::nanoseconds given_up_after{std::chrono::seconds(60)};
};

// The open connections, found by asking the system whether a descriptor is
// still the socket that it was: gRPC, who closes them, tells nobody. Not
// thread-safe.
class OpenConnections {
 public:
  explicit OpenConnections(const ConnectionLimits& limits,
                           const PartialMessageLimit& partial = {})
      : limits_(limits), partial_(partial) {}

  // Counts `fd`, a connected socket of somebody in `network` who calls from
  // `peer_port`; false = there are too many, and it is not counted.
  bool Add(int fd, const std::string& network, int peer_port);
  // Forgets those that have been closed, unless it did so a shorter time ago:
  // it asks the system about every one.
  void SweepIfOlderThan(std::chrono::nanoseconds age);
  // If more lies half received than may, ends connections that have more than
  // an equal share of it, those first that have been silent for longest, until
  // half of it is free. Returns how many.
  int BoundPartialMessages();
  // Bytes that no call has read as a message, as of the last bounding.
  double partial_bytes() const { return partial_bytes_; }
  std::size_t size() const { return connections_.size(); }

 private:
  using Clock = std::chrono::steady_clock;
  struct Connection {
    int fd = -1;
    ino_t inode = 0;
    std::string network;
    int peer_port = 0;
    std::uint64_t received_bytes = 0;  // in all
    std::uint64_t whole_bytes = 0;     // WholeMessages' count for the port
    double partial_bytes = 0.0;
    std::uint32_t silence_ms = 0;
  };
  bool IsFull(const std::string& network) const;
  // decay: what is left of bytes that were there before.
  void Measure(Connection& connection, double decay) const;

  const ConnectionLimits limits_;
  const PartialMessageLimit partial_;
  std::vector<Connection> connections_;
  std::map<std::string, int> by_network_;  // none that has no connections
  double partial_bytes_ = 0.0;
  Clock::time_point last_sweep_;
  Clock::time_point last_bounding_ = Clock::now();
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_OPEN_CONNECTIONS_H_
