// SPDX-License-Identifier: Apache-2.0
// The dashboard's own HTTPS: pages and WebSockets, who is believed, what is
// too old, and that a renewed certificate needs no restart.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/asio/ssl.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "tests/integration/dashboard_fixture.h"

namespace groundlock::test {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = boost::beast::http;
namespace websocket = boost::beast::websocket;
namespace ssl = boost::asio::ssl;
namespace fs = std::filesystem;
using boost::system::error_code;
using ::testing::HasSubstr;
using Secure = ssl::stream<asio::ip::tcp::socket>;

class DashboardHttps : public DashboardTest {
 protected:
  void SetUp() override {
    Openssl(
        "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes "
        "-days 2 -subj /CN=ours -keyout ca.key -out ca.pem");
    Issue();
    options_.https.certificate = file("server.pem");
    options_.https.key = file("server.key");
    options_.https.reload_interval = std::chrono::milliseconds(1);
  }
  std::string file(const std::string& name) const {
    return (directory_.path() / name).string();
  }
  void Openssl(const std::string& arguments) {
    const std::string command = "cd '" + directory_.path().string() +
                                "' && openssl " + arguments +
                                " >openssl.log 2>&1";
    if (std::system(command.c_str()) != 0) ADD_FAILURE() << command;
  }
  // server.pem and server.key, as their renewal does it: by renaming.
  void Issue() {
    std::ofstream(file("extensions")) << "subjectAltName=IP:127.0.0.1\n";
    Openssl(
        "req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "
        "/CN=dashboard -keyout new.key -out request");
    Openssl(
        "x509 -req -in request -CA ca.pem -CAkey ca.key -CAcreateserial "
        "-days 2 -extfile extensions -out new.pem");
    fs::permissions(file("new.key"),
                    fs::perms::owner_read | fs::perms::owner_write);
    fs::rename(file("new.key"), file("server.key"));
    fs::rename(file("new.pem"), file("server.pem"));
  }
  void StartSecure(TestServer& server) {
    options_.listen = "127.0.0.1:0";
    options_.server.target = server.address();
    options_.poll_interval = std::chrono::milliseconds(50);
    auto dashboard = dashboard::Dashboard::Start(options_);
    ASSERT_TRUE(dashboard.ok()) << dashboard.status();
    dashboard_ = *std::move(dashboard);
    ASSERT_TRUE(Eventually([this] {
      return Get("/api/info").find(R"("login_required":false)") !=
             std::string::npos;
    }));
  }
  // Connected and shaken hands with, or the error.
  std::unique_ptr<Secure> Dial(ssl::context& context, error_code& error) {
    context.set_verify_mode(ssl::verify_peer);
    context.load_verify_file(file("ca.pem"));
    auto stream = std::make_unique<Secure>(io_, context);
    stream->set_verify_callback(ssl::rfc2818_verification("127.0.0.1"));
    stream->lowest_layer().connect(
        {asio::ip::address_v4::loopback(), static_cast<std::uint16_t>(port())},
        error);
    if (!error) stream->handshake(ssl::stream_base::client, error);
    return stream;
  }
  std::string Get(const std::string& target) {
    ssl::context context(ssl::context::tls_client);
    error_code error;
    const auto stream = Dial(context, error);
    if (error) return "error: " + error.message();
    http::request<http::empty_body> request(http::verb::get, target, 11);
    request.set(http::field::host, "127.0.0.1:" + std::to_string(port()));
    request.set(http::field::connection, "close");
    http::write(*stream, request, error);
    http::response<http::string_body> response;
    beast::flat_buffer buffer;
    if (!error) http::read(*stream, buffer, response, error);
    if (error) return "error: " + error.message();
    // It says goodbye rather than falling silent, so that nothing was cut off.
    stream->shutdown(error);
    EXPECT_TRUE(!error || error == asio::error::eof) << error.message();
    return response.body();
  }
  // Of the certificate that is shown.
  std::string Serial() {
    ssl::context context(ssl::context::tls_client);
    error_code error;
    const auto stream = Dial(context, error);
    if (error) return "";
    X509* certificate = SSL_get_peer_certificate(stream->native_handle());
    BIGNUM* number =
        ASN1_INTEGER_to_BN(X509_get0_serialNumber(certificate), nullptr);
    char* text = BN_bn2hex(number);
    std::string serial = text;
    OPENSSL_free(text);
    BN_free(number);
    X509_free(certificate);
    return serial;
  }

  asio::io_context io_;
};

TEST_F(DashboardHttps, ServesPagesAndWebSockets) {
  TestServer server;
  const std::string page(300'000, 'x');
  options_.web = directory_.path() / "web";
  WriteWeb("index.html", page);
  StartSecure(server);
  EXPECT_EQ(Get("/healthz"), "ok\n");
  EXPECT_EQ(Get("/"), page);
  ssl::context context(ssl::context::tls_client);
  error_code error;
  auto stream = Dial(context, error);
  ASSERT_FALSE(error) << error.message();
  const std::string host = "127.0.0.1:" + std::to_string(port());
  websocket::stream<Secure&> socket(*stream);
  socket.set_option(websocket::stream_base::decorator(
      [host](websocket::request_type& request) {
        request.set(http::field::origin, "https://" + host);
      }));
  socket.handshake(host, "/ws", error);
  ASSERT_FALSE(error) << error.message();
  beast::flat_buffer buffer;
  socket.read(buffer, error);
  ASSERT_FALSE(error) << error.message();
  pb::ServerMessage hello;
  ASSERT_TRUE(hello.ParseFromArray(buffer.cdata().data(),
                                   static_cast<int>(buffer.size())));
  EXPECT_TRUE(hello.has_hello());
  // Plain HTTP gets nothing, and neither does noise; the others go on.
  EXPECT_EQ(Fetch(port(), http::verb::get, "/healthz").result_int(), 0U);
  EXPECT_EQ(Get("/healthz"), "ok\n");
  const auto connects = [&](const std::string& arguments) {
    const std::string command =
        "openssl s_client -connect " + host + " -CAfile '" + file("ca.pem") +
        "' -verify_return_error " + arguments + " </dev/null >/dev/null 2>&1";
    return std::system(command.c_str()) == 0;
  };
  EXPECT_TRUE(connects("-tls1_2"));
  EXPECT_TRUE(connects("-tls1_3"));
  EXPECT_FALSE(connects("-tls1_1 -cipher ALL:@SECLEVEL=0"));
  EXPECT_FALSE(connects("-tls1_2 -cipher kRSA:@SECLEVEL=0"));
}

TEST_F(DashboardHttps, ARenewedCertificateNeedsNoRestart) {
  TestServer server;
  StartSecure(server);
  const std::string before = Serial();
  ASSERT_FALSE(before.empty());
  Issue();
  EXPECT_TRUE(Eventually([&] {
    const std::string now = Serial();
    return !now.empty() && now != before;
  }));
  std::ofstream(file("server.pem")) << "damaged";
  EXPECT_EQ(Get("/healthz"), "ok\n") << "what was read before holds on";
}

TEST_F(DashboardHttps, OtherMachinesAreServedSecurelyOrOnPurpose) {
  TestServer server;
  dashboard::DashboardOptions options;
  options.server.target = server.address();
  const auto start = [&] {
    return dashboard::Dashboard::Start(options).status();
  };
  for (const char* listen :
       {"0.0.0.0:0", "[::]:0", "192.0.2.1:0", "127.0.0.1.example:0"}) {
    options.listen = listen;
    EXPECT_EQ(start().code(), absl::StatusCode::kInvalidArgument) << listen;
    EXPECT_THAT(start().ToString(), HasSubstr("--insecure"));
  }
  options.listen = "0.0.0.0:0";
  options.insecure = true;
  EXPECT_TRUE(start().ok()) << start();
  options.insecure = false;
  options.https.certificate = file("server.pem");
  options.https.key = file("server.key");
  EXPECT_TRUE(start().ok()) << start();
}

TEST_F(DashboardHttps, WrongFilesAreNamed) {
  TestServer server;
  options_.server.target = server.address();
  options_.listen = "127.0.0.1:0";
  const auto refusal = [&] {
    return dashboard::Dashboard::Start(options_).status().ToString();
  };
  options_.https.key = file("ca.key");
  fs::permissions(file("ca.key"),
                  fs::perms::owner_read | fs::perms::owner_write);
  EXPECT_THAT(refusal(), HasSubstr("not the private key of"));
  options_.https.key = file("none.key");
  EXPECT_THAT(refusal(), HasSubstr("none.key"));
  options_.https.key = "";
  EXPECT_THAT(refusal(), HasSubstr("needs its key"));
  options_.https.key = file("server.key");
  options_.https.certificate = file("extensions");
  EXPECT_THAT(refusal(), HasSubstr("extensions"));
  options_.https.certificate = file("server.pem");
  fs::permissions(
      file("server.key"), fs::perms::others_read, fs::perm_options::add);
  EXPECT_THAT(refusal(), HasSubstr("chmod 600"));
}

}  // namespace
}  // namespace groundlock::test
