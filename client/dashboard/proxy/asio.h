// SPDX-License-Identifier: Apache-2.0
// Boost's Asio and Beast as the proxy uses them.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_ASIO_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_ASIO_H_

// Boost 1.74 forgets to include it.
#include <utility>
//
#include <boost/asio/bind_executor.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/strand.hpp>
#include <boost/asio/thread_pool.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <string_view>

namespace groundlock::dashboard {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;
namespace websocket = boost::beast::websocket;
using boost::system::error_code;
using Tcp = asio::ip::tcp;
using Strand = asio::strand<asio::io_context::executor_type>;

inline std::string_view View(beast::string_view text) {
  return {text.data(), text.size()};
}

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_ASIO_H_
