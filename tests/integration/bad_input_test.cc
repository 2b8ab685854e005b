// SPDX-License-Identifier: Apache-2.0
// Whatever a client sends, it gets a clear error, and the session and the
// server live on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "groundlock/v1/tracking.grpc.pb.h"
#include "grpcpp/grpcpp.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

using ::testing::HasSubstr;

// A PNG that says it has 10,000 x 10,000 pixels, and holds none.
std::string HugePng() {
  std::string png("\x89PNG\r\n\x1a\n", 8);
  png += std::string("\0\0\0\x0dIHDR", 8);
  png += std::string("\0\0\x27\x10\0\0\x27\x10\x08\x02\0\0\0", 13);
  png += std::string("\0\0\0\0", 4);
  return png + std::string(1'000, 'x');
}

struct BadFrame {
  std::string name;
  sdk::Image image;
  absl::StatusCode code;
  std::string message;
};

std::vector<BadFrame> BadFrames() {
  using Encoding = sdk::ImageEncoding;
  const auto invalid = absl::StatusCode::kInvalidArgument;
  const std::string png = SquareImage(10, 10).bytes;
  return {
      {"empty", {Encoding::kAuto, "", 0, 0}, invalid, "empty"},
      {"unknown", {Encoding::kAuto, "no image", 0, 0}, invalid, ""},
      {"text as JPEG", {Encoding::kJpeg, "no image", 0, 0}, invalid, ""},
      {"truncated",
       {Encoding::kPng, png.substr(0, png.size() / 2), 0, 0},
       invalid,
       ""},
      {"other size", SquareImage(10, 10, 80, 60), invalid, "80"},
      {"raw of a wrong size",
       {Encoding::kRawGray8, "0123", kWidth, kHeight},
       invalid,
       ""},
      {"100 megapixels",
       {Encoding::kPng, HugePng(), 0, 0},
       absl::StatusCode::kResourceExhausted,
       "10000"},
  };
}

TEST(BadInput, FramesAreAnsweredByAnErrorAndTheSessionLivesOn) {
  TestServer server;
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  ASSERT_TRUE(
      client->SetTarget("s", "t", geometry::Box2::FromXywh(10, 10, 24, 24))
          .ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  std::uint64_t sequence = 0;
  for (const BadFrame& bad : BadFrames()) {
    SCOPED_TRACE(bad.name);
    sdk::Frame frame = TinyFrame(++sequence);
    frame.image = bad.image;
    ASSERT_TRUE((*stream)->Send(frame).ok());
    auto reply = (*stream)->Next();
    ASSERT_TRUE(reply.ok() && reply->has_value()) << reply.status();
    const auto* error = std::get_if<sdk::FrameError>(&**reply);
    ASSERT_NE(error, nullptr);
    EXPECT_EQ(error->sequence, sequence);
    EXPECT_EQ(error->status.code(), bad.code) << error->status;
    EXPECT_THAT(std::string(error->status.message()),
                HasSubstr("frame " + std::to_string(sequence)));
    EXPECT_THAT(std::string(error->status.message()), HasSubstr(bad.message));

    ASSERT_TRUE((*stream)->Send(SquareFrame(++sequence, 10, 10)).ok());
    reply = (*stream)->Next();
    ASSERT_TRUE(reply.ok() && reply->has_value()) << reply.status();
    const auto* result = std::get_if<sdk::FrameResult>(&**reply);
    ASSERT_NE(result, nullptr);
    EXPECT_EQ(result->targets.size(), 1U);
  }
  EXPECT_EQ(client->GetSession("s")->frames_failed, BadFrames().size());
}

TEST(BadInput, BoxesAreRefusedWithTheReason) {
  TestServer server;
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(
      client->SetTarget("s", "t", {{0, 0}, {nan, 10}}).status().ToString(),
      HasSubstr("box"));
  EXPECT_THAT(client->SetTarget("s", "t", geometry::Box2::FromXywh(0, 0, 0, 10))
                  .status()
                  .ToString(),
              HasSubstr("box.width"));
  EXPECT_THAT(
      client->SetTarget("s", "no/id", geometry::Box2::FromXywh(0, 0, 9, 9))
          .status()
          .ToString(),
      HasSubstr("target_id"));
  const auto body = [&](const sdk::TargetBody& told) {
    return client
        ->SetTarget(
            "s", "t", geometry::Box2::FromXywh(0, 0, 9, 9), std::nullopt, told)
        .status();
  };
  EXPECT_THAT(body({.kind = "tank"}).ToString(),
              HasSubstr("body.kind: 'tank' is none of car, van"));
  for (const double bad : {0.0, -2.0, nan, 1e9}) {
    EXPECT_THAT(body({.kind = "car", .size_m = Eigen::Vector3d(4.0, 2.0, bad)})
                    .ToString(),
                HasSubstr("body.size_m.z"))
        << bad;
  }
  EXPECT_TRUE(client->GetSession("s")->target_ids.empty());
  EXPECT_EQ(
      client->MoveTarget("s", "nobody", geometry::Box2::FromXywh(0, 0, 9, 9))
          .code(),
      absl::StatusCode::kNotFound);
  // Only the frame tells that this one lies outside.
  ASSERT_TRUE(
      client->SetTarget("s", "far", geometry::Box2::FromXywh(5'000, 0, 20, 20))
          .ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE((*stream)->Send(SquareFrame(3, 10, 10)).ok());
  const auto reply = (*stream)->Next();
  ASSERT_TRUE(reply.ok() && reply->has_value());
  const auto* result = std::get_if<sdk::FrameResult>(&**reply);
  ASSERT_NE(result, nullptr);
  EXPECT_TRUE(result->targets.empty());
  ASSERT_EQ(result->target_errors.size(), 1U);
  EXPECT_EQ(result->target_errors[0].id, "far");
  EXPECT_FALSE(result->target_errors[0].message.empty());
  // Frame 3 is over.
  EXPECT_EQ(client->SetTarget("s", "t", geometry::Box2::FromXywh(0, 0, 9, 9), 3)
                .status()
                .code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST(BadInput, SessionsAreRefusedWithTheReason) {
  TestServer server;
  const auto client = server.Connect();
  sdk::SessionSpec spec = Spec("s");
  spec.map_name = "nowhere";
  EXPECT_EQ(client->CreateSession(spec).status().code(),
            absl::StatusCode::kNotFound);
  spec.map_name = "../etc";
  EXPECT_THAT(client->CreateSession(spec).status().ToString(),
              HasSubstr("map_name"));
  spec = Spec("s");
  spec.options.tracker = "magic";
  EXPECT_THAT(client->CreateSession(spec).status().ToString(),
              HasSubstr("options.tracker: unknown 'magic'"));
  spec = Spec("s");
  spec.options.localizer = "magic";
  EXPECT_THAT(client->CreateSession(spec).status().ToString(),
              HasSubstr("options.localizer"));
  spec = Spec("s");
  spec.options.confidence_threshold = 1.5;
  EXPECT_THAT(client->CreateSession(spec).status().ToString(),
              HasSubstr("options.confidence_threshold"));
  for (const double wrong :
       {-0.1, 86'401.0, std::numeric_limits<double>::quiet_NaN()}) {
    spec = Spec("s");
    spec.options.camera_lost_after_s = wrong;
    EXPECT_THAT(client->CreateSession(spec).status().ToString(),
                HasSubstr("options.camera_lost_after_s"));
  }
  EXPECT_TRUE(client->CreateSession(Spec("s")).ok());
}

TEST(BadInput, WhatOnlyAForeignClientSends) {
  TestServer server;
  const auto channel =
      grpc::CreateChannel(server.address(), grpc::InsecureChannelCredentials());
  const auto stub = v1::TrackingService::NewStub(channel);
  const auto create = [&stub](const v1::CreateSessionRequest& request) {
    grpc::ClientContext context;
    v1::CreateSessionResponse response;
    return stub->CreateSession(&context, request, &response);
  };
  v1::CreateSessionRequest request;
  // A camera that says nothing; none at all is fine without a map.
  v1::CameraModel* camera = request.mutable_camera();
  EXPECT_THAT(create(request).error_message(), HasSubstr("camera.model"));
  camera->set_model(v1::CAMERA_MODEL_ID_SIMPLE_PINHOLE);
  camera->set_width_px(kWidth);
  camera->set_height_px(kHeight);
  camera->add_params(std::nan(""));
  camera->add_params(80);
  camera->add_params(60);
  EXPECT_EQ(create(request).error_code(), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_THAT(create(request).error_message(), HasSubstr("camera"));
  camera->set_params(0, 150.0);
  request.mutable_options()->set_flow_mode(static_cast<v1::FlowMode>(77));
  EXPECT_THAT(create(request).error_message(),
              HasSubstr("options.flow_mode: unknown (77)"));
  request.clear_options();
  camera->set_model(static_cast<v1::CameraModelId>(99));
  EXPECT_THAT(create(request).error_message(),
              HasSubstr("camera.model: unset or unknown (99)"));
  camera->set_model(v1::CAMERA_MODEL_ID_SIMPLE_PINHOLE);
  EXPECT_TRUE(create(request).ok());

  grpc::ClientContext context;
  v1::ListSessionsRequest list;
  v1::ListSessionsResponse listed;
  list.set_page_size(-1);
  EXPECT_THAT(stub->ListSessions(&context, list, &listed).error_message(),
              HasSubstr("page_size"));
}

TEST(BadInput, AMessageBeyondTheLimitEndsTheStreamAndNotTheSession) {
  service::ServerOptions options;
  options.max_message_bytes = 2 << 20;
  TestServer server(options);
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  sdk::Frame frame = TinyFrame(0);
  frame.image.bytes.resize(3 << 20);
  ASSERT_TRUE((*stream)->Send(frame).ok());
  EXPECT_EQ((*stream)->Next().status().code(),
            absl::StatusCode::kResourceExhausted);
  stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  EXPECT_EQ((*stream)->next_sequence(), 0U);
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
}

}  // namespace
}  // namespace groundlock::test
