// SPDX-License-Identifier: Apache-2.0
// Takes connections in for gRPC, a bounded number of them.
//
// gRPC's own listener (1.51) bounds nothing, and ends for good at the first
// accept() that fails for want of file descriptors: whoever opened as many
// connections as the process may have files closed the server to everybody.
// This one refuses what is too much and goes on.
#ifndef GROUNDLOCK_SERVER_SERVICE_LISTENER_H_
#define GROUNDLOCK_SERVER_SERVICE_LISTENER_H_

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::service {

struct ConnectionLimits {
  // At a time, of all clients. Never more than three quarters of the files that
  // the process may have open, as maps and sessions need some, too.
  int max_connections = 4'000;
  // Of one IPv4 address, or of one IPv6 network of 64 bits; 0 = no more than in
  // total.
  int max_connections_per_address = 1'000;
};

// The open connections, found by asking the system whether a descriptor is
// still the socket that it was: gRPC, who closes them, tells nobody. Not
// thread-safe.
class OpenConnections {
 public:
  explicit OpenConnections(const ConnectionLimits& limits) : limits_(limits) {}

  // Counts `fd`, a connected socket of somebody in `network`; false = there are
  // too many, and it is not counted.
  bool Add(int fd, const std::string& network);
  // Forgets those that have been closed, unless it did so a shorter time ago:
  // it asks the system about every one.
  void SweepIfOlderThan(std::chrono::nanoseconds age);
  std::size_t size() const { return connections_.size(); }

 private:
  struct Connection {
    int fd = -1;
    ino_t inode = 0;
    std::string network;
  };
  bool IsFull(const std::string& network) const;

  const ConnectionLimits limits_;
  std::vector<Connection> connections_;
  std::map<std::string, int> by_network_;  // none that has no connections
  std::chrono::steady_clock::time_point last_sweep_;
};

class Listener {
 public:
  // Owns `fd` from then on: a connected socket that does not block.
  using Take = std::function<void(int listener_fd, int fd)>;

  // Listens at all addresses that HOST:PORT stands for, one port for all; port
  // 0 = any that is free. A wildcard of either family listens at both, where
  // the machine has both.
  //   open     how many connections there are, a second ago at most
  //   refused  how many there have been too many
  // kInvalidArgument: not HOST:PORT; kUnavailable: cannot be bound.
  static absl::StatusOr<std::unique_ptr<Listener>> Bind(
      const std::string& address,
      const ConnectionLimits& limits,
      std::atomic<std::int64_t>* open,
      std::atomic<std::uint64_t>* refused);
  // Stops; what has been taken in stays open.
  ~Listener();

  int port() const { return port_; }
  // Takes connections in from now on, on a thread of its own. Once.
  void Start(Take take);

 private:
  Listener(const ConnectionLimits& limits,
           std::atomic<std::int64_t>* open,
           std::atomic<std::uint64_t>* refused);
  void Run();
  // False: nothing can be taken in for a while.
  bool AcceptSome(int listener_fd);

  OpenConnections connections_;  // of the thread
  std::atomic<std::int64_t>* const open_;
  std::atomic<std::uint64_t>* const refused_;
  Take take_;
  std::vector<int> listening_;
  int stop_ = -1;  // an eventfd
  int port_ = 0;
  std::thread thread_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_LISTENER_H_
