// SPDX-License-Identifier: Apache-2.0
#include "server/service/listener.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {
namespace {

// Refusals are many where there are any; they are told together.
constexpr std::chrono::seconds kLogInterval(10);
// For how long nobody is accepted when no descriptor is left.
constexpr int kPauseMs = 100;
// So that one socket's rush does not keep ended connections uncounted.
constexpr int kAcceptedAtATime = 64;

bool Watch(int epoll_fd, int fd, std::uint32_t events) {
  epoll_event event{};
  event.events = events;
  event.data.fd = fd;
  return epoll_ctl(epoll_fd, EPOLL_CTL_ADD, fd, &event) == 0;
}

// The client is told at once by a reset, of which this side keeps nothing: a
// connection closed in order would linger here for a minute.
void Reset(int fd) {
  const linger at_once{1, 0};
  setsockopt(fd, SOL_SOCKET, SO_LINGER, &at_once, sizeof(at_once));
  close(fd);
}

}  // namespace

std::string ClientNetwork(const sockaddr_storage& peer) {
  char text[INET6_ADDRSTRLEN] = "";
  if (peer.ss_family == AF_INET) {
    const auto& v4 = reinterpret_cast<const sockaddr_in&>(peer);
    inet_ntop(AF_INET, &v4.sin_addr, text, sizeof(text));
    return text;
  }
  if (peer.ss_family != AF_INET6) return "";
  in6_addr address = reinterpret_cast<const sockaddr_in6&>(peer).sin6_addr;
  if (IN6_IS_ADDR_V4MAPPED(&address)) {
    inet_ntop(AF_INET, address.s6_addr + 12, text, sizeof(text));
    return text;
  }
  std::memset(address.s6_addr + 8, 0, 8);
  inet_ntop(AF_INET6, &address, text, sizeof(text));
  return absl::StrCat(text, "/64");
}

absl::StatusOr<std::unique_ptr<Listener>> Listener::Open(
    const std::string& address,
    const ConnectionLimits& limits,
    Metrics* metrics) {
  ASSIGN_OR_RETURN(ListeningSockets sockets, ListeningSockets::Open(address));
  std::unique_ptr<Listener> listener(
      new Listener(std::move(sockets), limits, metrics));
  RETURN_IF_ERROR(listener->MakeDescriptors());
  return listener;
}

Listener::Listener(ListeningSockets sockets,
                   const ConnectionLimits& limits,
                   Metrics* metrics)
    : limits_(limits),
      metrics_(metrics),
      port_(sockets.port()),
      sockets_(std::move(sockets)) {}

absl::Status Listener::MakeDescriptors() {
  epoll_fd_ = epoll_create1(EPOLL_CLOEXEC);
  wake_fd_ = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (epoll_fd_ < 0 || wake_fd_ < 0 || !Watch(epoll_fd_, wake_fd_, EPOLLIN)) {
    return absl::UnavailableError(
        absl::StrCat("listen: no descriptors: ", strerror(errno)));
  }
  return absl::OkStatus();
}

Listener::~Listener() {
  Stop();
  if (thread_.joinable()) {
    SetState(State::kEnding);
    thread_.join();
  }
  metrics_->connections -= static_cast<std::int64_t>(networks_.size());
  for (const auto& [fd, network] : networks_) close(fd);
  close(wake_fd_);
  close(epoll_fd_);
}

void Listener::Start(Take take) {
  take_ = std::move(take);
  thread_ = std::thread([this] { Work(); });
}

void Listener::SetState(State state) {
  {
    base::MutexLock lock(&mutex_);
    if (state_ >= state) return;
    state_ = state;
  }
  const std::uint64_t one = 1;
  static_cast<void>(write(wake_fd_, &one, sizeof(one)) == sizeof(one));
}

void Listener::Stop() {
  if (!thread_.joinable()) {
    sockets_.Close();
    return;
  }
  SetState(State::kStopping);
  base::MutexLock lock(&mutex_);
  mutex_.Await([this]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    return state_ >= State::kStopped;
  });
}

void Listener::ListenTo(bool connections) {
  for (const int fd : sockets_.fds()) {
    if (connections) {
      Watch(epoll_fd_, fd, EPOLLIN);
    } else {
      epoll_ctl(epoll_fd_, EPOLL_CTL_DEL, fd, nullptr);
    }
  }
  is_paused_ = !connections;
}

int Listener::WaitMs() const {
  if (is_paused_) return kPauseMs;
  return num_unlogged_ > 0 ? 1'000 : -1;
}

void Listener::Work() {
  ListenTo(true);
  std::array<epoll_event, 64> events;
  for (;;) {
    const int count = epoll_wait(
        epoll_fd_, events.data(), static_cast<int>(events.size()), WaitMs());
    // Those that ended make room for those that come.
    std::vector<int> listening;
    for (int i = 0; i < count; ++i) {
      const int fd = events[static_cast<std::size_t>(i)].data.fd;
      const std::uint32_t what = events[static_cast<std::size_t>(i)].events;
      if (fd == wake_fd_) {
        std::uint64_t ignored = 0;
        static_cast<void>(read(wake_fd_, &ignored, sizeof(ignored)) == 0);
      } else if (networks_.contains(fd)) {
        if ((what & EPOLLHUP) != 0) Forget(fd);
      } else {
        listening.push_back(fd);
      }
    }
    LogRefusals();
    {
      base::MutexLock lock(&mutex_);
      if (state_ == State::kEnding) return;
      if (state_ == State::kStopping) {
        sockets_.Close();
        is_paused_ = false;
        state_ = State::kStopped;
      }
      if (state_ == State::kStopped) continue;
    }
    if (is_paused_) ListenTo(true);
    for (const int fd : listening) AcceptWaiting(fd);
  }
}

void Listener::AcceptWaiting(int listening_fd) {
  for (int i = 0; i < kAcceptedAtATime; ++i) {
    sockaddr_storage peer{};
    socklen_t size = sizeof(peer);
    const int fd = accept4(listening_fd,
                           reinterpret_cast<sockaddr*>(&peer),
                           &size,
                           SOCK_CLOEXEC | SOCK_NONBLOCK);
    bool has_descriptors = true;
    if (fd >= 0) {
      has_descriptors = Admit(fd, listening_fd, ClientNetwork(peer));
    } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
      return;
    } else {
      // Others are errors of a connection that is gone already.
      has_descriptors = errno != EMFILE && errno != ENFILE &&
                        errno != ENOBUFS && errno != ENOMEM;
      if (!has_descriptors) {
        Refuse(-1, "", metrics_->connections_refused_files, strerror(errno));
      }
    }
    if (!has_descriptors) {
      if (!is_paused_) ListenTo(false);
      return;
    }
  }
}

bool Listener::Admit(int fd, int listening_fd, const std::string& network) {
  if (static_cast<int>(networks_.size()) >= limits_.max_connections) {
    Refuse(fd,
           network,
           metrics_->connections_refused_total,
           "more than --max-connections");
    return true;
  }
  const auto count = per_network_.try_emplace(network).first;
  if (!network.empty() && limits_.max_per_address > 0 &&
      count->second >= limits_.max_per_address) {
    Refuse(fd,
           network,
           metrics_->connections_refused_address,
           "more than --max-connections-per-address");
    return true;
  }
  const int second = fcntl(fd, F_DUPFD_CLOEXEC, 0);
  // Told of nothing but errors and the end, and of each once.
  if (second < 0 || !Watch(epoll_fd_, second, EPOLLET)) {
    if (count->second == 0) per_network_.erase(count);
    const std::string why = strerror(errno);
    if (second >= 0) close(second);
    Refuse(fd, network, metrics_->connections_refused_files, why.c_str());
    return false;
  }
  ++count->second;
  networks_.emplace(second, network);
  ++metrics_->connections;
  ++metrics_->connections_taken;
  take_(fd, listening_fd);
  return true;
}

void Listener::Refuse(int fd,
                      const std::string& network,
                      std::atomic<std::uint64_t>& counter,
                      const char* why) {
  if (fd >= 0) Reset(fd);
  ++counter;
  ++num_unlogged_;
  last_refusal_ = absl::StrCat(network.empty() ? "somebody" : network,
                               ", ",
                               why,
                               ", with ",
                               networks_.size(),
                               " open");
}

void Listener::Forget(int fd) {
  const auto connection = networks_.find(fd);
  const auto count = per_network_.find(connection->second);
  if (--count->second == 0) per_network_.erase(count);
  networks_.erase(connection);
  --metrics_->connections;
  close(fd);
}

void Listener::LogRefusals() {
  const auto now = std::chrono::steady_clock::now();
  if (num_unlogged_ == 0 || now < next_log_) return;
  next_log_ = now + kLogInterval;
  spdlog::warn("connections: {} refused; the last one of {}",
               std::exchange(num_unlogged_, 0),
               last_refusal_);
}

}  // namespace groundlock::service
