// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/browser.h"

#include <chrono>
#include <memory>
#include <utility>

namespace groundlock::test {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;
namespace websocket = boost::beast::websocket;
using boost::system::error_code;
using Tcp = asio::ip::tcp;

constexpr std::chrono::seconds kPatience{120};

std::string HostOf(int port) { return "127.0.0.1:" + std::to_string(port); }

Tcp::endpoint EndpointOf(int port) {
  return {asio::ip::address_v4::loopback(), static_cast<std::uint16_t>(port)};
}

}  // namespace

HttpResponse Fetch(int port,
                   http::verb method,
                   const std::string& target,
                   const Headers& headers,
                   const std::string& body) {
  asio::io_context io;
  beast::tcp_stream stream(io);
  error_code error;
  stream.socket().connect(EndpointOf(port), error);
  http::request<http::string_body> request(method, target, 11);
  request.set(http::field::host, HostOf(port));
  for (const auto& [name, value] : headers) request.set(name, value);
  request.body() = body;
  request.prepare_payload();
  http::response_parser<http::string_body> parser;
  parser.body_limit(1 << 30);
  if (method == http::verb::head) parser.skip(true);
  beast::flat_buffer buffer;
  stream.expires_after(kPatience);
  // Both at once: the other side may answer before it has read everything.
  http::async_write(stream, request, [](error_code, std::size_t) {});
  bool answered = false;
  http::async_read(stream, buffer, parser, [&](error_code failed, std::size_t) {
    answered = !failed;
    stream.close();  // what was not sent by now is not wanted
  });
  io.run_for(kPatience);
  HttpResponse response;
  if (answered) {
    response = parser.release();
  } else {
    response.result(0U);
  }
  return response;
}

Page::Page(int port, const Headers& headers, int receive_buffer_bytes)
    : stream_(io_) {
  error_code error;
  Tcp::socket& socket = beast::get_lowest_layer(stream_).socket();
  socket.open(Tcp::v4(), error);
  if (receive_buffer_bytes > 0) {
    socket.set_option(
        asio::socket_base::receive_buffer_size(receive_buffer_bytes), error);
  }
  socket.connect(EndpointOf(port), error);
  stream_.read_message_max(256 << 20);
  stream_.set_option(websocket::stream_base::decorator(
      [headers](websocket::request_type& request) {
        for (const auto& [name, value] : headers) request.set(name, value);
      }));
  const auto response = std::make_shared<websocket::response_type>();
  stream_.async_handshake(
      *response, HostOf(port), "/ws", [this, response](error_code failed) {
        status_ = failed && response->result_int() == 101
                      ? 0
                      : static_cast<int>(response->result_int());
      });
  Run();
  stream_.binary(true);
}

void Page::Run() {
  io_.restart();
  io_.run_for(kPatience);
}

std::uint64_t Page::Send(pb::ClientMessage message) {
  message.set_request_id(++last_id_);
  SendBytes(message.SerializeAsString());
  return last_id_;
}

void Page::SendBytes(const std::string& bytes, bool binary) {
  stream_.binary(binary);
  stream_.async_write(asio::buffer(bytes), [](error_code, std::size_t) {});
  Run();
}

std::optional<pb::ServerMessage> Page::Read() {
  std::optional<pb::ServerMessage> message;
  stream_.async_read(buffer_, [&](error_code error, std::size_t) {
    if (error) return;
    message.emplace();
    const auto data = buffer_.cdata();
    if (!message->ParseFromArray(data.data(), static_cast<int>(data.size()))) {
      message.reset();
    }
    buffer_.consume(buffer_.size());
  });
  Run();
  return message;
}

std::optional<pb::ServerMessage> Page::ReadUntil(
    const std::function<bool(const pb::ServerMessage&)>& wanted) {
  for (;;) {
    auto message = Read();
    if (!message.has_value() || wanted(*message)) return message;
  }
}

pb::ServerMessage Page::Ask(const pb::ClientMessage& message) {
  const std::uint64_t id = Send(message);
  return ReadUntil([id](const pb::ServerMessage& reply) {
           return reply.request_id() == id && !reply.has_progress();
         })
      .value_or(pb::ServerMessage());
}

int Page::close_code() const { return stream_.reason().code; }

}  // namespace groundlock::test
