// SPDX-License-Identifier: Apache-2.0
// Sessions over a real socket: what is tracked, in which order answers come,
// and what happens when clients are slow, rude or gone.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>
#include <map>
#include <thread>

#include "absl/time/clock.h"
#include "groundlock/v1/tracking.grpc.pb.h"
#include "grpcpp/grpcpp.h"
#include "map_store/base/image_header.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

const sdk::FrameResult* Result(
    const absl::StatusOr<std::optional<sdk::FrameReply>>& reply) {
  if (!reply.ok() || !reply->has_value()) return nullptr;
  return std::get_if<sdk::FrameResult>(&**reply);
}

TEST(Sessions, TheDefaultTrackerFollowsAMovingSquareWithoutAMap) {
  TestServer server;
  const auto client = server.Connect();
  sdk::SessionSpec spec = Spec("");
  spec.options.camera_lost_after_s = 0.25;
  const auto session = client->CreateSession(spec);
  ASSERT_TRUE(session.ok()) << session.status();
  const std::string id = session->spec.session_id;
  EXPECT_EQ(session->spec.options.tracker, "dcf");
  EXPECT_EQ(session->spec.options.camera_lost_after_s, 0.25);
  ASSERT_TRUE(
      client
          ->SetTarget(id, "square", geometry::Box2::FromXywh(20, 30, 24, 24), 1)
          .ok());
  auto stream = client->Track(id);
  ASSERT_TRUE(stream.ok()) << stream.status();
  for (int k = 0; k < 20; ++k) {
    const auto sequence = static_cast<std::uint64_t>(k + 1);
    ASSERT_TRUE(
        (*stream)->Send(SquareFrame(sequence, 20 + 3 * k, 30 + k)).ok());
    const auto reply = (*stream)->Next();
    const sdk::FrameResult* result = Result(reply);
    ASSERT_NE(result, nullptr) << reply.status();
    EXPECT_EQ(result->sequence, sequence);
    EXPECT_EQ(result->capture_time, std::chrono::milliseconds(40) * sequence);
    ASSERT_EQ(result->targets.size(), 1U);
    EXPECT_EQ(result->targets[0].state, sdk::TargetState::kTracked);
    ASSERT_TRUE(result->targets[0].box_px.has_value());
    // The filter's cell is box * 5 / 48 = 2.5 px; half the box would be lost.
    EXPECT_GT(geometry::IntersectionOverUnion(
                  *result->targets[0].box_px,
                  geometry::Box2::FromXywh(20 + 3 * k, 30 + k, 24, 24)),
              0.6)
        << "frame " << sequence;
    EXPECT_FALSE(result->camera.world_from_camera.has_value());
  }
  EXPECT_TRUE((*stream)->Finish().ok());
  const auto after = client->GetSession(id);
  ASSERT_TRUE(after.ok());
  EXPECT_EQ(after->frames_processed, 20U);
  EXPECT_EQ(after->next_sequence, 21U);
  EXPECT_THAT(after->target_ids, ElementsAre("square"));
}

TEST(Sessions, ThreeClientsDoNotMix) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  std::vector<std::future<int>> clients;
  for (int i = 0; i < 3; ++i) {
    clients.push_back(std::async(std::launch::async, [&server, i] {
      const auto client = server.Connect();
      sdk::SessionSpec spec = Spec("session-" + std::to_string(i));
      spec.camera = TestCamera(100 + i);
      if (!client->CreateSession(spec).ok()) return 0;
      auto stream = client->Track(spec.session_id);
      if (!stream.ok()) return 0;
      std::thread sender([&stream] {
        for (std::uint64_t k = 0; k < 200; ++k) {
          (*stream)->Send(TinyFrame(k)).IgnoreError();
        }
        (*stream)->CloseSend();
      });
      int good = 0;
      for (;;) {
        const auto reply = (*stream)->Next();
        if (!reply.ok() || !reply->has_value()) break;
        const sdk::FrameResult* result = Result(reply);
        if (result != nullptr &&
            result->sequence == static_cast<std::uint64_t>(good) &&
            result->camera.num_inliers == 100 + i) {
          ++good;
        }
      }
      sender.join();
      return good;
    }));
  }
  for (auto& client : clients) EXPECT_EQ(client.get(), 200);
}

TEST(Sessions, LosslessHoldsTheSenderBackAndLosesNothing) {
  Gate gate;
  service::ServerOptions options;
  options.sessions.lossless_queue_frames = 3;
  TestServer server(options, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  sdk::TrackingStreamOptions stream_options;
  stream_options.max_in_flight = 64;
  auto stream = client->Track("s", stream_options);
  ASSERT_TRUE(stream.ok());
  for (std::uint64_t k = 0; k < 40; ++k) {
    ASSERT_TRUE((*stream)->Send(TinyFrame(k)).ok());
  }
  // One in work and three waiting are accepted; the others are held back.
  ASSERT_TRUE(
      Eventually([&] { return client->GetSession("s")->next_sequence == 4; }));
  absl::SleepFor(absl::Milliseconds(50));
  EXPECT_EQ(client->GetSession("s")->next_sequence, 4U);
  gate.OpenForGood();
  (*stream)->CloseSend();
  for (std::uint64_t k = 0; k < 40; ++k) {
    const auto reply = (*stream)->Next();
    const sdk::FrameResult* result = Result(reply);
    ASSERT_NE(result, nullptr) << k;
    EXPECT_EQ(result->sequence, k);
  }
  const auto end = (*stream)->Next();
  ASSERT_TRUE(end.ok()) << end.status();
  EXPECT_FALSE(end->has_value());
  EXPECT_EQ(client->GetSession("s")->frames_dropped, 0U);
}

TEST(Sessions, LiveDropsTheOldestAndAnswersSo) {
  Gate gate;
  service::ServerOptions options;
  options.sessions.live_queue_frames = 2;
  TestServer server(options, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s", sdk::FlowMode::kLive)).ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE((*stream)->Send(TinyFrame(0)).ok());
  ASSERT_TRUE(Eventually([&] { return gate.waiting() == 1; }));
  for (std::uint64_t k = 1; k < 10; ++k) {
    ASSERT_TRUE((*stream)->Send(TinyFrame(k)).ok());
  }
  ASSERT_TRUE(
      Eventually([&] { return client->GetSession("s")->next_sequence == 10; }));
  gate.OpenForGood();
  (*stream)->CloseSend();
  std::vector<std::uint64_t> processed;
  for (std::uint64_t k = 0; k < 10; ++k) {
    const auto reply = (*stream)->Next();
    ASSERT_TRUE(reply.ok() && reply->has_value()) << reply.status();
    EXPECT_EQ(sdk::SequenceOf(**reply), k) << "answers come in order";
    if (Result(reply) != nullptr) {
      processed.push_back(k);
    } else {
      const auto* dropped = std::get_if<sdk::FrameDropped>(&**reply);
      ASSERT_NE(dropped, nullptr);
      EXPECT_EQ(dropped->reason, sdk::FrameDropped::Reason::kOverload);
    }
  }
  EXPECT_THAT(processed, ElementsAre(0, 8, 9));
  EXPECT_EQ(client->GetSession("s")->frames_dropped, 7U);
}

TEST(Sessions, AKilledClientResumesAndItsFramesAreNotLost) {
  Gate gate;
  TestServer server({}, GatedCores(&gate));
  {
    const auto client = server.Connect();
    ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
    auto stream = client->Track("s");
    ASSERT_TRUE(stream.ok());
    for (std::uint64_t k = 0; k < 5; ++k) {
      ASSERT_TRUE((*stream)->Send(TinyFrame(k)).ok());
    }
    ASSERT_TRUE(Eventually(
        [&] { return client->GetSession("s")->next_sequence == 5; }));
    (*stream)->Cancel();  // as good as killed: the call is reset
  }
  const auto client = server.Connect();
  ASSERT_TRUE(Eventually([&] { return !client->GetSession("s")->streaming; }));
  gate.OpenForGood();
  ASSERT_TRUE(Eventually(
      [&] { return client->GetSession("s")->frames_processed == 5; }));
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  EXPECT_EQ((*stream)->next_sequence(), 5U);
  EXPECT_EQ((*stream)->Send(TinyFrame(4)).code(),
            absl::StatusCode::kInvalidArgument);
  ASSERT_TRUE((*stream)->Send(TinyFrame(5)).ok());
  const auto reply = (*stream)->Next();
  ASSERT_NE(Result(reply), nullptr);
  EXPECT_EQ(Result(reply)->sequence, 5U);
}

TEST(Sessions, ANewerStreamTakesOver) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  auto older = client->Track("s");
  ASSERT_TRUE(older.ok());
  ASSERT_TRUE((*older)->Send(TinyFrame(0)).ok());
  ASSERT_NE(Result((*older)->Next()), nullptr);
  auto newer = client->Track("s");
  ASSERT_TRUE(newer.ok());
  const auto end = (*older)->Next();
  EXPECT_EQ(end.status().code(), absl::StatusCode::kAborted);
  EXPECT_THAT(std::string(end.status().message()), HasSubstr("took over"));
  ASSERT_TRUE((*newer)->Send(TinyFrame(1)).ok());
  EXPECT_NE(Result((*newer)->Next()), nullptr);
}

// The protocol below the SDK: a stream of its own.
class RawStream {
 public:
  explicit RawStream(const std::string& address)
      : stub_(v1::TrackingService::NewStub(
            grpc::CreateChannel(address, grpc::InsecureChannelCredentials()))),
        call_(stub_->Track(&context_)) {}
  ~RawStream() {
    context_.TryCancel();
    if (!finished_) call_->Finish();
  }
  bool Attach(const std::string& id, std::optional<std::uint64_t> from) {
    v1::TrackRequest request;
    request.mutable_attach()->set_session_id(id);
    if (from.has_value()) request.mutable_attach()->set_resume_from(*from);
    v1::TrackResponse response;
    if (!call_->Write(request) || !call_->Read(&response)) return false;
    next_sequence_ = response.attached().next_sequence();
    return response.has_attached();
  }
  bool Send(std::uint64_t sequence) {
    v1::TrackRequest request;
    request.mutable_frame()->set_sequence(sequence);
    request.mutable_frame()->set_capture_time_ns(
        static_cast<std::int64_t>(sequence));
    v1::Image* image = request.mutable_frame()->mutable_image();
    image->set_encoding(v1::IMAGE_ENCODING_RAW_GRAY8);
    image->set_data("0123");
    image->set_width_px(2);
    image->set_height_px(2);
    return call_->Write(request);
  }
  std::optional<v1::TrackResponse> Read() {
    v1::TrackResponse response;
    if (!call_->Read(&response)) return std::nullopt;
    return response;
  }
  grpc::Status Finish() {
    finished_ = true;
    return call_->Finish();
  }
  grpc::ClientReaderWriter<v1::TrackRequest, v1::TrackResponse>& call() {
    return *call_;
  }
  std::uint64_t next_sequence() const { return next_sequence_; }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<v1::TrackingService::Stub> stub_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::TrackRequest, v1::TrackResponse>>
      call_;
  bool finished_ = false;
  std::uint64_t next_sequence_ = 0;
};

TEST(Sessions, AnswersThatWereLostOnTheWayAreSentAgain) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  {
    RawStream broken(server.address());
    ASSERT_TRUE(broken.Attach("s", std::nullopt));
    for (std::uint64_t k = 0; k < 6; ++k) ASSERT_TRUE(broken.Send(k));
    ASSERT_TRUE(broken.Read().has_value());  // the answer to frame 0
    ASSERT_TRUE(Eventually(
        [&] { return client->GetSession("s")->frames_processed == 6; }));
  }
  RawStream resumed(server.address());
  ASSERT_TRUE(resumed.Attach("s", 1));
  EXPECT_EQ(resumed.next_sequence(), 6U);
  for (std::uint64_t k = 1; k < 6; ++k) {
    const auto response = resumed.Read();
    ASSERT_TRUE(response.has_value());
    EXPECT_EQ(response->result().sequence(), k);
  }
}

TEST(Sessions, ASequenceThatGoesBackwardsIsRefusedAndTheStreamLivesOn) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  ASSERT_TRUE(server.Connect()->CreateSession(Spec("s")).ok());
  RawStream stream(server.address());
  ASSERT_TRUE(stream.Attach("s", std::nullopt));
  ASSERT_TRUE(stream.Send(7));
  ASSERT_EQ(stream.Read()->result().sequence(), 7U);
  ASSERT_TRUE(stream.Send(7));
  const auto refused = stream.Read();
  ASSERT_TRUE(refused.has_value() && refused->has_error());
  EXPECT_EQ(refused->error().sequence(), 7U);
  EXPECT_EQ(refused->error().code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(refused->error().message(), HasSubstr("not above 7"));
  ASSERT_TRUE(stream.Send(8));
  EXPECT_EQ(stream.Read()->result().sequence(), 8U);
}

TEST(Sessions, ProtocolErrorsEndTheStreamAndNameTheReason) {
  TestServer server;
  ASSERT_TRUE(server.Connect()->CreateSession(Spec("s")).ok());
  {
    RawStream stream(server.address());
    EXPECT_TRUE(stream.Send(1));
    EXPECT_FALSE(stream.Read().has_value());
    EXPECT_THAT(stream.Finish().error_message(), HasSubstr("attach"));
  }
  EXPECT_EQ(server.Connect()->Track("nobody").status().code(),
            absl::StatusCode::kNotFound);
  {
    RawStream stream(server.address());
    EXPECT_FALSE(stream.Attach("nobody", std::nullopt));
    EXPECT_EQ(stream.Finish().error_code(), grpc::StatusCode::NOT_FOUND);
  }
  RawStream stream(server.address());
  ASSERT_TRUE(stream.Attach("s", std::nullopt));
  v1::TrackRequest empty;
  ASSERT_TRUE(stream.call().Write(empty));
  EXPECT_FALSE(stream.Read().has_value());
  EXPECT_EQ(stream.Finish().error_code(), grpc::StatusCode::INVALID_ARGUMENT);
}

TEST(Sessions, ASlowWatcherGetsFewerResultsAndDelaysNobody) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  EXPECT_EQ(client->Watch("nobody", false).status().code(),
            absl::StatusCode::kNotFound);
  auto watcher = client->Watch("s", /*include_images=*/true);
  ASSERT_TRUE(watcher.ok()) << watcher.status();
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  for (std::uint64_t k = 0; k < 100; ++k) {
    ASSERT_TRUE((*stream)->Send(SquareFrame(k, 10, 10)).ok());
    ASSERT_NE(Result((*stream)->Next()), nullptr);
  }
  ASSERT_TRUE(client->DeleteSession("s").ok());
  // Everything is accounted for up to the last one seen; the session's end may
  // take the last two that waited with it.
  std::uint64_t seen = 0;
  std::uint64_t skipped = 0;
  std::uint64_t last = 0;
  for (;;) {
    const auto update = (*watcher)->Next();
    ASSERT_TRUE(update.ok()) << update.status();
    if (!update->has_value()) break;
    ++seen;
    skipped += (*update)->skipped;
    last = (*update)->result.sequence;
    ASSERT_TRUE((*update)->image.has_value());
    EXPECT_EQ((*update)->image->encoding, sdk::ImageEncoding::kPng);
  }
  EXPECT_GT(seen, 0U);
  EXPECT_EQ(seen + skipped, last + 1);
  EXPECT_EQ((*stream)->Next().status().code(), absl::StatusCode::kNotFound);
}

// Raw frames come as wide as they are shown, and never narrower than that.
TEST(Sessions, AWatcherSaysHowWideItShowsImages) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  auto wide = client->Watch("s", /*include_images=*/true);
  auto narrow = client->Watch("s", /*include_images=*/true, 30);
  ASSERT_TRUE(wide.ok() && narrow.ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  sdk::Frame frame = TinyFrame(0);
  frame.image = {
      sdk::ImageEncoding::kRawGray8, std::string(96 * 64, 'x'), 96, 64};
  ASSERT_TRUE((*stream)->Send(frame).ok());
  const auto width_px = [](sdk::SessionWatcher& watcher) {
    const auto update = watcher.Next();
    if (!update.ok() || !*update || !(*update)->image) return 0U;
    const auto header = base::ReadImageHeader((*update)->image->bytes);
    return header ? header->width_px : 0U;
  };
  EXPECT_EQ(width_px(**wide), 96U);
  EXPECT_EQ(width_px(**narrow), 32U);
}

TEST(Sessions, IdleOnesExpireAndStreamingOnesDoNot) {
  service::ServerOptions options;
  options.sessions.idle_timeout = std::chrono::seconds(3);
  TestServer server(options);
  const auto client = server.Connect();
  // On a busy machine it may expire before a stream is attached to it.
  absl::StatusOr<std::unique_ptr<sdk::TrackingStream>> stream;
  std::uint64_t expired = 0;
  ASSERT_TRUE(Eventually([&] {
    EXPECT_TRUE(client->CreateSession(Spec("busy")).ok());
    stream = client->Track("busy");
    if (!stream.ok()) ++expired;
    return stream.ok();
  })) << stream.status();
  ASSERT_TRUE(client->CreateSession(Spec("idle")).ok());
  ASSERT_TRUE(Eventually(
      [&] { return absl::IsNotFound(client->GetSession("idle").status()); }));
  EXPECT_TRUE(client->GetSession("busy").ok());
  EXPECT_EQ(server.metrics().sessions_expired.load(), expired + 1);
}

TEST(Sessions, LimitsHold) {
  service::ServerOptions options;
  options.sessions.max_sessions = 2;
  options.sessions.max_targets = 1;
  options.sessions.max_watchers = 1;
  TestServer server(options);
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("a")).ok());
  EXPECT_EQ(client->CreateSession(Spec("a")).status().code(),
            absl::StatusCode::kAlreadyExists);
  ASSERT_TRUE(client->CreateSession(Spec("b")).ok());
  EXPECT_EQ(client->CreateSession(Spec("c")).status().code(),
            absl::StatusCode::kResourceExhausted);
  const auto box = geometry::Box2::FromXywh(1, 1, 20, 20);
  ASSERT_TRUE(client->SetTarget("a", "one", box).ok());
  EXPECT_EQ(client->SetTarget("a", "two", box).status().code(),
            absl::StatusCode::kResourceExhausted);
  auto watcher = client->Watch("a", false);
  ASSERT_TRUE(watcher.ok());
  auto second = client->Watch("a", false);
  EXPECT_EQ(
      second.ok() ? (*second)->Next().status().code() : second.status().code(),
      absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(client->ListSessions()->size(), 2U);
  ASSERT_TRUE(client->DeleteSession("b").ok());
  EXPECT_TRUE(client->CreateSession(Spec("c")).ok());
}

TEST(Sessions, StoppingAnswersWhatWaitsAndEndsTheStream) {
  Gate gate;
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  RawStream stream(server.address());
  ASSERT_TRUE(stream.Attach("s", std::nullopt));
  for (std::uint64_t k = 0; k < 4; ++k) ASSERT_TRUE(stream.Send(k));
  ASSERT_TRUE(Eventually([&] {
    return client->GetSession("s")->next_sequence == 4 && gate.waiting() == 1;
  }));
  std::thread stopping([&server] { server.Stop(std::chrono::minutes(4)); });
  // The frame in work may finish; the others are answered as dropped. What
  // waits is given up before calls are refused.
  ASSERT_TRUE(Eventually([&] { return !client->GetSession("s").ok(); }));
  gate.OpenForGood();
  const auto first = stream.Read();
  ASSERT_TRUE(first.has_value());
  EXPECT_EQ(first->result().sequence(), 0U);
  for (std::uint64_t k = 1; k < 4; ++k) {
    const auto response = stream.Read();
    ASSERT_TRUE(response.has_value());
    EXPECT_EQ(response->dropped().sequence(), k);
    EXPECT_EQ(response->dropped().reason(), v1::FrameDropped::REASON_SHUTDOWN);
  }
  EXPECT_FALSE(stream.Read().has_value());
  EXPECT_EQ(stream.Finish().error_code(), grpc::StatusCode::UNAVAILABLE);
  stopping.join();
}

TEST(Sessions, AStreamGivesUpOnAServerThatForgotItsSession) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  server.Restart();
  const absl::Status end = (*stream)->Next().status();
  EXPECT_EQ(end.code(), absl::StatusCode::kNotFound) << end;
}

}  // namespace
}  // namespace groundlock::test
