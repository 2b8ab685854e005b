// SPDX-License-Identifier: Apache-2.0
// What goes into the dashboard and out of it as files: uploads, videos that
// become sessions, recordings.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/write.hpp>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <string>
#include <thread>

#include "client/dashboard/recording/session_recording.h"
#include "tests/integration/dashboard_fixture.h"

namespace groundlock::test {
namespace {

using boost::beast::http::verb;
using ::testing::HasSubstr;

namespace fs = std::filesystem;

TEST_F(DashboardTest, UploadsAreBounded) {
  TestServer server;
  options_.uploads_limits.max_video_bytes = 100'000;
  Start(server);
  const std::string path = "/api/uploads/" + NewVideoUpload("walk") + "/";
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

// A square that moves to the right, for a second.
void WriteSquareVideo(const fs::path& file) {
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
}

void FillCamera(v1::CameraModel* camera) {
  camera->set_model(v1::CAMERA_MODEL_ID_SIMPLE_PINHOLE);
  camera->set_width_px(kWidth);
  camera->set_height_px(kHeight);
  for (const double param : {150.0, 80.0, 60.0}) camera->add_params(param);
}

TEST_F(DashboardTest, AnUploadedVideoBecomesASessionWhoseTargetIsFollowed) {
  TestServer server;
  Start(server);
  const fs::path file = directory_.path() / "square.avi";
  WriteSquareVideo(file);
  const std::string id = NewVideoUpload("square");
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
  FillCamera(session->mutable_camera());
  start.mutable_start_session()->set_paused(true);
  pb::MarkedTarget* square = start.mutable_start_session()->add_targets();
  square->set_target_id("square");
  *square->mutable_box() = SquareBox(20, 40);
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

TEST_F(DashboardTest, SessionsOfItsStartAreFedAndComeBack) {
  TestServer server;
  options_.sources = directory_.path() / "sources";
  fs::create_directories(options_.sources);
  WriteSquareVideo(options_.sources / "square.avi");
  pb::StartSession start;
  start.set_source_id("file:square.avi");
  start.set_loop(true);
  start.mutable_session()->set_session_id("always");
  FillCamera(start.mutable_session()->mutable_camera());
  options_.start_sessions = {start};
  Start(server);
  Page page(port());
  const auto is_fed = [](const pb::ServerMessage& message) {
    return message.sessions().sessions_size() == 1 &&
           message.sessions().sessions(0).source_run().state() ==
               pb::SourceRun::STATE_PLAYING;
  };
  const auto fed = page.ReadUntil(is_fed);
  ASSERT_TRUE(fed.has_value());
  EXPECT_EQ(fed->sessions().sessions(0).session().session_id(), "always");
  EXPECT_EQ(fed->sessions().sessions(0).source_run().source_id(),
            "file:square.avi");
  ASSERT_TRUE(page.Ask(Subscribe("always")).has_subscribed());
  // Longer than the video: it starts anew at its end.
  EXPECT_TRUE(page.ReadUntil([](const pb::ServerMessage& message) {
                    return message.frame_update().result().sequence() > 30;
                  })
                  .has_value());
  // A server that has lost it gets it again.
  server.Restart();
  const auto client = server.Connect();
  EXPECT_TRUE(Eventually([&] {
    const auto session = client->GetSession("always");
    return session.ok() && session->next_sequence > 3;
  }));
}

// A camera on the network: serves a second of video to whoever comes, and hangs
// up. The first time it breaks off in the middle.
class Camera {
 public:
  explicit Camera(std::string video)
      : video_(std::move(video)),
        listening_(io_,
                   boost::asio::ip::tcp::endpoint(
                       boost::asio::ip::address_v4::loopback(), 0)),
        thread_([this] { Serve(); }) {}
  ~Camera() {
    stopping_ = true;
    boost::asio::io_context io;
    boost::asio::ip::tcp::socket knock(io);
    knock.connect(listening_.local_endpoint());
    thread_.join();
  }
  std::string address() const {
    return "tcp://127.0.0.1:" +
           std::to_string(listening_.local_endpoint().port());
  }
  int served() const { return served_; }

 private:
  void Serve() {
    for (;;) {
      boost::asio::ip::tcp::socket viewer(io_);
      listening_.accept(viewer);
      if (stopping_) return;
      const std::size_t size = video_.size() / (served_ == 0 ? 2 : 1);
      boost::system::error_code gone;
      boost::asio::write(
          viewer, boost::asio::buffer(video_.data(), size), gone);
      ++served_;
    }
  }

  const std::string video_;
  boost::asio::io_context io_;
  boost::asio::ip::tcp::acceptor listening_;
  std::atomic<bool> stopping_{false};
  std::atomic<int> served_{0};
  std::thread thread_;
};

TEST_F(DashboardTest, AStreamThatBreaksOffIsOpenedAgain) {
  TestServer server;
  const fs::path file = directory_.path() / "square.avi";
  WriteSquareVideo(file);
  Camera camera(*base::ReadFile(file, 1 << 24));
  options_.streams = {{"yard", camera.address(), ""}};
  Start(server);
  Page page(port());
  pb::ClientMessage start;
  start.mutable_start_session()->set_source_id("stream:yard");
  v1::CreateSessionRequest* session =
      start.mutable_start_session()->mutable_session();
  session->set_session_id("yard");
  FillCamera(session->mutable_camera());
  const pb::ServerMessage started = page.Ask(start);
  ASSERT_TRUE(started.has_session_started()) << started.error().message();
  EXPECT_TRUE(Eventually([&] { return camera.served() >= 2; }));
  const auto client = server.Connect();
  EXPECT_TRUE(Eventually([&] {
    const auto fed = client->GetSession("yard");
    return fed.ok() && fed->next_sequence > 25;
  }));
}

TEST_F(DashboardTest, ARecordingIsMadeServedInPartsAndRead) {
  ServerWithSession drive;
  Start(drive.server);
  const auto page = Watching(port(), "drive");
  pb::ClientMessage record;
  record.mutable_start_recording()->set_session_id("drive");
  record.mutable_start_recording()->set_name("first");
  const pb::ServerMessage begun = page->Ask(record);
  ASSERT_TRUE(begun.has_recording()) << begun.error().message();
  EXPECT_EQ(begun.recording().state(), pb::RecordingInfo::STATE_RECORDING);
  EXPECT_EQ(page->Ask(record).error().code(), 6);  // ALREADY_EXISTS
  auto stream = drive.client->Track("drive");
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

}  // namespace
}  // namespace groundlock::test
