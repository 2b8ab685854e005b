// SPDX-License-Identifier: Apache-2.0
// Takes connections in for gRPC, a bounded number of them.
//
// gRPC's own listener (1.51) bounds nothing, and ends for good at the first
// accept() that fails for want of file descriptors: whoever opened as many
// connections as the process may have files closed the server to everybody.
// This one refuses what is too much and goes on.
#ifndef GROUNDLOCK_SERVER_SERVICE_LISTENER_H_
#define GROUNDLOCK_SERVER_SERVICE_LISTENER_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "server/service/open_connections.h"

namespace groundlock::service {

class Listener {
 public:
  struct Counts {
    std::atomic<std::int64_t>* open = nullptr;
    std::atomic<std::uint64_t>* refused = nullptr;
    std::atomic<std::uint64_t>* ended = nullptr;
  };
  // Owns `fd` from then on: a connected socket that does not block.
  using Take = std::function<void(int listener_fd, int fd)>;

  // Listens at all addresses that HOST:PORT stands for, one port for all; port
  // 0 = any that is free. A wildcard of either family listens at both, where
  // the machine has both.
  //   open     how many connections there are, a second ago at most
  //   refused  how many there have been too many
  //   ended    how many were ended for what they had sent half
  // kInvalidArgument: not HOST:PORT; kUnavailable: cannot be bound.
  static absl::StatusOr<std::unique_ptr<Listener>> Bind(
      const std::string& address,
      const ConnectionLimits& limits,
      const PartialMessageLimit& partial,
      const Counts& counts);
  // Stops; what has been taken in stays open.
  ~Listener();

  int port() const { return port_; }
  // Takes connections in from now on, on a thread of its own. Once.
  void Start(Take take);

 private:
  Listener(const ConnectionLimits& limits,
           const PartialMessageLimit& partial,
           const Counts& counts);
  void Run();
  void BoundPartialMessages();
  // How long until connections are looked at again.
  int Patience_ms() const;
  // False: nothing can be taken in for a while.
  bool AcceptSome(int listener_fd);

  OpenConnections connections_;  // of the thread
  const PartialMessageLimit partial_;
  const Counts counts_;
  Take take_;
  std::vector<int> listening_;
  int stop_ = -1;  // an eventfd
  int port_ = 0;
  std::thread thread_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_LISTENER_H_
