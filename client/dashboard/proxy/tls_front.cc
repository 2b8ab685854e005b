// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/tls_front.h"

#include <sys/socket.h>

#include <array>
#include <boost/asio/ssl.hpp>
#include <boost/asio/write.hpp>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/file_look.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

namespace fs = std::filesystem;
namespace ssl = asio::ssl;

constexpr std::chrono::seconds kHandshakeTimeout{20};
// A client that takes nothing for so long is let go; the connections behind
// have shorter limits of their own.
constexpr std::chrono::seconds kWriteTimeout{60};
constexpr std::chrono::seconds kGoodbyeTimeout{5};

// Carries bytes between a client's encrypted connection and a socket of ours.
// Lives as long as something is under way; all of it on the socket's strand.
class Bridge : public std::enable_shared_from_this<Bridge> {
 public:
  Bridge(asio::io_context& io,
         Tcp::socket socket,
         std::shared_ptr<ssl::context> context,
         std::shared_ptr<std::atomic<int>> connections,
         std::function<void(Tcp::socket)> use)
      : io_(io),
        context_(std::move(context)),
        secure_(std::move(socket), *context_),
        plain_(secure_.get_executor()),
        timer_(secure_.get_executor()),
        connections_(std::move(connections)),
        use_(std::move(use)) {
    ++*connections_;
  }
  ~Bridge() { --*connections_; }
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  void Run() {
    asio::post(secure_.get_executor(), [self = shared_from_this()] {
      self->ExpireAfter(kHandshakeTimeout);
      self->secure_.async_handshake(
          ssl::stream_base::server,
          [self](error_code error) { self->OnHandshake(error); });
    });
  }

 private:
  // Closes everything unless the timer is set anew, or stopped.
  void ExpireAfter(std::chrono::seconds time) {
    timer_.expires_after(time);
    timer_.async_wait([self = shared_from_this()](error_code error) {
      if (!error) self->Close();
    });
  }
  void Close() {
    error_code ignored;
    timer_.cancel();
    secure_.lowest_layer().close(ignored);
    plain_.close(ignored);
  }

  void OnHandshake(error_code error) {
    timer_.cancel();
    std::array<int, 2> ends{};
    if (error || socketpair(AF_UNIX,
                            SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK,
                            0,
                            ends.data()) != 0) {
      Close();
      return;
    }
    // For Asio a stream socket is a stream socket.
    plain_.assign(Tcp::v4(), ends[0]);
    Tcp::socket theirs(asio::make_strand(io_));
    theirs.assign(Tcp::v4(), ends[1]);
    std::exchange(use_, nullptr)(std::move(theirs));
    ReadSecure();
    ReadPlain();
  }

  void ReadSecure() {
    secure_.async_read_some(
        asio::buffer(in_),
        [self = shared_from_this()](error_code error, std::size_t bytes) {
          if (error) {
            // Said goodbye, or is gone: those behind read what there is.
            error_code ignored;
            self->plain_.shutdown(Tcp::socket::shutdown_send, ignored);
            return;
          }
          asio::async_write(self->plain_,
                            asio::buffer(self->in_.data(), bytes),
                            [self](error_code failed, std::size_t) {
                              if (failed) return;  // ReadPlain ends it
                              self->ReadSecure();
                            });
        });
  }

  void ReadPlain() {
    plain_.async_read_some(
        asio::buffer(out_),
        [self = shared_from_this()](error_code error, std::size_t bytes) {
          if (error) {
            self->SayGoodbye();
            return;
          }
          self->ExpireAfter(kWriteTimeout);
          asio::async_write(self->secure_,
                            asio::buffer(self->out_.data(), bytes),
                            [self](error_code failed, std::size_t) {
                              self->timer_.cancel();
                              if (failed) {
                                self->Close();
                              } else {
                                self->ReadPlain();
                              }
                            });
        });
  }

  void SayGoodbye() {
    ExpireAfter(kGoodbyeTimeout);
    secure_.async_shutdown(
        [self = shared_from_this()](error_code) { self->Close(); });
  }

  asio::io_context& io_;
  const std::shared_ptr<ssl::context> context_;
  ssl::stream<Tcp::socket> secure_;
  Tcp::socket plain_;
  asio::steady_timer timer_;
  const std::shared_ptr<std::atomic<int>> connections_;
  std::function<void(Tcp::socket)> use_;
  std::array<char, 16 << 10> in_{};
  std::array<char, 16 << 10> out_{};
};

// Changes when one of the files does; empty if one is not there.
std::string LookOfFiles(const HttpsOptions& options) {
  std::string look;
  for (const std::string& path : {options.certificate, options.key}) {
    const std::string one = base::LookOf(path);
    if (one.empty()) return "";
    absl::StrAppend(&look, one, "\n");
  }
  return look;
}

}  // namespace

TlsFront::TlsFront(const HttpsOptions& options, int max_connections)
    : options_(options),
      max_connections_(max_connections),
      connections_(std::make_shared<std::atomic<int>>(0)) {}

TlsFront::~TlsFront() = default;

absl::StatusOr<TlsFront::Context> TlsFront::Load(const HttpsOptions& options) {
  for (const std::string& path : {options.certificate, options.key}) {
    std::error_code error;
    if (!fs::is_regular_file(path, error)) {
      return absl::NotFoundError(absl::StrCat(path, ": no such file"));
    }
  }
  RETURN_IF_ERROR(base::CheckPrivate(options.key));
  auto context = std::make_shared<ssl::context>(ssl::context::tls_server);
  SSL_CTX* const native = context->native_handle();
  SSL_CTX_set_min_proto_version(native, TLS1_2_VERSION);
  SSL_CTX_set_options(
      native, SSL_OP_NO_RENEGOTIATION | SSL_OP_CIPHER_SERVER_PREFERENCE);
  // Keys that are thrown away, and encryption that is authenticated.
  SSL_CTX_set_cipher_list(native, "ECDHE+AESGCM:ECDHE+CHACHA20");
  error_code failed;
  context->use_certificate_chain_file(options.certificate, failed);
  if (failed) {
    return absl::InvalidArgumentError(
        absl::StrCat(options.certificate,
                     ": no certificate in PEM form: ",
                     failed.message()));
  }
  // Nobody could be asked for a passphrase.
  context->set_password_callback(
      [](std::size_t, ssl::context::password_purpose) { return std::string(); },
      failed);
  context->use_private_key_file(options.key, ssl::context::pem, failed);
  if (failed || SSL_CTX_check_private_key(native) != 1) {
    return absl::InvalidArgumentError(absl::StrCat(
        options.key, ": not the private key of ", options.certificate));
  }
  return context;
}

absl::StatusOr<std::unique_ptr<TlsFront>> TlsFront::Create(
    const HttpsOptions& options, int max_connections) {
  std::unique_ptr<TlsFront> front(new TlsFront(options, max_connections));
  front->look_ = LookOfFiles(options);
  auto context = Load(options);
  if (!context.ok()) return context.status();
  front->context_ = *std::move(context);
  return front;
}

void TlsFront::Renew() {
  const auto now = std::chrono::steady_clock::now();
  if (now < next_look_) return;
  next_look_ = now + options_.reload_interval;
  std::string look = LookOfFiles(options_);
  if (look == look_) return;
  look_ = std::move(look);
  auto context = Load(options_);
  if (context.ok()) {
    context_ = *std::move(context);
    spdlog::info("HTTPS: the certificate was read again");
  } else {
    spdlog::error("HTTPS: the certificate read before holds on: {}",
                  context.status().ToString());
  }
}

void TlsFront::Accept(asio::io_context& io,
                      Tcp::socket socket,
                      std::function<void(Tcp::socket)> use) {
  Renew();
  if (*connections_ >= max_connections_) return;  // closes it
  error_code ignored;
  socket.set_option(Tcp::no_delay(true), ignored);
  std::make_shared<Bridge>(
      io, std::move(socket), context_, connections_, std::move(use))
      ->Run();
}

}  // namespace groundlock::dashboard
