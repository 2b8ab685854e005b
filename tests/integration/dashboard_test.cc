// SPDX-License-Identifier: Apache-2.0
// The dashboard's proxy between a real server and pages without a browser: who
// sees what, what slow, rude and strange pages get, and what survives the
// server's restart.
#include "client/dashboard/proxy/dashboard.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <random>
#include <string>
#include <thread>

#include "client/dashboard/recording/session_recording.h"
#include "map_store/base/file.h"
#include "tests/integration/browser.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

using boost::beast::http::verb;
using ::testing::HasSubstr;
using ::testing::StartsWith;

namespace fs = std::filesystem;

class DashboardTest : public ::testing::Test {
 protected:
  void Start(TestServer& server) {
    options_.listen = "127.0.0.1:0";
    options_.server = server.address();
    options_.web = directory_.path() / "web";
    options_.recordings = directory_.path() / "recordings";
    options_.uploads = directory_.path() / "uploads";
    options_.poll_interval = std::chrono::milliseconds(50);
    auto dashboard = dashboard::Dashboard::Start(options_);
    ASSERT_TRUE(dashboard.ok()) << dashboard.status();
    dashboard_ = *std::move(dashboard);
    // It serves once it knows whether the server wants a token.
    ASSERT_TRUE(Eventually([&] {
      return Fetch(port(), verb::get, "/api/info")
                 .body()
                 .find("\"login_required\":null") == std::string::npos;
    }));
  }
  int port() const { return dashboard_->port(); }
  void WriteWeb(const std::string& name, const std::string& text) {
    const fs::path path = directory_.path() / "web" / name;
    fs::create_directories(path.parent_path());
    std::ofstream(path) << text;
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  dashboard::DashboardOptions options_;
  std::unique_ptr<dashboard::Dashboard> dashboard_;
};

pb::ClientMessage Subscribe(const std::string& session, bool images = true) {
  pb::ClientMessage message;
  message.mutable_subscribe()->set_session_id(session);
  message.mutable_subscribe()->set_include_images(images);
  return message;
}

bool IsLive(const pb::ServerMessage& message) {
  return message.subscription_state().state() ==
         pb::SubscriptionState::STATE_LIVE;
}

// A page that watches the session and knows it.
std::unique_ptr<Page> Watching(int port, const std::string& session) {
  auto page = std::make_unique<Page>(port);
  EXPECT_EQ(page->status(), 101);
  EXPECT_TRUE(page->Ask(Subscribe(session)).has_subscribed());
  EXPECT_TRUE(page->ReadUntil(IsLive).has_value());
  return page;
}

TEST_F(DashboardTest, ServesThePageWithItsHeaders) {
  TestServer server;
  WriteWeb("index.html", "<h1>page</h1>");
  WriteWeb("assets/app.js", "let a = 1;");
  WriteWeb("assets/app.js.gz", "compressed");
  WriteWeb(".secret", "secret");
  Start(server);
  EXPECT_EQ(Fetch(port(), verb::get, "/healthz").body(), "ok\n");
  const HttpResponse page = Fetch(port(), verb::get, "/");
  EXPECT_EQ(page.result_int(), 200U);
  EXPECT_EQ(page.body(), "<h1>page</h1>");
  EXPECT_EQ(page["X-Content-Type-Options"], "nosniff");
  EXPECT_EQ(page["Cache-Control"], "no-cache");
  EXPECT_THAT(std::string(page["Content-Security-Policy"]),
              StartsWith("default-src 'self';"));
  const std::string etag(page["ETag"]);
  ASSERT_FALSE(etag.empty());
  const HttpResponse again =
      Fetch(port(), verb::get, "/index.html", {{"If-None-Match", etag}});
  EXPECT_EQ(again.result_int(), 304U);
  EXPECT_EQ(again.body(), "");
  const HttpResponse script = Fetch(
      port(), verb::get, "/assets/app.js", {{"Accept-Encoding", "gzip, br"}});
  EXPECT_EQ(script.body(), "compressed");
  EXPECT_EQ(script["Content-Encoding"], "gzip");
  EXPECT_THAT(std::string(script["Cache-Control"]), HasSubstr("immutable"));
  EXPECT_EQ(Fetch(port(), verb::get, "/assets/app.js").body(), "let a = 1;");
  const HttpResponse head = Fetch(port(), verb::head, "/");
  EXPECT_EQ(head["Content-Length"], "13");
  EXPECT_EQ(head.body(), "");
  for (const char* target : {"/.secret", "/nothing", "/assets", "/assets/"}) {
    EXPECT_EQ(Fetch(port(), verb::get, target).result_int(), 404U) << target;
  }
  EXPECT_EQ(Fetch(port(), verb::get, "/%2e%2e/recordings").result_int(), 400U);
  EXPECT_EQ(Fetch(port(), verb::post, "/").result_int(), 405U);
  EXPECT_EQ(Fetch(port(), verb::get, "/api/nothing").result_int(), 404U);
  EXPECT_EQ(
      Fetch(port(), verb::get, "/", {{"Host", "evil.example"}}).result_int(),
      421U);
}

TEST_F(DashboardTest, SaysSoIfThePageWasNotBuilt) {
  TestServer server;
  Start(server);
  const HttpResponse page = Fetch(port(), verb::get, "/");
  EXPECT_EQ(page.result_int(), 404U);
  EXPECT_THAT(page.body(), HasSubstr("groundlock_web"));
}

TEST_F(DashboardTest, APageFollowsASessionAndALateOneGetsItsHistory) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("drive")).ok());
  Start(server);
  const auto page = Watching(port(), "drive");
  auto stream = client->Track("drive");
  ASSERT_TRUE(stream.ok());
  for (std::uint64_t k = 0; k < 10; ++k) {
    ASSERT_TRUE((*stream)->Send(SquareFrame(k, 10, 10)).ok());
    ASSERT_TRUE((*stream)->Next().ok());
    const auto update = page->ReadUntil([](const pb::ServerMessage& message) {
      // No image comes before its result.
      EXPECT_FALSE(message.has_frame_image());
      return message.has_frame_update();
    });
    ASSERT_TRUE(update.has_value());
    EXPECT_EQ(update->frame_update().session_id(), "drive");
    EXPECT_EQ(update->frame_update().result().sequence(), k);
    EXPECT_TRUE(update->frame_update().has_image());
    EXPECT_GT(update->frame_update().received_time_ns(), 0);
    const auto image = page->ReadUntil(
        [](const pb::ServerMessage& m) { return m.has_frame_image(); });
    ASSERT_TRUE(image.has_value());
    EXPECT_EQ(image->frame_image().sequence(), k);
    EXPECT_EQ(image->frame_image().image().data(), SquareImage(10, 10).bytes);
  }
  Page late(port());
  ASSERT_TRUE(late.Ask(Subscribe("drive", false)).has_subscribed());
  const auto history = late.ReadUntil(
      [](const pb::ServerMessage& m) { return m.has_history(); });
  ASSERT_TRUE(history.has_value());
  EXPECT_EQ(history->history().results_size(), 10);
  EXPECT_TRUE(history->history().last());
  // One watch at the server, however many look on.
  EXPECT_EQ(server.metrics().watchers.load(), 1);

  const HttpResponse csv =
      Fetch(port(), verb::get, "/api/sessions/drive/trajectory?format=csv");
  EXPECT_EQ(csv.result_int(), 200U);
  EXPECT_EQ(std::count(csv.body().begin(), csv.body().end(), '\n'), 11);
  EXPECT_EQ(
      Fetch(port(), verb::get, "/api/sessions/drive/trajectory?format=kml")
          .result_int(),
      409U);

  ASSERT_TRUE(client->DeleteSession("drive").ok());
  const auto ended = page->ReadUntil([](const pb::ServerMessage& message) {
    return message.subscription_state().state() ==
           pb::SubscriptionState::STATE_ENDED;
  });
  EXPECT_TRUE(ended.has_value());
}

// An image that no compression makes small.
sdk::Frame NoiseFrame(std::uint64_t sequence) {
  cv::Mat image(300, 300, CV_8UC3);
  std::minstd_rand engine(static_cast<unsigned>(sequence + 1));
  for (int i = 0; i < 3 * 300 * 300; ++i) {
    image.data[i] = static_cast<unsigned char>(engine() >> 8);
  }
  std::vector<std::uint8_t> png;
  cv::imencode(".png", image, png);
  sdk::Frame frame;
  frame.sequence = sequence;
  frame.capture_time = std::chrono::milliseconds(40) * sequence;
  frame.image.encoding = sdk::ImageEncoding::kPng;
  frame.image.bytes.assign(png.begin(), png.end());
  return frame;
}

TEST_F(DashboardTest, AViewerThatStallsDelaysNobodyAndIsSentAway) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  sdk::SessionSpec spec = Spec("drive");
  spec.camera = TestCamera(300, 300);
  ASSERT_TRUE(client->CreateSession(spec).ok());
  options_.viewers.stall_timeout = std::chrono::milliseconds(1'000);
  Start(server);
  Page stalled(port(), {}, /*receive_buffer_bytes=*/4'096);
  ASSERT_TRUE(stalled.Ask(Subscribe("drive")).has_subscribed());
  const auto page = Watching(port(), "drive");
  ASSERT_EQ(dashboard_->num_viewers(), 2);
  auto stream = client->Track("drive");
  ASSERT_TRUE(stream.ok());
  // 270 kB each: the one that does not read has its buffers full soon.
  for (std::uint64_t k = 0; k < 60; ++k) {
    ASSERT_TRUE((*stream)->Send(NoiseFrame(k)).ok());
    ASSERT_TRUE((*stream)->Next().ok());
    const auto image = page->ReadUntil([k](const pb::ServerMessage& message) {
      return message.has_frame_image() && message.frame_image().sequence() == k;
    });
    ASSERT_TRUE(image.has_value()) << "the other viewer gets every frame";
  }
  EXPECT_TRUE(Eventually([&] { return dashboard_->num_viewers() == 1; }));
  // It finds its connection closed, after what was on the way.
  while (stalled.Read().has_value()) {
  }
  ASSERT_TRUE((*stream)->Send(NoiseFrame(60)).ok());
  EXPECT_TRUE(page->ReadUntil([](const pb::ServerMessage& message) {
                    return message.frame_image().sequence() == 60;
                  })
                  .has_value());
}

TEST_F(DashboardTest, PagesSurviveTheRestartOfTheServer) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  ASSERT_TRUE(server.Connect()->CreateSession(Spec("drive")).ok());
  Start(server);
  const auto page = Watching(port(), "drive");
  server.Stop(std::chrono::milliseconds(0));
  EXPECT_TRUE(page->ReadUntil([](const pb::ServerMessage& message) {
                    return message.server_state().state() ==
                           pb::ServerState::STATE_UNREACHABLE;
                  })
                  .has_value());
  server.Restart();
  EXPECT_TRUE(page->ReadUntil([](const pb::ServerMessage& message) {
                    return message.server_state().state() ==
                           pb::ServerState::STATE_CONNECTED;
                  })
                  .has_value());
  // A session of the same name, as a restored or a new one is.
  const auto client = server.Connect();
  const absl::Status created = client->CreateSession(Spec("drive")).status();
  ASSERT_TRUE(created.ok() || absl::IsAlreadyExists(created)) << created;
  auto stream = client->Track("drive");
  ASSERT_TRUE(stream.ok());
  Page again(port());
  ASSERT_TRUE(again.Ask(Subscribe("drive")).has_subscribed());
  ASSERT_TRUE(again.ReadUntil(IsLive).has_value());
  ASSERT_TRUE((*stream)->Send(SquareFrame(5, 10, 10)).ok());
  const auto update = again.ReadUntil([](const pb::ServerMessage& message) {
    return message.has_frame_update();
  });
  ASSERT_TRUE(update.has_value());
  EXPECT_EQ(update->frame_update().result().sequence(), 5U);
}

TEST_F(DashboardTest, StrangePagesGetNoFurther) {
  TestServer server;
  options_.allowed_origins = {"https://dash.example.org"};
  options_.viewers.max_message_bytes = 4'096;
  options_.viewers.max_requests_per_s = 5;
  Start(server);
  EXPECT_EQ(Page(port(), {{"Origin", "http://evil.example"}}).status(), 403);
  EXPECT_EQ(Page(port(), {{"Host", "evil.example"}}).status(), 421);
  EXPECT_EQ(Page(port(), {{"Origin", "https://dash.example.org"}}).status(),
            101);
  EXPECT_EQ(
      Page(port(), {{"Origin", "http://127.0.0.1:" + std::to_string(port())}})
          .status(),
      101);
  EXPECT_EQ(Fetch(port(),
                  verb::post,
                  "/api/uploads",
                  {{"Origin", "http://evil.example"}},
                  R"({"kind":"video","name":"x"})")
                .result_int(),
            403U);
  {
    Page page(port());
    page.SendBytes("\xFF\xFF\xFF");
    const auto error = page.ReadUntil(
        [](const pb::ServerMessage& m) { return m.has_error(); });
    ASSERT_TRUE(error.has_value()) << "the connection lives on";
    EXPECT_EQ(error->error().code(), 3);  // INVALID_ARGUMENT
    pb::ClientMessage ping;
    ping.mutable_ping()->set_client_time_ms(12.5);
    EXPECT_EQ(page.Ask(ping).pong().client_time_ms(), 12.5);
    EXPECT_EQ(page.Ask(Subscribe("nobody")).error().code(), 5);  // NOT_FOUND
  }
  {
    Page page(port());
    page.SendBytes("text", /*binary=*/false);
    EXPECT_FALSE(page.ReadUntil([](const auto&) { return false; }).has_value());
  }
  {
    Page page(port());
    page.SendBytes(std::string(5'000, 'x'));
    EXPECT_FALSE(page.ReadUntil([](const auto&) { return false; }).has_value());
    EXPECT_EQ(page.close_code(), 1009);  // too big
  }
  Page page(port());
  pb::ClientMessage ping;
  ping.mutable_ping();
  for (int i = 0; i < 30; ++i) page.Send(ping);
  const auto refused = page.ReadUntil(
      [](const pb::ServerMessage& message) { return message.has_error(); });
  ASSERT_TRUE(refused.has_value());
  EXPECT_EQ(refused->error().code(), 8);  // RESOURCE_EXHAUSTED
  EXPECT_GT(refused->request_id(), 0U);
}

TEST_F(DashboardTest, TooManyViewersAndSubscriptionsAreRefused) {
  TestServer server;
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("a")).ok());
  ASSERT_TRUE(client->CreateSession(Spec("b")).ok());
  options_.viewers.max_viewers = 1;
  options_.viewers.max_subscriptions = 1;
  Start(server);
  Page page(port());
  EXPECT_TRUE(page.Read()->has_hello());
  EXPECT_TRUE(page.Ask(Subscribe("a")).has_subscribed());
  EXPECT_TRUE(page.Ask(Subscribe("a", false)).has_subscribed()) << "anew";
  EXPECT_EQ(page.Ask(Subscribe("b")).error().code(), 8);
  Page second(port());
  EXPECT_FALSE(second.Read().has_value());
  EXPECT_EQ(second.close_code(), 1013);  // try again later
  pb::ClientMessage leave;
  leave.mutable_unsubscribe()->set_session_id("a");
  EXPECT_TRUE(page.Ask(leave).has_done());
  EXPECT_TRUE(page.Ask(Subscribe("b")).has_subscribed());
}

TEST_F(DashboardTest, TokensArePassedOnAndNothingIsShownWithoutOne) {
  service::ServerOptions server_options;
  server_options.tokens = {"0123456789abcdef"};
  TestServer server(server_options);
  Start(server);
  EXPECT_THAT(Fetch(port(), verb::get, "/api/info").body(),
              HasSubstr("\"login_required\":true"));
  EXPECT_EQ(Page(port()).status(), 401);
  EXPECT_EQ(Fetch(port(), verb::get, "/api/recordings/x.mcap").result_int(),
            401U);
  EXPECT_EQ(Fetch(port(), verb::post, "/api/uploads", {}, "{}").result_int(),
            401U);
  const auto login = [&](const std::string& token) {
    return Fetch(
        port(), verb::post, "/api/login", {}, R"({"token":")" + token + "\"}");
  };
  EXPECT_EQ(login("wrong-token-0123").result_int(), 401U);
  EXPECT_EQ(login("").result_int(), 401U);
  EXPECT_EQ(Fetch(port(), verb::post, "/api/login", {}, "{").result_int(),
            400U);
  const HttpResponse welcome = login("0123456789abcdef");
  ASSERT_EQ(welcome.result_int(), 204U);
  const std::string set_cookie(welcome["Set-Cookie"]);
  EXPECT_THAT(set_cookie, HasSubstr("HttpOnly"));
  EXPECT_THAT(set_cookie, HasSubstr("SameSite=Strict"));
  EXPECT_EQ(set_cookie.find("0123456789abcdef"), std::string::npos);
  const Headers headers = {
      {"Cookie", set_cookie.substr(0, set_cookie.find(';'))}};
  Page page(port(), headers);
  ASSERT_EQ(page.status(), 101);
  EXPECT_TRUE(page.ReadUntil([](const pb::ServerMessage& message) {
                    return message.has_sessions();
                  })
                  .has_value());
  EXPECT_EQ(page.Ask(Subscribe("nobody")).error().code(), 5)
      << "the server has let it through";
  EXPECT_EQ(Fetch(port(), verb::post, "/api/logout", headers).result_int(),
            204U);
  EXPECT_EQ(Page(port(), headers).status(), 401);
}

TEST_F(DashboardTest, UploadsAreBounded) {
  TestServer server;
  options_.uploads_limits.max_video_bytes = 100'000;
  Start(server);
  const auto create = [&] {
    const HttpResponse created = Fetch(port(),
                                       verb::post,
                                       "/api/uploads",
                                       {},
                                       R"({"kind":"video","name":"walk"})");
    EXPECT_EQ(created.result_int(), 201U);
    const std::string& body = created.body();
    return body.substr(body.find(':') + 2, 32);
  };
  const std::string path = "/api/uploads/" + create() + "/";
  const auto put = [&](const std::string& name, const std::string& bytes) {
    return Fetch(port(), verb::put, path + name, {}, bytes).result_int();
  };
  EXPECT_EQ(put("a.mp4", std::string(60'000, 'a')), 201U);
  EXPECT_EQ(put("a.mp4", "x"), 409U);
  EXPECT_EQ(put("b.mp4", std::string(60'000, 'b')), 413U);
  EXPECT_EQ(put("c.mp4", std::string(5'000'000, 'c')), 413U);
  EXPECT_EQ(put(".hidden", "x"), 400U);
  EXPECT_EQ(put("%2e%2e/x", "x"), 400U);
  EXPECT_EQ(
      Fetch(port(), verb::put, "/api/uploads/nobody/x", {}, "x").result_int(),
      404U);
  EXPECT_EQ(
      Fetch(port(), verb::post, "/api/uploads", {}, std::string(100'000, ' '))
          .result_int(),
      413U);
  EXPECT_EQ(Fetch(port(), verb::delete_, path.substr(0, path.size() - 1))
                .result_int(),
            204U);
  EXPECT_TRUE(fs::is_empty(options_.uploads));
}

TEST_F(DashboardTest, AnUploadedVideoBecomesASessionWhoseTargetIsFollowed) {
  TestServer server;
  Start(server);
  // A square that moves to the right.
  const fs::path file = directory_.path() / "square.avi";
  cv::VideoWriter writer(file.string(),
                         cv::VideoWriter::fourcc('M', 'J', 'P', 'G'),
                         25.0,
                         {kWidth, kHeight});
  for (int i = 0; i < 25; ++i) {
    const std::string bytes = SquareImage(20 + 2 * i, 40).bytes;
    writer.write(
        cv::imdecode(std::vector<std::uint8_t>(bytes.begin(), bytes.end()),
                     cv::IMREAD_COLOR));
  }
  writer.release();
  const std::string body = Fetch(port(),
                                 verb::post,
                                 "/api/uploads",
                                 {},
                                 R"({"kind":"video","name":"square"})")
                               .body();
  const std::string id = body.substr(body.find(':') + 2, 32);
  ASSERT_EQ(Fetch(port(),
                  verb::put,
                  "/api/uploads/" + id + "/square.avi",
                  {},
                  *base::ReadFile(file, 1 << 24))
                .result_int(),
            201U);

  Page page(port());
  ASSERT_TRUE(page.ReadUntil([](const pb::ServerMessage& message) {
                    return message.sources().sources_size() == 1;
                  })
                  .has_value());
  pb::ClientMessage start;
  start.mutable_start_session()->set_source_id("upload:" + id);
  v1::CreateSessionRequest* session =
      start.mutable_start_session()->mutable_session();
  session->set_session_id("square");
  EXPECT_THAT(page.Ask(start).error().message(), HasSubstr("camera"));
  session->mutable_camera()->set_model(v1::CAMERA_MODEL_ID_SIMPLE_PINHOLE);
  session->mutable_camera()->set_width_px(kWidth);
  session->mutable_camera()->set_height_px(kHeight);
  for (const double param : {150.0, 80.0, 60.0}) {
    session->mutable_camera()->add_params(param);
  }
  start.mutable_start_session()->set_paused(true);
  v1::Box2* box = start.mutable_start_session()->mutable_target_box();
  box->set_x(20);
  box->set_y(40);
  box->set_width(24);
  box->set_height(24);
  start.mutable_start_session()->set_target_id("square");
  const pb::ServerMessage started = page.Ask(start);
  ASSERT_TRUE(started.has_session_started()) << started.error().message();
  ASSERT_TRUE(page.Ask(Subscribe("square")).has_subscribed());
  ASSERT_TRUE(page.ReadUntil(IsLive).has_value());
  pb::ClientMessage play;
  play.mutable_control_source()->set_session_id("square");
  play.mutable_control_source()->set_action(pb::ControlSource::ACTION_PLAY);
  EXPECT_TRUE(page.Ask(play).has_done());
  const auto last = page.ReadUntil([](const pb::ServerMessage& message) {
    return message.has_frame_update() &&
           message.frame_update().result().sequence() == 24;
  });
  ASSERT_TRUE(last.has_value());
  ASSERT_EQ(last->frame_update().result().targets_size(), 1);
  const v1::TargetResult& target = last->frame_update().result().targets(0);
  EXPECT_EQ(target.target_id(), "square");
  EXPECT_EQ(target.state(), v1::TARGET_STATE_TRACKED);
  EXPECT_NEAR(target.box().x(), 20.0 + 2.0 * 24.0, 6.0);
  const auto ended = page.ReadUntil([](const pb::ServerMessage& message) {
    return message.sessions().sessions_size() == 1 &&
           message.sessions().sessions(0).source_run().state() ==
               pb::SourceRun::STATE_ENDED;
  });
  ASSERT_TRUE(ended.has_value());
  EXPECT_EQ(ended->sessions().sessions(0).source_run().frames_sent(), 25U);
}

TEST_F(DashboardTest, ARecordingIsMadeServedInPartsAndRead) {
  Gate gate;
  gate.OpenForGood();
  TestServer server({}, GatedCores(&gate));
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("drive")).ok());
  Start(server);
  const auto page = Watching(port(), "drive");
  pb::ClientMessage record;
  record.mutable_start_recording()->set_session_id("drive");
  record.mutable_start_recording()->set_name("first");
  const pb::ServerMessage begun = page->Ask(record);
  ASSERT_TRUE(begun.has_recording()) << begun.error().message();
  EXPECT_EQ(begun.recording().state(), pb::RecordingInfo::STATE_RECORDING);
  EXPECT_EQ(page->Ask(record).error().code(), 6);  // ALREADY_EXISTS
  auto stream = client->Track("drive");
  ASSERT_TRUE(stream.ok());
  for (std::uint64_t k = 0; k < 20; ++k) {
    ASSERT_TRUE((*stream)->Send(SquareFrame(k, 10, 10)).ok());
    ASSERT_TRUE((*stream)->Next().ok());
    ASSERT_TRUE(page->ReadUntil([k](const pb::ServerMessage& message) {
                      return message.has_frame_update() &&
                             message.frame_update().result().sequence() == k;
                    })
                    .has_value());
  }
  pb::ClientMessage stop;
  stop.mutable_stop_recording()->set_session_id("drive");
  const pb::ServerMessage stopped = page->Ask(stop);
  ASSERT_TRUE(stopped.has_recording()) << stopped.error().message();
  EXPECT_EQ(stopped.recording().state(), pb::RecordingInfo::STATE_COMPLETE);
  EXPECT_EQ(stopped.recording().frames(), 20U);

  const HttpResponse whole =
      Fetch(port(), verb::get, "/api/recordings/first.mcap");
  ASSERT_EQ(whole.result_int(), 200U);
  EXPECT_EQ(whole.body().size(), stopped.recording().size_bytes());
  const HttpResponse part = Fetch(port(),
                                  verb::get,
                                  "/api/recordings/first.mcap",
                                  {{"Range", "bytes=100-299"}});
  ASSERT_EQ(part.result_int(), 206U);
  EXPECT_EQ(part.body(), whole.body().substr(100, 200));
  EXPECT_EQ(part["Content-Range"],
            "bytes 100-299/" + std::to_string(whole.body().size()));
  EXPECT_EQ(Fetch(port(),
                  verb::get,
                  "/api/recordings/first.mcap",
                  {{"Range", "bytes=99999999-"}})
                .result_int(),
            416U);
  const fs::path copy = directory_.path() / "copy.mcap";
  std::ofstream(copy, std::ios::binary) << whole.body();
  const auto description = recording::DescribeRecording(copy);
  ASSERT_TRUE(description.ok()) << description.status();
  EXPECT_EQ(description->frames, 20U);
  EXPECT_EQ(description->session.session_id(), "drive");
  const HttpResponse csv =
      Fetch(port(), verb::get, "/api/recordings/first/trajectory?format=csv");
  EXPECT_EQ(std::count(csv.body().begin(), csv.body().end(), '\n'), 21);

  pb::ClientMessage remove;
  remove.mutable_delete_recording()->set_name("first");
  EXPECT_TRUE(page->Ask(remove).has_done());
  EXPECT_EQ(Fetch(port(), verb::get, "/api/recordings/first.mcap").result_int(),
            404U);
}

TEST_F(DashboardTest, TargetsAreSetMovedAndDroppedThroughIt) {
  TestServer server;
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("drive")).ok());
  Start(server);
  const auto page = Watching(port(), "drive");
  pb::ClientMessage set;
  set.mutable_set_target()->set_session_id("drive");
  set.mutable_set_target()->set_target_id("square");
  v1::Box2* box = set.mutable_set_target()->mutable_box();
  box->set_x(30);
  box->set_y(40);
  box->set_width(24);
  box->set_height(24);
  EXPECT_EQ(page->Ask(set).target_set().target_id(), "square");
  auto stream = client->Track("drive");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 30, 40)).ok());
  const auto update = page->ReadUntil([](const pb::ServerMessage& message) {
    return message.has_frame_update();
  });
  ASSERT_TRUE(update.has_value());
  ASSERT_EQ(update->frame_update().result().targets_size(), 1);
  pb::ClientMessage move;
  move.mutable_move_target()->set_session_id("drive");
  move.mutable_move_target()->set_target_id("nobody");
  *move.mutable_move_target()->mutable_box() = *box;
  EXPECT_EQ(page->Ask(move).error().code(), 5);
  pb::ClientMessage drop;
  drop.mutable_drop_target()->set_session_id("drive");
  drop.mutable_drop_target()->set_target_id("square");
  EXPECT_TRUE(page->Ask(drop).has_done());
  pb::ClientMessage remove;
  remove.mutable_delete_session()->set_session_id("drive");
  EXPECT_TRUE(page->Ask(remove).has_done());
  EXPECT_TRUE(absl::IsNotFound(client->GetSession("drive").status()));
}

}  // namespace
}  // namespace groundlock::test
