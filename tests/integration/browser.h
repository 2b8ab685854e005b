// SPDX-License-Identifier: Apache-2.0
// What a browser does, without one: HTTP requests and a page on the WebSocket.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_BROWSER_H_
#define GROUNDLOCK_TESTS_INTEGRATION_BROWSER_H_

#include <functional>
#include <map>
#include <optional>
#include <string>

#include "client/dashboard/proxy/asio.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"

namespace groundlock::test {

namespace pb = ::groundlock::dashboard::v1;
using Headers = std::map<std::string, std::string>;
using HttpResponse =
    boost::beast::http::response<boost::beast::http::string_body>;

// Status 0 if nothing came back.
HttpResponse Fetch(int port,
                   boost::beast::http::verb method,
                   const std::string& target,
                   const Headers& headers = {},
                   const std::string& body = "");

// One page. Every wait ends after a minute.
class Page {
 public:
  // receive_buffer_bytes: 0 = the system's.
  explicit Page(int port,
                const Headers& headers = {},
                int receive_buffer_bytes = 0);

  // Of the upgrade: 101 if the page is connected.
  int status() const { return status_; }
  // Fills in the request_id, which is returned.
  std::uint64_t Send(pb::ClientMessage message);
  void SendBytes(const std::string& bytes, bool binary = true);
  // The next message; nullopt when the connection is closed.
  std::optional<pb::ServerMessage> Read();
  // Reads up to the first message that is wanted.
  std::optional<pb::ServerMessage> ReadUntil(
      const std::function<bool(const pb::ServerMessage&)>& wanted);
  // Sends and waits for the reply; progress is skipped.
  pb::ServerMessage Ask(const pb::ClientMessage& message);
  // After Read() returned nullopt.
  int close_code() const;

 private:
  void Run();

  boost::asio::io_context io_;
  boost::beast::websocket::stream<boost::beast::tcp_stream> stream_;
  boost::beast::flat_buffer buffer_;
  int status_ = 0;
  std::uint64_t last_id_ = 0;
};

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_BROWSER_H_
