// SPDX-License-Identifier: Apache-2.0
// A connection whose bytes a test chooses, as clients send them that are none.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_RAW_CONNECTION_H_
#define GROUNDLOCK_TESTS_INTEGRATION_RAW_CONNECTION_H_

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace groundlock::test {

inline constexpr std::string_view kHttp2Preface =
    "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

// A frame of HTTP/2 (RFC 9113, section 4.1).
inline std::string Http2Frame(std::uint8_t type,
                              std::uint8_t flags,
                              std::uint32_t stream,
                              const std::string& payload) {
  std::string frame;
  for (int shift = 16; shift >= 0; shift -= 8) {
    frame += static_cast<char>(payload.size() >> shift);
  }
  frame += static_cast<char>(type);
  frame += static_cast<char>(flags);
  for (int shift = 24; shift >= 0; shift -= 8) {
    frame += static_cast<char>(stream >> shift);
  }
  return frame + payload;
}

inline std::string Http2Settings() { return Http2Frame(4, 0, 0, ""); }
// Of a client that lets nothing of an answer come to it:
// SETTINGS_INITIAL_WINDOW_SIZE is 0 (section 6.5.2), and it never gives more.
inline std::string Http2SettingsWithoutWindow() {
  return Http2Frame(4, 0, 0, std::string("\0\4\0\0\0\0", 6));
}
// The one message of a call's request, or the first; gRPC's five bytes before
// it.
inline std::string Http2Message(std::uint32_t stream,
                                const std::string& message,
                                bool is_last) {
  std::string payload(1, '\0');
  for (int shift = 24; shift >= 0; shift -= 8) {
    payload += static_cast<char>(message.size() >> shift);
  }
  return Http2Frame(0, is_last ? 1 : 0, stream, payload + message);
}
inline std::string Http2SettingsAck() { return Http2Frame(4, 1, 0, ""); }

// HEADERS that begin a call, and leave its request open (RFC 7541, appendix A
// has the numbers of the names).
inline std::string Http2Call(std::uint32_t stream,
                             const std::string& path,
                             const std::string& authorization = "") {
  std::string headers = "\x83\x86";  // POST, http
  const auto text = [&headers](std::string_view value) {
    headers += static_cast<char>(value.size());  // below 127, not compressed
    headers += value;
  };
  headers += '\x04';  // :path
  text(path);
  headers += '\x01';  // :authority
  text("localhost");
  headers += "\x0f\x10";  // content-type
  text("application/grpc");
  headers += '\0';
  text("te");
  text("trailers");
  if (!authorization.empty()) {
    headers += "\x0f\x08";
    text(authorization);
  }
  return Http2Frame(1, 4, stream, headers);
}

class RawConnection {
 public:
  // from: the address that it comes from.
  explicit RawConnection(int port, const char* from = "127.0.0.1")
      : fd_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    inet_pton(AF_INET, from, &address.sin_addr);
    EXPECT_EQ(bind(fd_, reinterpret_cast<sockaddr*>(&address), sizeof(address)),
              0);
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    inet_pton(AF_INET, "127.0.0.1", &address.sin_addr);
    EXPECT_EQ(
        connect(fd_, reinterpret_cast<sockaddr*>(&address), sizeof(address)),
        0);
  }
  ~RawConnection() { close(fd_); }
  RawConnection(const RawConnection&) = delete;
  RawConnection& operator=(const RawConnection&) = delete;

  // False if the other side has ended the connection.
  bool Send(std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t sent = send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (sent <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(sent));
    }
    return true;
  }
  // Whether anything comes within a minute.
  bool HasAnswer() const {
    pollfd polled{fd_, POLLIN, 0};
    char byte = 0;
    return poll(&polled, 1, 60'000) == 1 &&
           recv(fd_, &byte, 1, MSG_PEEK | MSG_DONTWAIT) > 0;
  }
  // Whether the other side ends the connection; what it says before is passed
  // over.
  bool EndsWithin(int patience_ms) const {
    char bytes[4'096];
    for (;;) {
      pollfd polled{fd_, POLLIN, 0};
      if (poll(&polled, 1, patience_ms) != 1) return false;
      const ssize_t got = recv(fd_, bytes, sizeof(bytes), MSG_DONTWAIT);
      if (got == 0 || (got < 0 && errno != EAGAIN)) return true;
    }
  }
  // The client breaks it off.
  void Reset() {
    const linger at_once{1, 0};
    setsockopt(fd_, SOL_SOCKET, SO_LINGER, &at_once, sizeof(at_once));
    close(fd_);
    fd_ = -1;
  }

 private:
  int fd_;
};

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_RAW_CONNECTION_H_
