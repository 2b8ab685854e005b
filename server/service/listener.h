// SPDX-License-Identifier: Apache-2.0
// Takes connections, no more of them than it is told to. gRPC 1.51 has no limit
// of its own; it is given each connection that is taken.
#ifndef GROUNDLOCK_SERVER_SERVICE_LISTENER_H_
#define GROUNDLOCK_SERVER_SERVICE_LISTENER_H_

#include <sys/socket.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "server/service/connection_limits.h"
#include "server/service/listening_sockets.h"
#include "server/service/metrics.h"

namespace groundlock::service {

// Whom a connection is counted for: an IPv4 address, also where IPv6 carries
// it; of IPv6 the network of 64 bits, all of whose addresses one customer has;
// empty for a Unix socket, whose clients are not told apart.
std::string ClientNetwork(const sockaddr_storage& peer);

// Thread-safe. What becomes of a connection that was handed on is seen by a
// second descriptor of the same socket: the kernel marks it as hung up when
// both directions are shut down, by the client's reset or by whoever was given
// the first descriptor. That one must shut the socket down before it closes it,
// as gRPC does (grpc_fd_orphan); closing alone would not be seen.
class Listener {
 public:
  // What is given a connection: its descriptor, which it owns, and that of the
  // listening socket. Called from the listener's thread; must not block.
  using Take = std::function<void(int fd, int listening_fd)>;

  // Listens; nothing is accepted before Start. Errors: ListeningSockets::Open.
  //   metrics  outlives the listener.
  static absl::StatusOr<std::unique_ptr<Listener>> Open(
      const std::string& address,
      const ConnectionLimits& limits,
      Metrics* metrics);
  ~Listener();
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;

  int port() const { return port_; }
  // Once.
  void Start(Take take);
  // Takes no more connections; those that are open stay counted. `take` is not
  // called any more when it returns. Not from `take`.
  void Stop();

 private:
  enum class State { kAccepting, kStopping, kStopped, kEnding };

  Listener(ListeningSockets sockets,
           const ConnectionLimits& limits,
           Metrics* metrics);
  absl::Status MakeDescriptors();
  void SetState(State state);
  void Work();
  void AcceptWaiting(int listening_fd);
  // False if no descriptor is left to take it with.
  bool Admit(int fd, int listening_fd, const std::string& network);
  void Refuse(int fd,
              const std::string& network,
              std::atomic<std::uint64_t>& counter,
              const char* why);
  void Forget(int fd);
  // Whether connections are accepted at the moment.
  void ListenTo(bool connections);
  int WaitMs() const;
  void LogRefusals();

  const ConnectionLimits limits_;
  Metrics* const metrics_;
  const int port_;
  int epoll_fd_ = -1;
  int wake_fd_ = -1;
  Take take_;

  // The thread's alone.
  ListeningSockets sockets_;
  std::map<int, std::string> networks_;     // by the second descriptor
  std::map<std::string, int> per_network_;  // connections
  bool is_paused_ = false;                  // no descriptor was left
  std::uint64_t num_unlogged_ = 0;          // refusals
  std::string last_refusal_;
  std::chrono::steady_clock::time_point next_log_{};

  base::Mutex mutex_;
  State state_ ABSL_GUARDED_BY(mutex_) = State::kAccepting;
  std::thread thread_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_LISTENER_H_
