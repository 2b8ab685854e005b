// SPDX-License-Identifier: Apache-2.0
// Sockets that listen at an address.
#ifndef GROUNDLOCK_SERVER_SERVICE_LISTENING_SOCKETS_H_
#define GROUNDLOCK_SERVER_SERVICE_LISTENING_SOCKETS_H_

#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace groundlock::service {

// Closes them when it goes, and removes the file of a Unix one.
class ListeningSockets {
 public:
  // HOST:PORT, where HOST is a name, an IPv4 address or an IPv6 one in
  // brackets; a name may stand for several addresses, the wildcards 0.0.0.0 and
  // [::] for both families. Port 0: any that is free, the same for all of them.
  // Or unix:PATH. kInvalidArgument (no such address), kUnavailable (taken, or
  // not this machine's).
  static absl::StatusOr<ListeningSockets> Open(const std::string& address);
  ~ListeningSockets();
  ListeningSockets(ListeningSockets&& other) noexcept;
  ListeningSockets& operator=(ListeningSockets&& other) noexcept;

  // They do not block.
  const std::vector<int>& fds() const { return fds_; }
  int port() const { return port_; }  // 0: a Unix one
  void Close();

 private:
  ListeningSockets() = default;
  static absl::StatusOr<ListeningSockets> OpenUnix(const std::string& path);
  static absl::StatusOr<ListeningSockets> OpenOnce(const std::string& host,
                                                   int port);

  std::vector<int> fds_;
  int port_ = 0;
  std::string path_;  // of a Unix one
};

// Whether only this machine reaches the address HOST:PORT (or unix:PATH).
bool IsLoopback(std::string_view address);

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_LISTENING_SOCKETS_H_
