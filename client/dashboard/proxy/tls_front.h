// SPDX-License-Identifier: Apache-2.0
// HTTPS: encryption ends in front of the connections, which know nothing of it.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_TLS_FRONT_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_TLS_FRONT_H_

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/dashboard/proxy/asio.h"
#include "client/dashboard/proxy/options.h"

namespace boost::asio::ssl {
class context;
}

namespace groundlock::dashboard {

// One thread at a time.
class TlsFront {
 public:
  // TLS 1.2 or 1.3 with the files of `options`. kNotFound, kInvalidArgument (no
  // certificate, no key, not a pair), kFailedPrecondition (everybody may read
  // the key); messages name the file.
  //   max_connections  that are being made or under way
  static absl::StatusOr<std::unique_ptr<TlsFront>> Create(
      const HttpsOptions& options, int max_connections);
  ~TlsFront();
  TlsFront(const TlsFront&) = delete;
  TlsFront& operator=(const TlsFront&) = delete;

  // Shakes hands with whoever has connected, and then calls `use` with a socket
  // from which what they say is read, and to which the answers are written. The
  // files are looked at now and then: a renewed certificate needs no restart.
  void Accept(asio::io_context& io,
              Tcp::socket socket,
              std::function<void(Tcp::socket)> use);

 private:
  using Context = std::shared_ptr<asio::ssl::context>;
  TlsFront(const HttpsOptions& options, int max_connections);
  static absl::StatusOr<Context> Load(const HttpsOptions& options);
  void Renew();

  const HttpsOptions options_;
  const int max_connections_;
  const std::shared_ptr<std::atomic<int>> connections_;
  Context context_;
  std::string look_;  // of the files that are in use
  std::chrono::steady_clock::time_point next_look_;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_TLS_FRONT_H_
