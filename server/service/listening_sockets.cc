// SPDX-License-Identifier: Apache-2.0
#include "server/service/listening_sockets.h"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <memory>
#include <string_view>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

// Connections that wait to be accepted; the kernel may allow fewer.
constexpr int kBacklog = 1'024;
// For as long a client may leave what it was sent unacknowledged.
constexpr unsigned kUserTimeoutMs = 10'000;
constexpr char kUnix[] = "unix:";

absl::Status Failed(const std::string& address, const char* what) {
  return absl::UnavailableError(absl::StrCat(
      "listen: cannot bind ", address, ": ", what, ": ", strerror(errno)));
}

struct HostAndPort {
  std::string host;  // without brackets
  int port = 0;
};

absl::StatusOr<HostAndPort> Split(const std::string& address) {
  const std::size_t colon = address.rfind(':');
  std::string_view host = std::string_view(address).substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  } else if (host.find(':') != std::string_view::npos) {
    host = {};  // an IPv6 address without brackets
  }
  int port = -1;
  if (colon == std::string::npos || host.empty() ||
      !absl::SimpleAtoi(address.substr(colon + 1), &port) || port < 0 ||
      port > 65'535) {
    return absl::InvalidArgumentError(absl::StrCat(
        "listen: ",
        address,
        " is none of HOST:PORT, [IPv6]:PORT and unix:PATH, with a port up to "
        "65535"));
  }
  return HostAndPort{std::string(host), port};
}

int PortOf(int fd) {
  sockaddr_storage bound{};
  socklen_t size = sizeof(bound);
  if (getsockname(fd, reinterpret_cast<sockaddr*>(&bound), &size) != 0)
    return 0;
  return ntohs(bound.ss_family == AF_INET6
                   ? reinterpret_cast<const sockaddr_in6*>(&bound)->sin6_port
                   : reinterpret_cast<const sockaddr_in*>(&bound)->sin_port);
}

void SetPorts(addrinfo* addresses, int port) {
  const auto number = htons(static_cast<std::uint16_t>(port));
  for (; addresses != nullptr; addresses = addresses->ai_next) {
    if (addresses->ai_family == AF_INET6) {
      reinterpret_cast<sockaddr_in6*>(addresses->ai_addr)->sin6_port = number;
    } else if (addresses->ai_family == AF_INET) {
      reinterpret_cast<sockaddr_in*>(addresses->ai_addr)->sin_port = number;
    }
  }
}

void SetOption(int fd, int level, int name, int value) {
  setsockopt(fd, level, name, &value, sizeof(value));
}

// -1: errno says why not. Two servers on one port would split the clients
// between them, so the port is not shared.
int ListenAt(const sockaddr* address, socklen_t size) {
  const int fd =
      socket(address->sa_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd < 0) return -1;
  // What is accepted inherits these.
  SetOption(fd, SOL_SOCKET, SO_REUSEADDR, 1);
  SetOption(fd, IPPROTO_TCP, TCP_NODELAY, 1);
  SetOption(fd, IPPROTO_TCP, TCP_USER_TIMEOUT, kUserTimeoutMs);
  if (address->sa_family == AF_INET6) {
    SetOption(fd, IPPROTO_IPV6, IPV6_V6ONLY, 1);
  }
  if (bind(fd, address, size) == 0 && listen(fd, kBacklog) == 0) return fd;
  const int error = errno;
  close(fd);
  errno = error;
  return -1;
}

// A name may be told twice with the same address.
bool IsRepeated(const addrinfo* first, const addrinfo* one) {
  for (; first != one; first = first->ai_next) {
    if (first->ai_addrlen == one->ai_addrlen &&
        std::memcmp(first->ai_addr, one->ai_addr, one->ai_addrlen) == 0) {
      return true;
    }
  }
  return false;
}

struct FreeAddresses {
  void operator()(addrinfo* list) const { freeaddrinfo(list); }
};
using Addresses = std::unique_ptr<addrinfo, FreeAddresses>;

absl::StatusOr<Addresses> Resolve(const std::string& host) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE;
  // A wildcard means both families, whichever of the two it is written in.
  const bool is_wildcard = host == "0.0.0.0" || host == "::";
  addrinfo* found = nullptr;
  const int error =
      getaddrinfo(is_wildcard ? nullptr : host.c_str(), "0", &hints, &found);
  if (error != 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("listen: ", host, ": ", gai_strerror(error)));
  }
  return Addresses(found);
}

}  // namespace

absl::StatusOr<ListeningSockets> ListeningSockets::OpenUnix(
    const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.empty() || path.size() >= sizeof(address.sun_path)) {
    return absl::InvalidArgumentError(absl::StrCat("listen: unix:",
                                                   path,
                                                   ": want a path of 1 to ",
                                                   sizeof(address.sun_path) - 1,
                                                   " characters"));
  }
  std::memcpy(address.sun_path, path.data(), path.size());
  struct stat status {};
  // What a server that was killed has left behind, and nothing else.
  if (lstat(path.c_str(), &status) == 0 && S_ISSOCK(status.st_mode)) {
    unlink(path.c_str());
  }
  const int fd =
      ListenAt(reinterpret_cast<const sockaddr*>(&address), sizeof(address));
  if (fd < 0) return Failed(absl::StrCat(kUnix, path), "socket");
  ListeningSockets sockets;
  sockets.fds_.push_back(fd);
  sockets.path_ = path;
  return sockets;
}

absl::StatusOr<ListeningSockets> ListeningSockets::OpenOnce(
    const std::string& host, int port) {
  ASSIGN_OR_RETURN(const Addresses addresses, Resolve(host));
  SetPorts(addresses.get(), port);
  ListeningSockets sockets;
  for (const addrinfo* one = addresses.get(); one != nullptr;
       one = one->ai_next) {
    if (one->ai_family != AF_INET && one->ai_family != AF_INET6) continue;
    if (IsRepeated(addresses.get(), one)) continue;
    const int fd = ListenAt(one->ai_addr, one->ai_addrlen);
    if (fd < 0) {
      // A machine without IPv6, or whose name has an address of another one.
      if (errno == EAFNOSUPPORT || errno == EADDRNOTAVAIL) continue;
      return Failed(absl::StrCat(host, ":", port), "socket");
    }
    sockets.fds_.push_back(fd);
    sockets.port_ = PortOf(fd);
    SetPorts(addresses.get(), sockets.port_);
  }
  if (sockets.fds_.empty()) {
    return Failed(absl::StrCat(host, ":", port), "no address of this machine");
  }
  return sockets;
}

absl::StatusOr<ListeningSockets> ListeningSockets::Open(
    const std::string& address) {
  if (address.starts_with(kUnix))
    return OpenUnix(address.substr(std::strlen(kUnix)));
  ASSIGN_OR_RETURN(const HostAndPort parts, Split(address));
  // A port that is free at the first address may be taken at the second.
  int attempts = parts.port == 0 ? 10 : 1;
  for (;;) {
    auto sockets = OpenOnce(parts.host, parts.port);
    if (sockets.ok() || --attempts == 0) return sockets;
  }
}

ListeningSockets::~ListeningSockets() { Close(); }

ListeningSockets::ListeningSockets(ListeningSockets&& other) noexcept
    : fds_(std::exchange(other.fds_, {})),
      port_(other.port_),
      path_(std::exchange(other.path_, {})) {}

ListeningSockets& ListeningSockets::operator=(
    ListeningSockets&& other) noexcept {
  std::swap(fds_, other.fds_);
  std::swap(port_, other.port_);
  std::swap(path_, other.path_);
  return *this;
}

void ListeningSockets::Close() {
  for (const int fd : std::exchange(fds_, {})) close(fd);
  if (!path_.empty()) unlink(std::exchange(path_, {}).c_str());
}

bool IsLoopback(std::string_view address) {
  if (address.starts_with(kUnix)) return true;
  std::string_view host = address.substr(0, address.rfind(':'));
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  return host == "localhost" || host == "::1" || host.starts_with("127.");
}

}  // namespace groundlock::service
