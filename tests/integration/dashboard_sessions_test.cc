// SPDX-License-Identifier: Apache-2.0
// Sessions seen and steered through the dashboard: who sees what, what a slow
// page gets, and what survives the server's restart.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <string>

#include "tests/integration/dashboard_fixture.h"

namespace groundlock::test {
namespace {

using boost::beast::http::verb;

TEST_F(DashboardTest, APageFollowsASessionAndALateOneGetsItsHistory) {
  ServerWithSession drive;
  Start(drive.server);
  const auto page = Watching(port(), "drive");
  auto stream = drive.client->Track("drive");
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
  EXPECT_EQ(drive.server.metrics().watchers.load(), 1);

  const HttpResponse csv =
      Fetch(port(), verb::get, "/api/sessions/drive/trajectory?format=csv");
  EXPECT_EQ(csv.result_int(), 200U);
  EXPECT_EQ(std::count(csv.body().begin(), csv.body().end(), '\n'), 11);
  EXPECT_EQ(
      Fetch(port(), verb::get, "/api/sessions/drive/trajectory?format=kml")
          .result_int(),
      409U);

  ASSERT_TRUE(drive.client->DeleteSession("drive").ok());
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
  sdk::SessionSpec spec = Spec("drive");
  spec.camera = TestCamera(300, 300);
  ServerWithSession drive(spec);
  options_.viewers.stall_timeout = std::chrono::seconds(10);
  Start(drive.server);
  Page stalled(port(), {}, /*receive_buffer_bytes=*/4'096);
  ASSERT_TRUE(stalled.Ask(Subscribe("drive")).has_subscribed());
  const auto page = Watching(port(), "drive");
  ASSERT_EQ(dashboard_->num_viewers(), 2);
  auto stream = drive.client->Track("drive");
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

// As a camera's driver gives it.
sdk::Frame RawFrame(std::uint64_t sequence, int width_px, int height_px) {
  sdk::Frame frame;
  frame.sequence = sequence;
  frame.capture_time = std::chrono::milliseconds(40) * sequence;
  frame.image.encoding = sdk::ImageEncoding::kRawGray8;
  frame.image.width_px = width_px;
  frame.image.height_px = height_px;
  frame.image.bytes.assign(static_cast<std::size_t>(width_px) * height_px,
                           '\x80');
  return frame;
}

TEST_F(DashboardTest, ImagesComeAsWideAsTheWidestPageShowsThem) {
  sdk::SessionSpec spec = Spec("drive");
  spec.camera = TestCamera(400, 300);
  ServerWithSession drive(spec);
  Start(drive.server);
  pb::ClientMessage narrow = Subscribe("drive");
  narrow.mutable_subscribe()->set_image_width_px(120);
  Page page(port());
  ASSERT_TRUE(page.Ask(narrow).has_subscribed());
  ASSERT_TRUE(page.ReadUntil(IsLive).has_value());
  auto stream = drive.client->Track("drive");
  ASSERT_TRUE(stream.ok());
  std::uint64_t sequence = 0;
  // Width of the next frame's image. No frame is lost or comes twice, also
  // while the images change.
  const auto next_width = [&] {
    EXPECT_TRUE((*stream)->Send(RawFrame(sequence, 400, 300)).ok());
    EXPECT_TRUE((*stream)->Next().ok());
    const auto update = page.ReadUntil(
        [](const pb::ServerMessage& m) { return m.has_frame_update(); });
    EXPECT_TRUE(update.has_value());
    if (!update.has_value()) return -1;
    EXPECT_EQ(update->frame_update().result().sequence(), sequence++);
    EXPECT_EQ(update->frame_update().skipped(), 0U);
    const auto message = page.ReadUntil(
        [](const pb::ServerMessage& m) { return m.has_frame_image(); });
    EXPECT_TRUE(message.has_value());
    if (!message.has_value()) return -1;
    const std::string& data = message->frame_image().image().data();
    const cv::Mat image = cv::imdecode(
        std::vector<std::uint8_t>(data.begin(), data.end()), cv::IMREAD_COLOR);
    if (image.empty()) return -1;
    EXPECT_EQ(image.rows, 300 / (400 / image.cols));
    return image.cols;
  };
  EXPECT_EQ(next_width(), 133);  // a third, not narrower than 120
  Page wide(port());
  ASSERT_TRUE(wide.Ask(Subscribe("drive")).has_subscribed());
  EXPECT_TRUE(Eventually([&] { return next_width() == 400; }));
  pb::ClientMessage leave;
  leave.mutable_unsubscribe()->set_session_id("drive");
  ASSERT_TRUE(wide.Ask(leave).has_done());
  EXPECT_TRUE(Eventually([&] { return next_width() == 133; }));
  narrow.mutable_subscribe()->set_image_width_px(201);
  ASSERT_TRUE(page.Ask(narrow).has_subscribed());
  EXPECT_TRUE(Eventually([&] { return next_width() == 400; }));
}

TEST_F(DashboardTest, PagesSurviveTheRestartOfTheServer) {
  ServerWithSession drive;
  Start(drive.server);
  const auto page = Watching(port(), "drive");
  drive.server.Stop(std::chrono::milliseconds(0));
  EXPECT_TRUE(page->ReadUntil([](const pb::ServerMessage& message) {
                    return message.server_state().state() ==
                           pb::ServerState::STATE_UNREACHABLE;
                  })
                  .has_value());
  drive.server.Restart();
  EXPECT_TRUE(page->ReadUntil([](const pb::ServerMessage& message) {
                    return message.server_state().state() ==
                           pb::ServerState::STATE_CONNECTED;
                  })
                  .has_value());
  // A session of the same name, as a restored or a new one is.
  const auto client = drive.server.Connect();
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

TEST_F(DashboardTest, TargetsAreSetMovedAndDroppedThroughIt) {
  TestServer server;
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("drive")).ok());
  Start(server);
  const auto page = Watching(port(), "drive");
  pb::ClientMessage set;
  set.mutable_set_target()->set_session_id("drive");
  set.mutable_set_target()->set_target_id("square");
  *set.mutable_set_target()->mutable_box() = SquareBox(30, 40);
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
  *move.mutable_move_target()->mutable_box() = SquareBox(30, 40);
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
