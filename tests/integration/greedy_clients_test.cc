// SPDX-License-Identifier: Apache-2.0
// Clients that take places, memory or the disk, and give nothing back: by not
// reading what they have asked for, by sending slowly for ever, or by sending
// as much as they may.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <list>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "groundlock/v1/maps.grpc.pb.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/token_file.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/raw_connection.h"
#include "tests/integration/test_server.h"
#include "tests/integration/text_model.h"

namespace groundlock::test {
namespace {

using ::testing::HasSubstr;

constexpr char kTracking[] = "/groundlock.v1.TrackingService/";
constexpr char kMaps[] = "/groundlock.v1.MapService/";

// One that reads no answer.
class DeafClient {
 public:
  explicit DeafClient(const TestServer& server, std::string authorization = "")
      : authorization_(std::move(authorization)),
        connection_(PortOf(server), "127.0.0.2") {
    EXPECT_TRUE(connection_.Send(std::string(kHttp2Preface) +
                                 Http2SettingsWithoutWindow()));
  }
  void Call(const std::string& path,
            const google::protobuf::Message& request,
            bool is_last = true) {
    EXPECT_TRUE(connection_.Send(
        Http2Call(next_, path, authorization_) +
        Http2Message(next_, request.SerializeAsString(), is_last)));
    next_ += 2;
  }

 private:
  static int PortOf(const TestServer& server) {
    const std::string address = server.address();
    return std::stoi(address.substr(address.rfind(':') + 1));
  }
  const std::string authorization_;
  RawConnection connection_;
  std::uint32_t next_ = 1;
};

v1::TrackRequest Attach(const std::string& session) {
  v1::TrackRequest request;
  request.mutable_attach()->set_session_id(session);
  return request;
}

service::ServerOptions ShortPatience() {
  service::ServerOptions options;
  options.client_silence = std::chrono::milliseconds(400);
  return options;
}

TEST(GreedyClients, AnswersThatNobodyTakesHoldNoCalls) {
  TestServer server(ShortPatience());
  const service::Metrics& metrics = server.metrics();
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  DeafClient deaf(server);
  // A message without fields, of whatever type: all of them answer it.
  const v1::ListSessionsRequest nothing;
  for (int i = 0; i < 20; ++i) {
    deaf.Call(std::string(kTracking) + "ListSessions", nothing);
    deaf.Call(std::string(kMaps) + "ListMaps", nothing);
    deaf.Call("/grpc.health.v1.Health/Check", nothing);
    deaf.Call("/grpc.health.v1.Health/Watch", nothing);
  }
  EXPECT_TRUE(Eventually([&] { return metrics.calls > 0; }));
  EXPECT_TRUE(Eventually([&] { return metrics.calls == 0; })) << metrics.calls;
  EXPECT_TRUE(client->ListSessions().ok());
}

TEST(GreedyClients, AWatcherThatTakesNothingIsLetGo) {
  TestServer server(ShortPatience());
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  DeafClient deaf(server);
  v1::WatchSessionRequest watch;
  watch.set_session_id("s");
  deaf.Call(std::string(kTracking) + "WatchSession", watch);
  EXPECT_TRUE(Eventually([&] { return server.metrics().watchers == 1; }));
  // Whoever takes everything may be told nothing for as long as it likes.
  auto keen = client->Watch("s", false);
  ASSERT_TRUE(keen.ok()) << keen.status();
  std::this_thread::sleep_for(2 * ShortPatience().client_silence);
  EXPECT_EQ(server.metrics().watchers, 2);
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
  EXPECT_TRUE(Eventually([&] { return server.metrics().watchers == 1; }));
  EXPECT_TRUE((*keen)->Next().ok());
}

// Tells when it is gone.
class CountedCores {
 public:
  service::CoreFactory Factory() {
    return [this, gated = GatedCores(&gate_)](
               auto map, const auto& camera, const auto& options)
               -> absl::StatusOr<std::unique_ptr<tracking::TrackingSession>> {
      auto core = gated(std::move(map), camera, options);
      if (!core.ok()) return core.status();
      return std::make_unique<Counted>(*std::move(core), &alive_);
    };
  }
  Gate& gate() { return gate_; }
  int alive() const { return alive_; }

 private:
  class Counted final : public tracking::TrackingSession {
   public:
    Counted(std::unique_ptr<tracking::TrackingSession> core,
            std::atomic<int>* alive)
        : core_(std::move(core)), alive_(alive) {
      ++*alive_;
    }
    ~Counted() override { --*alive_; }
    absl::Status SetTarget(const std::string& id,
                           const geometry::Box2& box_px,
                           std::optional<std::uint64_t> at,
                           const tracking::TargetBody& body) override {
      return core_->SetTarget(id, box_px, at, body);
    }
    absl::Status MoveTarget(const std::string& id,
                            const geometry::Box2& box_px) override {
      return core_->MoveTarget(id, box_px);
    }
    absl::Status DropTarget(const std::string& id) override {
      return core_->DropTarget(id);
    }
    std::vector<std::string> TargetIds() const override {
      return core_->TargetIds();
    }
    void SetHurried(bool hurried) override { core_->SetHurried(hurried); }
    absl::StatusOr<tracking::FrameResult> ProcessFrame(
        const image::Frame& frame,
        const std::optional<geometry::CameraModel>& camera,
        const tracking::SensorReadings& sensors,
        std::vector<absl::Status>* target_errors) override {
      return core_->ProcessFrame(frame, camera, sensors, target_errors);
    }

   private:
    const std::unique_ptr<tracking::TrackingSession> core_;
    std::atomic<int>* const alive_;
  };

  Gate gate_;
  std::atomic<int> alive_{0};
};

// Otherwise a caller would have as many sessions as calls, whatever its quota.
TEST(GreedyClients, ADeletedSessionIsGoneAlthoughItsStreamsAreNotRead) {
  CountedCores cores;
  cores.gate().OpenForGood();
  service::ServerOptions options;
  options.client_silence = std::chrono::minutes(10);
  TestServer server(options, cores.Factory());
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  DeafClient deaf(server);
  deaf.Call(std::string(kTracking) + "Track", Attach("s"), /*is_last=*/false);
  ASSERT_TRUE(Eventually([&] { return client->GetSession("s")->streaming; }));
  v1::WatchSessionRequest watch;
  watch.set_session_id("s");
  deaf.Call(std::string(kTracking) + "WatchSession", watch);
  ASSERT_TRUE(Eventually([&] { return server.metrics().watchers == 1; }));
  EXPECT_EQ(cores.alive(), 1);
  ASSERT_TRUE(client->DeleteSession("s").ok());
  EXPECT_TRUE(Eventually([&] { return cores.alive() == 0; }));
}

TEST(GreedyClients, AStreamThatEndsDoesNotWaitForWhoeverReadsNothing) {
  TestServer server(ShortPatience());
  const service::Metrics& metrics = server.metrics();
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  DeafClient deaf(server);
  deaf.Call(std::string(kTracking) + "Track", Attach("s"), /*is_last=*/false);
  ASSERT_TRUE(Eventually([&] { return client->GetSession("s")->streaming; }));
  ASSERT_TRUE(client->DeleteSession("s").ok());
  EXPECT_TRUE(Eventually([&] { return metrics.streams == 0; }));
  EXPECT_TRUE(Eventually([&] { return metrics.calls == 0; }));
}

TEST(GreedyClients, ARevokedTokenEndsStreamsThatAreNotRead) {
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto file = directory.path() / "tokens";
  service::ServerOptions options = ShortPatience();
  options.token_file = file.string();
  sdk::ClientOptions admin;
  admin.token = *base::CreateToken(file, {"stays", "", {"admin"}, ""});
  const std::string goes =
      *base::CreateToken(file, {"goes", "", {"admin"}, ""});
  TestServer server(options);
  const auto client = *ConnectTo(server.address(), admin);
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  DeafClient deaf(server, "Bearer " + goes);
  deaf.Call(std::string(kTracking) + "Track", Attach("s"), /*is_last=*/false);
  ASSERT_TRUE(Eventually([&] { return client->GetSession("s")->streaming; }));
  ASSERT_TRUE(base::RevokeToken(file, "goes").ok());
  EXPECT_TRUE(Eventually([&] { return server.metrics().streams == 0; }));
  EXPECT_FALSE(client->GetSession("s")->streaming);
}

TEST(GreedyClients, AnUploadThatTricklesGivesItsPlaceBack) {
  service::ServerOptions options;
  options.maps.upload_timeout = std::chrono::milliseconds(500);
  options.maps.max_concurrent_uploads = 1;
  TestServer server(options);
  const auto stub = v1::MapService::NewStub(RawChannel(server.address()));
  grpc::ClientContext context;
  v1::ImportMapResponse response;
  const auto import = stub->ImportMap(&context, &response);
  v1::ImportMapRequest message;
  message.mutable_header()->set_name("yard");
  ASSERT_TRUE(import->Write(message));
  message.mutable_file_start()->set_path("points3D.bin");
  message.mutable_file_start()->set_size_bytes(std::uint64_t{1} << 33);
  ASSERT_TRUE(import->Write(message));
  // Far more than a client must send, to be waited for.
  message.set_chunk(std::string(4'096, 'x'));
  while (import->Write(message)) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  const grpc::Status status = import->Finish();
  EXPECT_EQ(status.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_THAT(status.error_message(), HasSubstr("sending took more than"));
  EXPECT_TRUE(std::filesystem::is_empty(server.scratch()));
}

TEST(GreedyClients, AnImportThatTakesTooLongIsEnded) {
  service::ServerOptions options;
  options.maps.import_timeout = std::chrono::nanoseconds(1);
  TestServer server(options);
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto client = server.Connect();
  const absl::Status status =
      client->ImportMap(WriteForImport(directory.path(), "yard", TextModel()))
          .status();
  EXPECT_EQ(status.code(), absl::StatusCode::kDeadlineExceeded) << status;
  EXPECT_THAT(status.ToString(), HasSubstr("the import took more than"));
  EXPECT_TRUE(client->ListMaps()->empty());
}

TEST(GreedyClients, ExportsThatAreNotTakenDoNotFillTheDisk) {
  service::ServerOptions options;
  options.maps.max_concurrent_exports = 2;
  TestServer server(options);
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto client = server.Connect();
  ASSERT_TRUE(
      client->ImportMap(WriteForImport(directory.path(), "yard", TextModel()))
          .ok());
  const auto stub = v1::MapService::NewStub(RawChannel(server.address()));
  v1::ExportMapRequest request;
  request.set_name("yard");
  request.set_format(v1::MAP_EXPORT_FORMAT_PLY);
  const auto export_map = [&] {
    grpc::ClientContext context;
    const auto reader = stub->ExportMap(&context, request);
    v1::ExportMapResponse response;
    while (reader->Read(&response)) {
    }
    return reader->Finish();
  };
  EXPECT_TRUE(export_map().ok());
  const auto lie_there = [&] {
    return std::distance(std::filesystem::directory_iterator(server.scratch()),
                         {});
  };
  {
    DeafClient deaf(server);
    for (int i = 0; i < 20; ++i) {
      deaf.Call(std::string(kMaps) + "ExportMap", request);
    }
    // A call is counted before its export lies there.
    ASSERT_TRUE(Eventually([&] {
      return server.metrics().calls == 2 && lie_there() == 2;
    })) << "the others are refused";
    const grpc::Status refused = export_map();
    EXPECT_EQ(refused.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
    EXPECT_THAT(refused.error_message(), HasSubstr("2 exports at a time"));
    EXPECT_EQ(lie_there(), 2);
  }
  EXPECT_TRUE(Eventually([&] { return lie_there() == 0; }));
  EXPECT_TRUE(export_map().ok());
}

// Half of the memory, 6 MiB, is common: four frames of 1.5 MiB.
TEST(GreedyClients, LargeFramesFillNoMoreMemoryThanTheyMay) {
  constexpr int kSessions = 10;
  constexpr std::size_t kBytes = 3 << 19;
  Gate gate;
  service::ServerOptions options;
  options.worker_threads = 1;
  options.max_message_bytes = 2 << 20;
  options.sessions.frame_memory_bytes = 12 << 20;
  TestServer server(options, GatedCores(&gate));
  const auto client = server.Connect();
  const auto begin = [&](const std::string& id, sdk::Frame frame) {
    EXPECT_TRUE(client->CreateSession(Spec(id)).ok());
    auto stream = client->Track(id);
    EXPECT_TRUE(stream.ok()) << stream.status();
    EXPECT_TRUE((*stream)->Send(std::move(frame)).ok());
    return *std::move(stream);
  };
  const auto busy = begin("busy", TinyFrame(0));
  ASSERT_TRUE(Eventually([&] { return gate.waiting() == 1; }));
  std::vector<std::unique_ptr<sdk::TrackingStream>> greedy;
  for (int i = 0; i < kSessions; ++i) {
    sdk::Frame frame = TinyFrame(0);
    frame.image.bytes.resize(kBytes);
    greedy.push_back(begin("greedy-" + std::to_string(i), std::move(frame)));
  }
  EXPECT_TRUE(Eventually([&] {
    return server.metrics().calls_over_limit == kSessions - 4;
  })) << server.metrics().calls_over_limit;
  // Whoever sends frames of an ordinary size does not notice.
  const auto modest = begin("modest", TinyFrame(0));
  gate.OpenForGood();
  const auto reply = modest->Next();
  ASSERT_TRUE(reply.ok() && reply->has_value()) << reply.status();
  EXPECT_TRUE(std::holds_alternative<sdk::FrameResult>(**reply));
  int refused = 0;
  for (const auto& stream : greedy) {
    const auto answer = stream->Next();
    ASSERT_TRUE(answer.ok() && answer->has_value()) << answer.status();
    const auto* error = std::get_if<sdk::FrameError>(&**answer);
    if (error != nullptr &&
        error->status.code() == absl::StatusCode::kResourceExhausted) {
      ++refused;
    }
  }
  EXPECT_EQ(refused, kSessions - 4);
  // What is done with makes room.
  EXPECT_TRUE(greedy[0]->Send(TinyFrame(1)).ok());
  EXPECT_TRUE(greedy[0]->Next().ok());
}

TEST(GreedyClients, StrangersWhoWatchHealthLeaveRoomToOthers) {
  service::ServerOptions options;
  options.calls = {.max_calls = 80, .max_calls_per_address = 20};
  TestServer server(options);
  const service::Metrics& metrics = server.metrics();
  std::list<RawConnection> strangers;
  for (const char* from :
       {"127.0.0.2", "127.0.0.3", "127.0.0.4", "127.0.0.5"}) {
    std::string calls = std::string(kHttp2Preface) + Http2Settings();
    for (std::uint32_t i = 0; i < 20; ++i) {
      calls += Http2Call(2 * i + 1, "/grpc.health.v1.Health/Watch");
    }
    ASSERT_TRUE(
        strangers.emplace_back(server.server().port(), from).Send(calls));
  }
  EXPECT_TRUE(Eventually([&] {
    return metrics.calls == 10 && metrics.calls_over_limit == 70;
  })) << metrics.calls
      << ", " << metrics.calls_over_limit;
  EXPECT_TRUE(server.Connect()->ListSessions().ok());
}

}  // namespace
}  // namespace groundlock::test
