// SPDX-License-Identifier: Apache-2.0
// The program itself: its options, its port, its signals, its other services.
#include "tests/integration/program.h"

#include <gmock/gmock.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <unistd.h>

#include <fstream>
#include <sstream>
#include <thread>

#include "groundlock/v1/maps.grpc.pb.h"
#include "groundlock/v1/tracking.grpc.pb.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::Not;

[[maybe_unused]] std::string HttpGet(int port, const std::string& path) {
  const int fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  std::string answer;
  if (connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof(address)) ==
      0) {
    const std::string request =
        "GET " + path + " HTTP/1.0\r\nHost: localhost\r\n\r\n";
    EXPECT_EQ(write(fd, request.data(), request.size()),
              static_cast<ssize_t>(request.size()));
    char buffer[4'096];
    for (ssize_t n = 0; (n = read(fd, buffer, sizeof(buffer))) > 0;) {
      answer.append(buffer, static_cast<std::size_t>(n));
    }
  }
  close(fd);
  return answer;
}

// Health and reflection are wire protocols: two varints and a string each, so
// the messages are written by hand instead of adding their definitions.
grpc::Status UnaryBytes(const std::shared_ptr<grpc::Channel>& channel,
                        const std::string& method,
                        const std::string& request,
                        std::string* response) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::seconds(60));
  grpc::CompletionQueue queue;
  const grpc::Slice slice(request);
  const grpc::ByteBuffer buffer(&slice, 1);
  const auto call = stub.PrepareUnaryCall(&context, method, buffer, &queue);
  call->StartCall();
  grpc::ByteBuffer answer;
  grpc::Status status;
  call->Finish(&answer, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  grpc::Slice whole;
  if (status.ok() && answer.TrySingleSlice(&whole).ok()) {
    response->assign(reinterpret_cast<const char*>(whole.begin()),
                     whole.size());
  }
  return status;
}

TEST(Program, ServesReportsAndStopsOnSigterm) {
  Program program({"--listen",
                   "127.0.0.1:0",
                   "--store",
                   "@TMP@/store",
                   "--metrics",
                   "127.0.0.1:0",
                   "--port-file",
                   "@TMP@/port"});
  const int port = program.PortAfter("listening on 127\\.0\\.0\\.1:");
  ASSERT_GT(port, 0) << program.Log();
  int written = 0;
  ASSERT_TRUE(Eventually([&] {
    std::ifstream stream(program.directory() / "port");
    return static_cast<bool>(stream >> written);
  }));
  EXPECT_EQ(written, port);

  const std::string address = "127.0.0.1:" + std::to_string(port);
  const auto channel =
      grpc::CreateChannel(address, grpc::InsecureChannelCredentials());
  std::string response;
  ASSERT_TRUE(
      UnaryBytes(channel, "/grpc.health.v1.Health/Check", "", &response).ok());
  EXPECT_EQ(response, std::string("\x08\x01", 2));  // status = SERVING

  auto client = ConnectTo(address);
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->CreateSession(Spec("s")).ok());
  auto stream = (*client)->Track("s");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
  const int metrics = program.PortAfter("metrics on port ");
  EXPECT_GT(metrics, 0);
  const std::string page = HttpGet(metrics, "/metrics");
  EXPECT_THAT(page, HasSubstr("groundlock_frames_processed_total 1"));
  EXPECT_THAT(page, HasSubstr("groundlock_sessions 1"));
  EXPECT_THAT(page, HasSubstr("groundlock_stage_seconds_bucket"));
  EXPECT_THAT(page, HasSubstr("groundlock_builds 0"));
  EXPECT_THAT(page, HasSubstr("groundlock_spans_total{outcome=\"sent\"} 0"));
  // The store is asked when it is tidied, which is at the start, and here.
  EXPECT_EQ((*client)->GetMap("nowhere").status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_TRUE(Eventually([&] {
    const std::string store = HttpGet(metrics, "/metrics");
    return store.find("groundlock_store_seconds_count{operation=\"get\"} 1") !=
               std::string::npos &&
           store.find("groundlock_store_seconds_count{operation=\"tidy\"} 0") ==
               std::string::npos &&
           store.find("groundlock_store_failures_total{operation=\"get\"} 0") !=
               std::string::npos;
  })) << HttpGet(metrics, "/metrics");

  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0) << program.Log();
  EXPECT_THAT(program.Log(), HasSubstr("stopped"));
  stream->reset();
}

// What Kubernetes asks: whether it is to be sent work, and whether it is to be
// started anew. While it ends it still lives.
TEST(Program, ProbesTellWhetherItServesAndWhetherItLives) {
  Program program({"--listen",
                   "127.0.0.1:0",
                   "--store",
                   "@TMP@/store",
                   "--metrics",
                   "127.0.0.1:0",
                   "--grace",
                   "600"});
  const int port = program.PortAfter("listening on 127\\.0\\.0\\.1:");
  ASSERT_GT(port, 0) << program.Log();
  const int metrics = program.PortAfter("metrics on port ");
  EXPECT_THAT(HttpGet(metrics, "/livez"), HasSubstr("200 OK"));
  EXPECT_THAT(HttpGet(metrics, "/readyz"), HasSubstr("200 OK"));
  // An upload that goes on while the server waits for it.
  const auto stub = v1::MapService::NewStub(grpc::CreateChannel(
      "127.0.0.1:" + std::to_string(port), grpc::InsecureChannelCredentials()));
  grpc::ClientContext context;
  v1::ImportMapResponse response;
  const auto import = stub->ImportMap(&context, &response);
  v1::ImportMapRequest header;
  header.mutable_header()->set_name("yard");
  ASSERT_TRUE(import->Write(header));
  ASSERT_TRUE(Eventually([&] {
    return HttpGet(metrics, "/metrics").find("groundlock_calls 1") !=
           std::string::npos;
  }));
  program.Signal(SIGTERM);
  EXPECT_TRUE(Eventually([&] {
    return HttpGet(metrics, "/readyz").find("503") != std::string::npos;
  }));
  EXPECT_THAT(HttpGet(metrics, "/readyz"), HasSubstr("starting or stopping"));
  EXPECT_THAT(HttpGet(metrics, "/livez"), HasSubstr("200 OK"));
  context.TryCancel();
  EXPECT_FALSE(import->Finish().ok());
  EXPECT_EQ(program.Wait(), 0) << program.Log();
}

TEST(Program, JsonLinesSayWhoseCallTheyAreOf) {
  const auto directory =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path tokens = directory.path() / "tokens";
  sdk::ClientOptions options;
  options.token = "a-token-of-some-length";
  std::ofstream(tokens) << options.token << '\n';
  fs::permissions(tokens, fs::perms::owner_read | fs::perms::owner_write);
  Program program({"--listen",
                   "127.0.0.1:0",
                   "--store",
                   "@TMP@/store",
                   "--token-file",
                   tokens.string(),
                   "--log-format",
                   "json"});
  Eventually([&] {
    return program.Log().find("listening on") != std::string::npos ||
           program.Exited();
  });
  const std::string log = program.Log();
  const std::string before = "listening on 127.0.0.1:";
  ASSERT_NE(log.find(before), std::string::npos) << log;
  const int port = std::stoi(log.substr(log.find(before) + before.size()));
  auto client = ConnectTo("127.0.0.1:" + std::to_string(port), options);
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->CreateSession(Spec("drive-7")).ok());
  EXPECT_FALSE((*client)->DeleteMap("nowhere").ok());
  const auto lines_with = [&](const std::string& text) {
    std::vector<std::string> found;
    std::istringstream lines(program.Log());
    for (std::string line; std::getline(lines, line);) {
      if (line.find(text) != std::string::npos) found.push_back(line);
    }
    return found;
  };
  // Answered before it is written, maybe.
  ASSERT_TRUE(Eventually([&] { return lines_with("DeleteMap").size() == 1; }));
  EXPECT_THAT(lines_with("DeleteMap").front(),
              AllOf(HasSubstr(R"(","request_id":")"),
                    HasSubstr(R"("principal":")"),
                    HasSubstr(R"("peer":"ipv4:127.0.0.1:)"),
                    HasSubstr(R"("method":"DeleteMap","map":"nowhere")"),
                    EndsWith(R"("status":"NOT_FOUND"})")));
  const auto created = lines_with("created without a map");
  ASSERT_EQ(created.size(), 1U);
  EXPECT_THAT(created.front(),
              AllOf(HasSubstr(R"("request_id":")"),
                    HasSubstr(R"("peer":"ipv4:127.0.0.1:)"),
                    HasSubstr(R"("session":"drive-7"})")));
  const auto listening = lines_with("listening on");
  ASSERT_EQ(listening.size(), 1U);
  EXPECT_THAT(listening.front(), Not(HasSubstr("request_id")));
}

TEST(Program, AKilledServerComesBackOnTheSameStore) {
  const auto directory =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const std::string store = (directory.path() / "store").string();
  {
    Program program({"--listen", "127.0.0.1:0", "--store", store});
    ASSERT_GT(program.PortAfter("listening on 127\\.0\\.0\\.1:"), 0);
    // As an upload that was under way leaves it.
    fs::create_directories(fs::path(store) / "scratch" / ".tmp-left");
    program.Signal(SIGKILL);
    EXPECT_EQ(program.Wait(), -1);
  }
  Program program({"--listen", "127.0.0.1:0", "--store", store});
  ASSERT_GT(program.PortAfter("listening on 127\\.0\\.0\\.1:"), 0)
      << program.Log();
  EXPECT_TRUE(fs::is_empty(fs::path(store) / "scratch"));
  program.Signal(SIGINT);
  EXPECT_EQ(program.Wait(), 0);
}

TEST(Program, RefusesWhatItCannotServe) {
  Program other({"--store", "mysql://localhost/maps"});
  EXPECT_EQ(other.Wait(), 1);
  EXPECT_THAT(other.Log(), HasSubstr("mysql:// is not supported"));
  Program option({"--listen", "127.0.0.1:0", "--nonsense"});
  EXPECT_NE(option.Wait(), 0);
  Program open({"--listen", "0.0.0.0:0", "--store", "@TMP@/store"});
  EXPECT_EQ(open.Wait(), 1);
  EXPECT_THAT(open.Log(), HasSubstr("--tls-cert and --tls-key"));
  // Not an address of this machine: so that it gets as far as to bind it.
  Program address(
      {"--listen", "256.0.0.1:1", "--insecure", "--store", "@TMP@/store"});
  EXPECT_EQ(address.Wait(), 1);
  EXPECT_THAT(address.Log(), HasSubstr("cannot bind"));
}

TEST(Program, ReadsItsOptionsFromAFile) {
  const auto directory =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path config = directory.path() / "server.toml";
  std::ofstream(config) << "listen = \"127.0.0.1:0\"\nstore = \""
                        << (directory.path() / "store").string()
                        << "\"\nmax-sessions = 1\n";
  Program program({"--config", config.string()});
  const int port = program.PortAfter("listening on 127\\.0\\.0\\.1:");
  ASSERT_GT(port, 0) << program.Log();
  auto client = ConnectTo("127.0.0.1:" + std::to_string(port));
  ASSERT_TRUE(client.ok());
  EXPECT_TRUE((*client)->CreateSession(Spec("a")).ok());
  EXPECT_EQ((*client)->CreateSession(Spec("b")).status().code(),
            absl::StatusCode::kResourceExhausted);
  program.Signal(SIGTERM);
  EXPECT_EQ(program.Wait(), 0);
}

TEST(Program, ReflectionListsTheServices) {
  TestServer server;
  const auto channel =
      grpc::CreateChannel(server.address(), grpc::InsecureChannelCredentials());
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::seconds(60));
  grpc::CompletionQueue queue;
  const auto call = stub.PrepareCall(
      &context,
      "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
      &queue);
  void* tag = nullptr;
  bool ok = false;
  call->StartCall(nullptr);
  queue.Next(&tag, &ok);
  // list_services (field 7) = "*".
  const grpc::Slice slice(std::string("\x3a\x01*", 3));
  call->WriteLast(grpc::ByteBuffer(&slice, 1), grpc::WriteOptions(), nullptr);
  queue.Next(&tag, &ok);
  ASSERT_TRUE(ok);
  grpc::ByteBuffer answer;
  call->Read(&answer, nullptr);
  queue.Next(&tag, &ok);
  ASSERT_TRUE(ok);
  grpc::Slice whole;
  ASSERT_TRUE(answer.DumpToSingleSlice(&whole).ok());
  const std::string text(reinterpret_cast<const char*>(whole.begin()),
                         whole.size());
  EXPECT_THAT(text, HasSubstr("groundlock.v1.TrackingService"));
  EXPECT_THAT(text, HasSubstr("groundlock.v1.MapService"));
  EXPECT_THAT(text, HasSubstr("grpc.health.v1.Health"));
  grpc::Status status;
  call->Finish(&status, nullptr);
  queue.Next(&tag, &ok);
}

}  // namespace
}  // namespace groundlock::test
