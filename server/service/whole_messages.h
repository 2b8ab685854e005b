// SPDX-License-Identifier: Apache-2.0
// How much of what clients send has become whole messages.
#ifndef GROUNDLOCK_SERVER_SERVICE_WHOLE_MESSAGES_H_
#define GROUNDLOCK_SERVER_SERVICE_WHOLE_MESSAGES_H_

#include <array>
#include <atomic>
#include <charconv>
#include <cstddef>
#include <cstdint>
#include <string_view>

namespace groundlock::service {

// Counts by the port that a client calls from, which tells the connections of
// one machine apart, and most of others'. Thread-safe, without locks.
class WholeMessages {
 public:
  // A message of `bytes` has been read.
  //   peer  as grpc::ServerContext::peer() names it: "ipv4:192.0.2.1:40000"
  void Add(std::string_view peer, std::size_t bytes) {
    std::uint32_t port = 0;
    const std::size_t colon = peer.rfind(':');
    if (colon == std::string_view::npos) return;
    std::from_chars(peer.data() + colon + 1, peer.data() + peer.size(), port);
    if (port == 0 || port >= bytes_.size()) return;  // a Unix socket's
    bytes_[port].fetch_add(bytes + bytes / kOverheadShare + kHeadBytes,
                           std::memory_order_relaxed);
  }
  // What has come from that port: whole messages with all that carried them.
  // Wraps around.
  std::uint64_t At(int port) const {
    return bytes_[static_cast<std::size_t>(port)].load(
        std::memory_order_relaxed);
  }

 private:
  // Of frames of HTTP/2 (9 bytes for each 16 KiB) and records of TLS (22 for
  // each 16 KiB, or for each piece of 1 KiB).
  static constexpr std::size_t kOverheadShare = 32;
  // Of a call's head and its end.
  static constexpr std::size_t kHeadBytes = 1024;

  std::array<std::atomic<std::uint64_t>, 65536> bytes_{};
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_WHOLE_MESSAGES_H_
