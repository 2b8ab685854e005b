// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/http_page.h"

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http.hpp>
#include <chrono>
#include <exception>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"

namespace groundlock::base {
namespace {

namespace asio = boost::asio;
namespace http = boost::beast::http;
using asio::ip::tcp;

// A client that takes longer is let go, s.
constexpr std::chrono::seconds kTimeout{10};
constexpr std::uint32_t kMaxHeaderBytes = 8192;
constexpr int kMaxConnections = 32;

struct Site {
  std::vector<HttpPage> pages;
  int connections = 0;  // the site's thread only
};

// One request, one answer. Lives as long as an operation of it is under way.
class Exchange : public std::enable_shared_from_this<Exchange> {
 public:
  Exchange(tcp::socket socket, Site* site)
      : stream_(std::move(socket)), site_(site) {
    ++site_->connections;
  }
  ~Exchange() { --site_->connections; }
  Exchange(const Exchange&) = delete;
  Exchange& operator=(const Exchange&) = delete;

  void Run() {
    parser_.header_limit(kMaxHeaderBytes);
    stream_.expires_after(kTimeout);
    http::async_read(
        stream_,
        buffer_,
        parser_,
        [self = shared_from_this()](const boost::system::error_code& error,
                                    std::size_t /*bytes*/) {
          if (!error) self->Answer();
        });
  }

 private:
  void Answer() {
    const auto& request = parser_.get();
    response_.version(request.version());
    response_.keep_alive(false);
    const auto page = std::find_if(
        site_->pages.begin(), site_->pages.end(), [&](const HttpPage& one) {
          return request.target() == one.path;
        });
    if (request.method() != http::verb::get) {
      response_.result(http::status::method_not_allowed);
    } else if (page == site_->pages.end()) {
      response_.result(http::status::not_found);
    } else {
      HttpPage::Content content = page->content();
      response_.result(static_cast<unsigned>(content.status));
      response_.set(http::field::content_type, page->content_type);
      response_.body() = std::move(content.text);
    }
    response_.prepare_payload();
    stream_.expires_after(kTimeout);
    http::async_write(
        stream_,
        response_,
        [self = shared_from_this()](const boost::system::error_code& /*error*/,
                                    std::size_t /*bytes*/) {
          boost::system::error_code ignored;
          self->stream_.socket().shutdown(tcp::socket::shutdown_send, ignored);
        });
  }

  boost::beast::tcp_stream stream_;
  Site* site_;
  boost::beast::flat_buffer buffer_;
  http::request_parser<http::empty_body> parser_;
  http::response<http::string_body> response_;
};

}  // namespace

struct HttpPages::Parts {
  // Declared first: what lives in the context's queue points to it.
  Site site;
  asio::io_context context{1};
  tcp::acceptor acceptor{context};
  asio::steady_timer pause{context};
  std::thread thread;

  void Accept() {
    acceptor.async_accept(
        [this](const boost::system::error_code& error, tcp::socket socket) {
          if (error == asio::error::operation_aborted) return;
          if (error) {
            // Out of descriptors, say: trying at once would only burn time.
            pause.expires_after(std::chrono::milliseconds(100));
            pause.async_wait([this](const boost::system::error_code& ended) {
              if (!ended) Accept();
            });
            return;
          }
          if (site.connections < kMaxConnections) {
            std::make_shared<Exchange>(std::move(socket), &site)->Run();
          }
          Accept();
        });
  }
};

absl::StatusOr<std::unique_ptr<HttpPages>> HttpPages::Start(
    const std::string& address, std::vector<HttpPage> pages) {
  const std::size_t colon = address.rfind(':');
  if (colon == std::string::npos) {
    return absl::InvalidArgumentError(
        absl::StrCat("'", address, "': expected HOST:PORT"));
  }
  std::string host = address.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  auto parts = std::make_unique<Parts>();
  parts->site.pages = std::move(pages);
  try {
    tcp::resolver resolver(parts->context);
    const auto found = resolver.resolve(
        host, address.substr(colon + 1), tcp::resolver::passive);
    const tcp::endpoint endpoint = found.begin()->endpoint();
    parts->acceptor.open(endpoint.protocol());
    parts->acceptor.set_option(tcp::acceptor::reuse_address(true));
    parts->acceptor.bind(endpoint);
    parts->acceptor.listen();
  } catch (const std::exception& error) {
    return absl::UnavailableError(
        absl::StrCat("cannot listen on ", address, ": ", error.what()));
  }
  parts->Accept();
  parts->thread = std::thread([context = &parts->context] { context->run(); });
  return std::unique_ptr<HttpPages>(new HttpPages(std::move(parts)));
}

HttpPages::HttpPages(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}

HttpPages::~HttpPages() {
  parts_->context.stop();
  parts_->thread.join();
}

int HttpPages::port() const { return parts_->acceptor.local_endpoint().port(); }

}  // namespace groundlock::base
