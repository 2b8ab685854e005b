// SPDX-License-Identifier: Apache-2.0
#include "server/service/listener.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/tcp.h>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "server/service/open_calls.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {
namespace {

constexpr int kBetweenCounts_ms = 1'000;
// As long as what lies half received is far from its limit, and from then on:
// ten gigabits a second bring 250 MB in 200 ms, half of the default limit.
constexpr int kBetweenLooks_ms = 200;
constexpr int kBetweenCloseLooks_ms = 20;
constexpr double kCloseShare = 0.25;
// Taken in from one socket before the others and the end are looked after, so
// that a flood at one holds up neither.
constexpr int kMostAtOnce = 64;
constexpr int kMostPort = 65'535;
constexpr int kWithoutDescriptors_ms = 100;

// No more than leave the process its files.
ConnectionLimits Bounded(ConnectionLimits limits) {
  rlimit files{};
  if (getrlimit(RLIMIT_NOFILE, &files) == 0 &&
      files.rlim_cur != RLIM_INFINITY) {
    const auto most =
        static_cast<int>(std::min<rlim_t>(files.rlim_cur, 1 << 20) * 3 / 4);
    limits.max_connections =
        std::max(1, std::min(limits.max_connections, most));
  }
  if (limits.max_connections_per_address == 0) {
    limits.max_connections_per_address = limits.max_connections;
  }
  return limits;
}

// As gRPC names a peer, so that NetworkOf knows it.
std::string PeerName(const sockaddr_storage& address) {
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (address.ss_family == AF_INET) {
    const auto& ipv4 = reinterpret_cast<const sockaddr_in&>(address);
    inet_ntop(AF_INET, &ipv4.sin_addr, text.data(), text.size());
    return absl::StrCat("ipv4:", text.data(), ":0");
  }
  const auto& ipv6 = reinterpret_cast<const sockaddr_in6&>(address);
  if (IN6_IS_ADDR_V4MAPPED(&ipv6.sin6_addr)) {
    constexpr std::size_t kPrefixBytes = 12;
    inet_ntop(AF_INET,
              ipv6.sin6_addr.s6_addr + kPrefixBytes,
              text.data(),
              text.size());
    return absl::StrCat("ipv4:", text.data(), ":0");
  }
  inet_ntop(AF_INET6, &ipv6.sin6_addr, text.data(), text.size());
  return absl::StrCat("ipv6:[", text.data(), "]:0");
}

int PortOf(const sockaddr_storage& address) {
  return ntohs(address.ss_family == AF_INET6
                   ? reinterpret_cast<const sockaddr_in6&>(address).sin6_port
                   : reinterpret_cast<const sockaddr_in&>(address).sin_port);
}

int PortOfSocket(int fd) {
  sockaddr_storage address{};
  socklen_t size = sizeof(address);
  if (getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    return 0;
  }
  return PortOf(address);
}

void SetPort(sockaddr_storage& address, int port) {
  const in_port_t wire = htons(static_cast<std::uint16_t>(port));
  if (address.ss_family == AF_INET6) {
    reinterpret_cast<sockaddr_in6&>(address).sin6_port = wire;
  } else {
    reinterpret_cast<sockaddr_in&>(address).sin_port = wire;
  }
}

bool IsWildcard(const sockaddr_storage& address) {
  if (address.ss_family == AF_INET) {
    return reinterpret_cast<const sockaddr_in&>(address).sin_addr.s_addr ==
           htonl(INADDR_ANY);
  }
  return IN6_IS_ADDR_UNSPECIFIED(
      &reinterpret_cast<const sockaddr_in6&>(address).sin6_addr);
}

// The listening socket, or -1 with errno. IPv6 sockets take IPv4 in, too, if
// `both`.
int ListenAt(const sockaddr_storage& address, bool both) {
  const int fd =
      socket(address.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd < 0) return -1;
  const int yes = 1;
  setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes));
  const socklen_t size = address.ss_family == AF_INET6 ? sizeof(sockaddr_in6)
                                                       : sizeof(sockaddr_in);
  if (address.ss_family == AF_INET6) {
    const int only_ipv6 = both ? 0 : 1;
    setsockopt(fd, IPPROTO_IPV6, IPV6_V6ONLY, &only_ipv6, sizeof(only_ipv6));
  }
  if (bind(fd, reinterpret_cast<const sockaddr*>(&address), size) != 0 ||
      listen(fd, SOMAXCONN) != 0) {
    const int error = errno;
    close(fd);
    errno = error;
    return -1;
  }
  return fd;
}

absl::StatusOr<std::vector<sockaddr_storage>> Resolve(
    const std::string& address) {
  const std::size_t colon = address.rfind(':');
  std::string host = address.substr(0, colon);
  int port = 0;
  if (colon == std::string::npos ||
      !absl::SimpleAtoi(address.substr(colon + 1), &port) || port < 0 ||
      port > kMostPort) {
    return absl::InvalidArgumentError(absl::StrCat(
        "listen: '", address, "': expected HOST:PORT, PORT up to 65535"));
  }
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  const int error = getaddrinfo(host.empty() ? nullptr : host.c_str(),
                                address.c_str() + colon + 1,
                                &hints,
                                &found);
  if (error != 0) {
    return absl::UnavailableError(absl::StrCat(
        "listen: cannot bind ", address, ": ", gai_strerror(error)));
  }
  std::vector<sockaddr_storage> addresses;
  for (const addrinfo* next = found; next != nullptr; next = next->ai_next) {
    if (next->ai_addrlen > sizeof(sockaddr_storage)) continue;
    std::memcpy(&addresses.emplace_back(), next->ai_addr, next->ai_addrlen);
  }
  freeaddrinfo(found);
  return addresses;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Listener>> Listener::Bind(
    const std::string& address,
    const ConnectionLimits& limits,
    const PartialMessageLimit& partial,
    const Counts& counts) {
  ASSIGN_OR_RETURN(std::vector<sockaddr_storage> addresses, Resolve(address));
  std::unique_ptr<Listener> listener(
      new Listener(Bounded(limits), partial, counts));
  int error = 0;
  listener->stop_ = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (listener->stop_ < 0) error = errno;
  if (std::any_of(addresses.begin(), addresses.end(), IsWildcard)) {
    sockaddr_storage any{};
    any.ss_family = AF_INET6;  // in6addr_any is all zeros
    SetPort(any, PortOf(addresses.front()));
    const int fd = ListenAt(any, /*both=*/true);
    if (fd >= 0) {
      listener->listening_.push_back(fd);
      addresses.clear();
    } else if (errno == EADDRINUSE || errno == EACCES) {
      error = errno;  // by one family alone, half of the clients would miss it
    }
  }
  for (sockaddr_storage& next : addresses) {
    if (listener->port_ != 0) SetPort(next, listener->port_);
    const int fd = ListenAt(next, /*both=*/false);
    if (fd < 0) {
      // A machine without IPv6 still has a name for itself in it.
      if (errno != EADDRNOTAVAIL && errno != EAFNOSUPPORT) error = errno;
      continue;
    }
    listener->listening_.push_back(fd);
    listener->port_ = PortOfSocket(fd);
  }
  if (listener->listening_.empty() || error != 0) {
    return absl::UnavailableError(
        absl::StrCat("listen: cannot bind ",
                     address,
                     ": ",
                     std::strerror(error != 0 ? error : EADDRNOTAVAIL)));
  }
  listener->port_ = PortOfSocket(listener->listening_.front());
  return listener;
}

Listener::Listener(const ConnectionLimits& limits,
                   const PartialMessageLimit& partial,
                   const Counts& counts)
    : connections_(limits, partial), partial_(partial), counts_(counts) {}

Listener::~Listener() {
  if (thread_.joinable()) {
    eventfd_write(stop_, 1);
    thread_.join();
  }
  for (const int fd : listening_) close(fd);
  if (stop_ >= 0) close(stop_);
}

void Listener::Start(Take take) {
  take_ = std::move(take);
  thread_ = std::thread([this] { Run(); });
}

void Listener::Run() {
  std::vector<pollfd> polled = {{stop_, POLLIN, 0}};
  for (const int fd : listening_) polled.push_back({fd, POLLIN, 0});
  bool can_accept = true;
  while (true) {
    // Out of descriptors: a waiting connection would end every poll at once.
    const nfds_t count = can_accept ? polled.size() : 1;
    poll(polled.data(),
         count,
         can_accept ? Patience_ms() : kWithoutDescriptors_ms);
    if (polled[0].revents != 0) return;
    can_accept = true;
    for (const int fd : listening_) can_accept = AcceptSome(fd) && can_accept;
    connections_.SweepIfOlderThan(std::chrono::milliseconds(kBetweenCounts_ms));
    if (partial_.whole != nullptr) BoundPartialMessages();
    counts_.open->store(static_cast<std::int64_t>(connections_.size()),
                        std::memory_order_relaxed);
  }
}

void Listener::BoundPartialMessages() {
  const int ended = connections_.BoundPartialMessages();
  if (ended == 0) return;
  counts_.ended->fetch_add(static_cast<std::uint64_t>(ended),
                           std::memory_order_relaxed);
  spdlog::warn(
      "listener: ended {} connections, as messages that clients had sent half "
      "took more than {} MiB",
      ended,
      partial_.max_bytes >> 20);
}

int Listener::Patience_ms() const {
  if (partial_.whole == nullptr) return kBetweenCounts_ms;
  const double close = kCloseShare * static_cast<double>(partial_.max_bytes);
  return connections_.partial_bytes() > close ? kBetweenCloseLooks_ms
                                              : kBetweenLooks_ms;
}

bool Listener::AcceptSome(int listener_fd) {
  for (int taken = 0; taken < kMostAtOnce; ++taken) {
    sockaddr_storage peer{};
    socklen_t size = sizeof(peer);
    const int fd = accept4(listener_fd,
                           reinterpret_cast<sockaddr*>(&peer),
                           &size,
                           SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (fd < 0) {
      if (errno == EINTR || errno == ECONNABORTED) continue;
      return errno == EAGAIN || errno == EWOULDBLOCK;
    }
    if (!connections_.Add(fd, NetworkOf(PeerName(peer)), PortOf(peer))) {
      counts_.refused->fetch_add(1, std::memory_order_relaxed);
      // The client is to know at once, and the system to keep nothing of it.
      const linger at_once = {1, 0};
      setsockopt(fd, SOL_SOCKET, SO_LINGER, &at_once, sizeof(at_once));
      close(fd);
      continue;
    }
    const int yes = 1;
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof(yes));
    take_(listener_fd, fd);
  }
  return true;
}

}  // namespace groundlock::service
