// SPDX-License-Identifier: Apache-2.0
#include "server/service/open_connections.h"

#include <fcntl.h>
#include <linux/sockios.h>
#include <linux/tcp.h>
#include <netinet/in.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <optional>

namespace groundlock::service {
namespace {

// How often the system is asked at most which connections are still open.
constexpr auto kBetweenSweeps = std::chrono::milliseconds(50);

// Of an open socket, else nullopt.
std::optional<ino_t> InodeOf(int fd) {
  struct statx found {};
  if (statx(fd, "", AT_EMPTY_PATH, STATX_INO | STATX_TYPE, &found) != 0 ||
      !S_ISSOCK(found.stx_mode)) {
    return std::nullopt;
  }
  return found.stx_ino;
}

}  // namespace

bool OpenConnections::IsFull(const std::string& network) const {
  if (size() >= static_cast<std::size_t>(limits_.max_connections)) return true;
  const auto found = by_network_.find(network);
  return found != by_network_.end() &&
         found->second >= limits_.max_connections_per_address;
}

bool OpenConnections::Add(int fd, const std::string& network, int peer_port) {
  const auto inode = InodeOf(fd);
  if (!inode) return false;
  if (IsFull(network)) SweepIfOlderThan(kBetweenSweeps);
  if (IsFull(network)) return false;
  Connection& added = connections_.emplace_back();
  added = {fd, *inode, network, peer_port};
  if (partial_.whole != nullptr) {
    added.whole_bytes = partial_.whole->At(peer_port);
  }
  ++by_network_[network];
  return true;
}

void OpenConnections::SweepIfOlderThan(std::chrono::nanoseconds age) {
  const Clock::time_point now = Clock::now();
  if (now - last_sweep_ < age) return;
  last_sweep_ = now;
  std::erase_if(connections_, [this](const Connection& connection) {
    const auto inode = InodeOf(connection.fd);
    if (inode == connection.inode) return false;
    const auto found = by_network_.find(connection.network);
    if (--found->second == 0) by_network_.erase(found);
    return true;
  });
}

int OpenConnections::BoundPartialMessages() {
  const Clock::time_point now = Clock::now();
  const double decay =
      std::exp(-std::chrono::duration<double>(now - last_bounding_) /
               std::chrono::duration<double>(partial_.given_up_after));
  last_bounding_ = now;
  partial_bytes_ = 0.0;
  for (Connection& connection : connections_) {
    Measure(connection, decay);
    partial_bytes_ += connection.partial_bytes;
  }
  const auto most = static_cast<double>(partial_.max_bytes);
  if (partial_bytes_ <= most) return 0;
  std::vector<Connection*> hoarders;
  for (Connection& connection : connections_) {
    if (connection.partial_bytes * static_cast<double>(size()) > most) {
      hoarders.push_back(&connection);
    }
  }
  std::stable_sort(hoarders.begin(), hoarders.end(), [](auto* a, auto* b) {
    return a->silence_ms > b->silence_ms;
  });
  int ended = 0;
  for (Connection* hoarder : hoarders) {
    if (partial_bytes_ <= 0.5 * most) break;
    partial_bytes_ -= hoarder->partial_bytes;
    hoarder->partial_bytes = 0.0;
    // gRPC may close the descriptor meanwhile, and another connection get its
    // number: a copy stays what it is.
    const int copy = fcntl(hoarder->fd, F_DUPFD_CLOEXEC, 0);
    if (copy < 0) continue;
    if (InodeOf(copy) == hoarder->inode && shutdown(copy, SHUT_RDWR) == 0) {
      ++ended;
    }
    close(copy);
  }
  return ended;
}

void OpenConnections::Measure(Connection& connection, double decay) const {
  // Asked for before what was received, of which it is a part.
  const std::uint64_t whole = partial_.whole->At(connection.peer_port);
  tcp_info info{};
  socklen_t size = sizeof(info);
  int unread = 0;  // of the system's, not of gRPC's memory
  if (InodeOf(connection.fd) != connection.inode ||
      getsockopt(connection.fd, IPPROTO_TCP, TCP_INFO, &info, &size) != 0 ||
      ioctl(connection.fd, SIOCINQ, &unread) != 0) {
    connection.partial_bytes = 0.0;
    return;
  }
  const std::uint64_t received =
      info.tcpi_bytes_received -
      std::min<std::uint64_t>(static_cast<std::uint64_t>(std::max(0, unread)),
                              info.tcpi_bytes_received);
  const double more = static_cast<double>(received) -
                      static_cast<double>(connection.received_bytes) -
                      static_cast<double>(whole - connection.whole_bytes);
  connection.partial_bytes =
      std::max(0.0, decay * connection.partial_bytes + more);
  connection.received_bytes = received;
  connection.whole_bytes = whole;
  connection.silence_ms = info.tcpi_last_data_recv;
}

}  // namespace groundlock::service
