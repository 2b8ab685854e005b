// SPDX-License-Identifier: Apache-2.0
// Encrypted connections: who is believed, what is refused, and that a renewed
// certificate needs no restart. Keys are made by the openssl program.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "map_store/base/token_file.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// A certificate authority and what it issues.
class Authority {
 public:
  explicit Authority(const std::string& name)
      : directory_(
            *base::TemporaryDirectory::Create(fs::temp_directory_path())) {
    Run("req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 "
        "-subj /CN=" +
        name + " -keyout ca.key -out ca.pem");
  }
  fs::path file(const std::string& name) const {
    return directory_.path() / name;
  }
  // NAME.pem and NAME.key, for 127.0.0.1 and localhost, or others.
  void Issue(const std::string& name,
             const std::string& others = "IP:127.0.0.1,DNS:localhost") {
    std::ofstream(file("extensions")) << "subjectAltName=" << others << '\n';
    Run("req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=" +
        name + " -keyout " + name + ".key -out request");
    Run("x509 -req -in request -CA ca.pem -CAkey ca.key -CAcreateserial "
        "-days 2 -extfile extensions -out " +
        name + ".pem");
    fs::permissions(file(name + ".key"),
                    fs::perms::owner_read | fs::perms::owner_write);
  }

 private:
  void Run(const std::string& arguments) {
    const std::string command = "cd '" + directory_.path().string() +
                                "' && openssl " + arguments +
                                " >openssl.log 2>&1";
    if (std::system(command.c_str()) != 0) ADD_FAILURE() << command;
  }
  base::TemporaryDirectory directory_;
};

service::ServerOptions WithTls(const Authority& authority,
                               const std::string& name = "server") {
  service::ServerOptions options;
  options.tls.certificate = authority.file(name + ".pem");
  options.tls.key = authority.file(name + ".key");
  options.tls.reload_interval = std::chrono::seconds(1);
  return options;
}

// For connections that are to be refused, which is known when as much time has
// passed; those that are to be made are given all they need.
constexpr std::chrono::seconds kRefused{3};

sdk::ClientOptions Trusting(
    const Authority& authority,
    std::chrono::milliseconds patience = std::chrono::minutes(2)) {
  sdk::ClientOptions options;
  options.connect_timeout = patience;
  options.tls.ca = authority.file("ca.pem");
  return options;
}

std::string Url(const TestServer& server) {
  return "grpcs://" + server.address();
}

TEST(Tls, ServesThoseWhoTrustItsAuthorityAndNoOthers) {
  Authority ours("ours");
  ours.Issue("server");
  const Authority other("other");
  TestServer server(WithTls(ours));
  const auto client = sdk::Client::Connect(Url(server), Trusting(ours));
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->CreateSession(Spec("s")).ok());
  auto stream = (*client)->Track("s");
  ASSERT_TRUE(stream.ok()) << stream.status();
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());

  // Certificates that do not please are not tried again until time is up.
  const auto begin = std::chrono::steady_clock::now();
  const auto stranger = sdk::Client::Connect(Url(server), Trusting(other));
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::minutes(1));
  EXPECT_EQ(stranger.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(stranger.status().ToString(),
              AllOf(HasSubstr("not trusted"), HasSubstr("handshake failed")));
  sdk::ClientOptions renamed = Trusting(ours, kRefused);
  renamed.tls.server_name = "elsewhere.example";
  EXPECT_FALSE(sdk::Client::Connect(Url(server), renamed).ok());
  sdk::ClientOptions plain;
  plain.connect_timeout = kRefused;
  EXPECT_FALSE(sdk::Client::Connect(server.address(), plain).ok());
}

TEST(Tls, AsksForAClientsCertificate) {
  Authority ours("ours");
  ours.Issue("server");
  ours.Issue("client");
  Authority other("other");
  other.Issue("client");
  service::ServerOptions options = WithTls(ours);
  options.tls.client_ca = ours.file("ca.pem");
  options.tls.require_client_certificate = true;
  TestServer server(options);
  const auto connect = [&](const Authority* shown,
                           std::chrono::milliseconds patience) {
    sdk::ClientOptions client = Trusting(ours, patience);
    if (shown != nullptr) {
      client.tls.certificate = shown->file("client.pem");
      client.tls.key = shown->file("client.key");
    }
    const auto connected = sdk::Client::Connect(Url(server), client);
    // TLS 1.3 tells a client only after its handshake.
    return connected.ok() && (*connected)->ListSessions().ok();
  };
  EXPECT_TRUE(connect(&ours, std::chrono::minutes(2)));
  EXPECT_FALSE(connect(nullptr, kRefused));
  EXPECT_FALSE(connect(&other, kRefused));
}

TEST(Tls, ARenewedCertificateIsServedWithoutARestart) {
  Authority before("before");
  before.Issue("server");
  Authority after("after");
  after.Issue("server");
  TestServer server(WithTls(before));
  ASSERT_TRUE(sdk::Client::Connect(Url(server), Trusting(before)).ok());
  ASSERT_FALSE(
      sdk::Client::Connect(Url(server), Trusting(after, kRefused)).ok());
  for (const char* name : {"server.key", "server.pem"}) {
    fs::copy_file(after.file(name),
                  before.file(name),
                  fs::copy_options::overwrite_existing);
  }
  EXPECT_TRUE(Eventually([&] {
    return sdk::Client::Connect(Url(server), Trusting(after, kRefused)).ok();
  }));
  // Of the old authority only the certificate of its own is left.
  EXPECT_FALSE(
      sdk::Client::Connect(Url(server), Trusting(before, kRefused)).ok());
}

// What openssl's own client is told, if it asks for no better than `version`.
bool Accepts(const TestServer& server, const std::string& version) {
  const std::string command = "openssl s_client -connect " + server.address() +
                              " " + version +
                              " -alpn h2 </dev/null >/dev/null 2>&1";
  return std::system(command.c_str()) == 0;
}

TEST(Tls, SpeaksNothingBelowVersion12) {
  Authority ours("ours");
  ours.Issue("server");
  TestServer server(WithTls(ours));
  EXPECT_TRUE(Accepts(server, "-tls1_3"));
  EXPECT_TRUE(Accepts(server, "-tls1_2"));
  // Level 0: else Debian's client would not even ask.
  EXPECT_FALSE(Accepts(server, "-tls1_1 -cipher DEFAULT@SECLEVEL=0"));
  EXPECT_FALSE(Accepts(server, "-tls1 -cipher DEFAULT@SECLEVEL=0"));
}

absl::Status Start(service::ServerOptions options) {
  const auto directory =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const auto store = *storage::OpenStore((directory.path() / "s").string());
  options.scratch_directory = (directory.path() / "scratch").string();
  service::Metrics metrics;
  return service::GroundlockServer::Start(options, store.get(), &metrics)
      .status();
}

TEST(Tls, FilesThatCannotServeAreNamed) {
  Authority ours("ours");
  ours.Issue("server");
  ours.Issue("another");
  service::ServerOptions options = WithTls(ours);
  options.listen = "127.0.0.1:0";
  EXPECT_TRUE(Start(options).ok());
  options.tls.key = ours.file("another.key");
  EXPECT_THAT(Start(options).ToString(), HasSubstr("not the key of"));
  options.tls.key = ours.file("missing.key");
  EXPECT_THAT(Start(options).ToString(), HasSubstr("missing.key"));
  options.tls.key = ours.file("server.pem");
  EXPECT_THAT(Start(options).ToString(), HasSubstr("no private key"));
  options.tls.key = "";
  EXPECT_THAT(Start(options).ToString(), HasSubstr("needs its key"));
  options = WithTls(ours);
  fs::permissions(
      options.tls.key, fs::perms::others_read, fs::perm_options::add);
  EXPECT_THAT(Start(options).ToString(), HasSubstr("chmod 600"));
}

TEST(Tls, OtherMachinesAreServedSecurelyOrOnPurpose) {
  Authority ours("ours");
  ours.Issue("server");
  service::ServerOptions options;
  for (const char* listen :
       {"0.0.0.0:0", "[::]:0", "192.0.2.1:0", "127.0.0.1.example:0"}) {
    options.listen = listen;
    const absl::Status status = Start(options);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << listen;
    EXPECT_THAT(status.ToString(), HasSubstr("--insecure"));
  }
  options.listen = "0.0.0.0:0";
  options.tls = WithTls(ours).tls;
  EXPECT_THAT(Start(options).ToString(), HasSubstr("everybody"));
  options.tokens = {"0123456789abcdef"};
  EXPECT_TRUE(Start(options).ok());
  options = {};
  options.listen = "0.0.0.0:0";
  options.insecure = true;
  EXPECT_TRUE(Start(options).ok());
  for (const char* listen : {"127.0.0.1:0", "localhost:0", "[::1]:0"}) {
    options = {};
    options.listen = listen;
    EXPECT_NE(Start(options).code(), absl::StatusCode::kInvalidArgument)
        << listen;
  }
}

TEST(Tls, ACertificateTellsWhoCalls) {
  Authority ours("ours");
  ours.Issue("server");
  ours.Issue("camera", "URI:spiffe://acme/camera");
  ours.Issue("viewer", "DNS:viewer.example,email:viewer@example");
  ours.Issue("nobody");
  Authority other("other");
  other.Issue("camera");
  const fs::path tokens = ours.file("tokens");
  const auto add = [&](const std::string& name,
                       const std::string& scope,
                       const std::string& certificate) {
    return base::CreateToken(tokens, {name, "", {scope}, certificate}).value();
  };
  add("by-name", "sessions:own", "cn:camera");
  add("by-mail", "sessions:watch", "email:viewer@example");
  const std::string token = add("by-token", "maps:read", "");
  service::ServerOptions options = WithTls(ours);
  options.tls.client_ca = ours.file("ca.pem");
  options.token_file = tokens.string();
  TestServer server(options);
  const auto connect = [&](const Authority& authority,
                           const std::string& name,
                           const std::string& bearer = "") {
    sdk::ClientOptions client = Trusting(ours);
    if (&authority != &ours) client.connect_timeout = kRefused;
    client.token = bearer;
    if (!name.empty()) {
      client.tls.certificate = authority.file(name + ".pem");
      client.tls.key = authority.file(name + ".key");
    }
    return sdk::Client::Connect(Url(server), client);
  };
  using absl::StatusCode;
  const auto camera = *connect(ours, "camera");
  EXPECT_TRUE(camera->CreateSession(Spec("drive")).ok());
  EXPECT_EQ(camera->ListMaps().status().code(), StatusCode::kPermissionDenied);
  const auto viewer = *connect(ours, "viewer");
  EXPECT_EQ(viewer->ListSessions()->size(), 1U);
  EXPECT_EQ(viewer->DeleteSession("drive").code(),
            StatusCode::kPermissionDenied);
  const auto nobody = *connect(ours, "nobody");
  EXPECT_EQ(nobody->ListSessions().status().code(),
            StatusCode::kUnauthenticated);
  // A token says more than a certificate, and a wrong one is not made good by
  // it.
  EXPECT_TRUE((*connect(ours, "camera", token))->ListMaps().ok());
  EXPECT_EQ((*connect(ours, "camera", "wrong-token-0123"))
                ->ListSessions()
                .status()
                .code(),
            StatusCode::kUnauthenticated);
  EXPECT_TRUE((*connect(ours, "", token))->ListMaps().ok());
  // Of the same name, but of an authority that nobody believes.
  const auto stranger = connect(other, "camera");
  EXPECT_FALSE(stranger.ok() && (*stranger)->ListSessions().ok());
  // Two entries that fit one certificate: whose it is cannot be told.
  add("by-uri", "admin", "uri:spiffe://acme/camera");
  EXPECT_TRUE(Eventually([&] {
    return camera->ListSessions().status().code() ==
           StatusCode::kUnauthenticated;
  }));
}

// As far as gRPC lets one ask: what openssl's own client is told.
TEST(Tls, OffersNothingThatIsTooOld) {
  Authority ours("ours");
  ours.Issue("server");
  TestServer server(WithTls(ours));
  const auto connects = [&](const std::string& arguments) {
    const std::string command =
        "openssl s_client -connect " + server.address() + " -CAfile '" +
        ours.file("ca.pem").string() +
        "' -verify_return_error -verify_ip 127.0.0.1 -alpn h2 " + arguments +
        " </dev/null >'" + ours.file("s_client.log").string() + "' 2>&1";
    return std::system(command.c_str()) == 0;
  };
  const auto log = [&] {
    return *base::ReadFile(ours.file("s_client.log"), 1 << 20);
  };
  EXPECT_TRUE(connects("-tls1_3")) << log();
  EXPECT_THAT(log(), HasSubstr("Verify return code: 0 (ok)"));
  EXPECT_THAT(log(), HasSubstr("ALPN protocol: h2"));
  EXPECT_TRUE(connects("-tls1_2")) << log();
  // Keys that are thrown away, and encryption that is authenticated.
  EXPECT_TRUE(connects("-tls1_2 -cipher ECDHE+AESGCM")) << log();
  EXPECT_THAT(log(), HasSubstr("Compression: NONE"));
  EXPECT_THAT(log(), HasSubstr("Secure Renegotiation IS supported"));
  for (const char* old : {"-tls1_1 -cipher ALL:@SECLEVEL=0",
                          "-tls1 -cipher ALL:@SECLEVEL=0",
                          "-tls1_2 -cipher RC4:@SECLEVEL=0",
                          "-tls1_2 -cipher 3DES:@SECLEVEL=0",
                          "-tls1_2 -cipher aNULL:eNULL:@SECLEVEL=0",
                          "-tls1_2 -cipher kRSA:@SECLEVEL=0",
                          "-tls1_2 -cipher CBC:@SECLEVEL=0"}) {
    EXPECT_FALSE(connects(old)) << old << log();
  }
}

}  // namespace
}  // namespace groundlock::test
