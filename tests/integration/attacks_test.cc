// SPDX-License-Identifier: Apache-2.0
// What a client may do to harm others, and that it does not.
#include <gmock/gmock.h>
#include <google/protobuf/message.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <filesystem>
#include <future>
#include <thread>

#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

using ::testing::AnyOf;
using ::testing::HasSubstr;

// Two sessions whose frames keep both workers busy until the gate opens.
class BusyWorkers {
 public:
  BusyWorkers(TestServer& server, Gate& gate)
      : gate_(gate), client_(server.Connect()) {
    for (const char* id : {"busy-1", "busy-2"}) {
      EXPECT_TRUE(client_->CreateSession(Spec(id)).ok());
      auto stream = client_->Track(id);
      EXPECT_TRUE(stream.ok()) << stream.status();
      EXPECT_TRUE((*stream)->Send(TinyFrame(0)).ok());
      EXPECT_TRUE((*stream)->Send(TinyFrame(1)).ok());
      streams_.push_back(*std::move(stream));
    }
    EXPECT_TRUE(Eventually([this] { return gate_.waiting() == 2; }));
  }
  // All of their frames are answered.
  void Release() {
    gate_.OpenForGood();
    for (const auto& stream : streams_) {
      for (int k = 0; k < 2; ++k) {
        const auto reply = stream->Next();
        ASSERT_TRUE(reply.ok()) << reply.status();
      }
    }
  }

 private:
  Gate& gate_;
  std::unique_ptr<sdk::Client> client_;
  std::vector<std::unique_ptr<sdk::TrackingStream>> streams_;
};

service::ServerOptions TwoWorkers() {
  service::ServerOptions options;
  options.worker_threads = 2;
  return options;
}

TEST(Attacks, SessionsThatComeAndGoWhileWorkersAreBusyStopNothing) {
  Gate gate;
  TestServer server(TwoWorkers(), GatedCores(&gate));
  BusyWorkers busy(server, gate);
  const auto attacker = server.Connect();
  // What they are logged with would bury a failure.
  const auto level = spdlog::get_level();
  spdlog::set_level(spdlog::level::warn);
  for (int i = 0; i < 1'000; ++i) {
    const std::string id = "short-lived-" + std::to_string(i);
    const auto created = attacker->CreateSession(Spec(id));
    EXPECT_TRUE(created.ok()) << i << ": " << created.status();
    const absl::Status deleted = attacker->DeleteSession(id);
    EXPECT_TRUE(deleted.ok()) << i << ": " << deleted;
    if (!created.ok() || !deleted.ok()) break;
  }
  spdlog::set_level(level);
  const auto other = server.Connect();
  EXPECT_TRUE(other->ListMaps().ok());
  EXPECT_EQ(other->ListSessions()->size(), 2U);
  busy.Release();
  // A new session is served, and the end comes.
  ASSERT_TRUE(other->CreateSession(Spec("after")).ok());
  auto stream = other->Track("after");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE((*stream)->Send(TinyFrame(0)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
  server.Stop(std::chrono::seconds(5));
}

TEST(Attacks, ATargetOperationIsAnsweredWhenItsSessionIsDeletedMeanwhile) {
  Gate gate;
  TestServer server(TwoWorkers(), GatedCores(&gate));
  for (int round = 0; round < 10; ++round) {
    const auto client = server.Connect();
    ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
    auto stream = client->Track("s");
    ASSERT_TRUE(stream.ok());
    ASSERT_TRUE((*stream)->Send(TinyFrame(0)).ok());
    ASSERT_TRUE(Eventually([&] { return gate.waiting() == 1; }));
    auto target = std::async(std::launch::async, [&] {
      return client->SetTarget(
          "s", "t", geometry::Box2::FromXywh(0, 0, 1, 1), std::nullopt);
    });
    // Until it waits behind the frame; nothing tells a client so.
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    const auto deleter = server.Connect();
    ASSERT_TRUE(deleter->DeleteSession("s").ok());
    ASSERT_EQ(target.wait_for(std::chrono::minutes(1)),
              std::future_status::ready)
        << "round " << round;
    EXPECT_EQ(target.get().status().code(), absl::StatusCode::kNotFound);
    gate.Open(1);
    // Else the next round's frame may be the one that is let through.
    ASSERT_TRUE(Eventually([&] { return gate.waiting() == 0; }));
  }
  // Nothing is left that the end would have to wait for.
  const auto start = std::chrono::steady_clock::now();
  server.Stop(std::chrono::minutes(4));
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::minutes(2));
}

// A call whose client sends no more than `request` says, if anything, and then
// nothing: the status with which the server ends it.
class SilentCall {
 public:
  SilentCall(const std::string& address,
             const std::string& method,
             const google::protobuf::Message* request,
             const std::string& authorization = "")
      : stub_(
            grpc::CreateChannel(address, grpc::InsecureChannelCredentials())) {
    if (!authorization.empty()) {
      context_.AddMetadata("authorization", authorization);
    }
    context_.set_deadline(std::chrono::system_clock::now() +
                          std::chrono::seconds(60));
    call_ = stub_.PrepareCall(&context_, method, &queue_);
    call_->StartCall(nullptr);
    Wait();
    if (request == nullptr) return;
    const std::string bytes = request->SerializeAsString();
    const grpc::Slice slice(bytes);
    call_->Write(grpc::ByteBuffer(&slice, 1), nullptr);
    Wait();
  }
  grpc::Status End() {
    grpc::ByteBuffer response;
    do {
      call_->Read(&response, nullptr);
    } while (Wait());
    grpc::Status status;
    call_->Finish(&status, nullptr);
    Wait();
    return status;
  }

 private:
  bool Wait() {
    void* tag = nullptr;
    bool ok = false;
    return queue_.Next(&tag, &ok) && ok;
  }

  grpc::GenericStub stub_;
  grpc::ClientContext context_;
  grpc::CompletionQueue queue_;
  std::unique_ptr<grpc::GenericClientAsyncReaderWriter> call_;
};

constexpr char kMaps[] = "/groundlock.v1.MapService/";
constexpr char kTracking[] = "/groundlock.v1.TrackingService/";

service::ServerOptions ShortPatience() {
  service::ServerOptions options;
  options.client_silence = std::chrono::milliseconds(400);
  options.maps.max_concurrent_uploads = 1;
  options.maps.max_concurrent_builds = 1;
  return options;
}

// By the server: the client's own deadline has the same code.
void ExpectGivenUp(const grpc::Status& status, const std::string& method) {
  EXPECT_EQ(status.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED) << method;
  EXPECT_THAT(status.error_message(),
              AnyOf(HasSubstr("too little"), HasSubstr("not arrive in time")))
      << method;
}

TEST(Attacks, ASilentUploadGivesItsPlaceBack) {
  TestServer server(ShortPatience());
  v1::ImportMapRequest import;
  import.mutable_header()->set_name("silent");
  v1::BuildMapRequest build;
  build.mutable_header()->set_name("silent");
  for (int round = 0; round < 2; ++round) {
    SilentCall first(
        server.address(), std::string(kMaps) + "ImportMap", &import);
    ExpectGivenUp(first.End(), "ImportMap");
    SilentCall second(
        server.address(), std::string(kMaps) + "BuildMap", &build);
    ExpectGivenUp(second.End(), "BuildMap");
  }
  EXPECT_TRUE(Eventually([&] {
    return std::filesystem::is_empty(server.scratch());
  })) << "what was sent is gone";
}

TEST(Attacks, AFailedUploadGivesItsPlaceBackBeforeItsClientHearsOfIt) {
  TestServer server(ShortPatience());
  const auto channel = RawChannel(server.address());
  for (int round = 0; round < 100; ++round) {
    for (const char* method : {"ImportMap", "BuildMap"}) {
      // Its first message is no header.
      EXPECT_EQ(CallRaw(channel, std::string(kMaps) + method, "", {""})
                    .status.error_code(),
                grpc::StatusCode::INVALID_ARGUMENT)
          << method << ", round " << round;
    }
  }
}

TEST(Attacks, ACallWithoutARequestEnds) {
  TestServer server(ShortPatience());
  for (const char* method :
       {"Track", "WatchSession", "Localize", "GetSession"}) {
    SilentCall call(server.address(), std::string(kTracking) + method, nullptr);
    ExpectGivenUp(call.End(), method);
  }
  for (const char* method : {"ExportMap", "GetPointCloud", "ListMaps"}) {
    SilentCall call(server.address(), std::string(kMaps) + method, nullptr);
    ExpectGivenUp(call.End(), method);
  }
  server.Stop(std::chrono::seconds(5));
}

TEST(Attacks, AStrangersRequestIsNotRead) {
  service::ServerOptions options;
  options.tokens = {"0123456789abcdef"};
  TestServer server(options);
  for (const char* method :
       {"Localize", "CreateSession", "Track", "WatchSession"}) {
    // It has sent nothing but its headers when it is told to go.
    SilentCall call(server.address(),
                    std::string(kTracking) + method,
                    nullptr,
                    "Bearer not-the-token-01");
    EXPECT_EQ(call.End().error_code(), grpc::StatusCode::UNAUTHENTICATED)
        << method;
  }
}

TEST(Attacks, OnlyImagesMayBeLarge) {
  TestServer server;
  v1::GetSessionRequest session;
  session.set_session_id(std::string(1 << 20, 'x'));
  SilentCall get(
      server.address(), std::string(kTracking) + "GetSession", &session);
  EXPECT_EQ(get.End().error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  v1::LocalizeRequest localize;
  localize.set_map_name("nowhere");
  localize.mutable_image()->set_data(std::string(1 << 20, 'x'));
  // It is read, and looked into.
  SilentCall image(
      server.address(), std::string(kTracking) + "Localize", &localize);
  EXPECT_EQ(image.End().error_code(), grpc::StatusCode::NOT_FOUND);
}

TEST(Attacks, AStreamThroughWhichNothingComesKeepsNoSession) {
  service::ServerOptions options;
  options.sessions.stream_idle_timeout = std::chrono::milliseconds(300);
  TestServer server(options);
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  EXPECT_EQ((*stream)->Next().status().code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(client->ListSessions()->empty());
}

// grpc.health.v1.HealthCheckResponse: 1 SERVING, 2 NOT_SERVING.
int Health(const std::string& address) {
  grpc::GenericStub stub(
      grpc::CreateChannel(address, grpc::InsecureChannelCredentials()));
  grpc::ClientContext context;
  grpc::CompletionQueue queue;
  const grpc::Slice none;
  const grpc::ByteBuffer nothing(&none, 1);  // a message without fields
  auto call = stub.PrepareUnaryCall(
      &context, "/grpc.health.v1.Health/Check", nothing, &queue);
  call->StartCall();
  grpc::ByteBuffer response;
  grpc::Status status;
  call->Finish(&response, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  std::vector<grpc::Slice> slices;
  if (!status.ok() || !response.Dump(&slices).ok()) return 0;
  std::string bytes;
  for (const grpc::Slice& slice : slices) {
    bytes.append(reinterpret_cast<const char*>(slice.begin()), slice.size());
  }
  return bytes.size() == 2 ? bytes[1] : 0;
}

TEST(Attacks, HealthSaysThatFramesStandStillAndThatTheyGoOn) {
  Gate gate;
  service::ServerOptions options = TwoWorkers();
  options.stall_timeout = std::chrono::milliseconds(400);
  TestServer server(options, GatedCores(&gate));
  EXPECT_EQ(Health(server.address()), 1);
  BusyWorkers busy(server, gate);
  std::this_thread::sleep_for(std::chrono::seconds(1));
  EXPECT_EQ(Health(server.address()), 1)
      << "the sessions in work hold up nobody";
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("waiting")).ok());
  auto stream = client->Track("waiting");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE((*stream)->Send(TinyFrame(0)).ok());
  EXPECT_TRUE(Eventually([&] { return Health(server.address()) == 2; }));
  EXPECT_EQ(server.metrics().stalled, 1);
  EXPECT_EQ(server.metrics().serving, 0);
  busy.Release();
  EXPECT_TRUE(Eventually([&] { return Health(server.address()) == 1; }));
  EXPECT_EQ(server.metrics().stalled, 0);
  EXPECT_EQ(server.metrics().serving, 1);
}

}  // namespace
}  // namespace groundlock::test
