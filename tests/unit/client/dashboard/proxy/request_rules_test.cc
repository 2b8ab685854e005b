// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/request_rules.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <string>

namespace groundlock::dashboard {
namespace {

using ::testing::HasSubstr;

std::string Bytes(const std::function<void(pb::ClientMessage&)>& fill) {
  pb::ClientMessage message;
  message.set_request_id(7);
  fill(message);
  return message.SerializeAsString();
}

TEST(ParseRequest, TakesWhatIsWellFormed) {
  const auto request = ParseRequest(Bytes([](pb::ClientMessage& message) {
    message.mutable_subscribe()->set_session_id("drive");
    message.mutable_subscribe()->set_include_images(true);
  }));
  ASSERT_TRUE(request.ok()) << request.status();
  EXPECT_EQ(request->subscribe().session_id(), "drive");
}

TEST(ParseRequest, NamesTheFieldAtFault) {
  const auto expect = [](const std::string& bytes, const char* text) {
    const auto request = ParseRequest(bytes);
    EXPECT_EQ(request.status().code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(request.status().message()), HasSubstr(text));
  };
  expect("\xFF\xFF\xFF", "ClientMessage");
  expect(Bytes([](auto& m) { m.mutable_ping(), m.set_request_id(0); }),
         "request_id");
  expect(Bytes([](auto&) {}), "request");
  expect(Bytes([](auto& m) { m.mutable_subscribe(); }), "session_id");
  expect(Bytes([](auto& m) {
           m.mutable_subscribe()->set_session_id(std::string(65, 'a'));
         }),
         "session_id");
  expect(Bytes([](auto& m) {
           m.mutable_subscribe()->set_session_id("s");
           m.mutable_subscribe()->set_max_images_per_s(
               std::numeric_limits<double>::quiet_NaN());
         }),
         "max_images_per_s");
  expect(Bytes([](auto& m) { m.mutable_set_target()->set_session_id("s"); }),
         "box");
  expect(Bytes([](auto& m) {
           m.mutable_move_target()->set_session_id("s");
           m.mutable_move_target()->mutable_box()->set_width(
               std::numeric_limits<double>::infinity());
           m.mutable_move_target()->mutable_box()->set_height(1.0);
         }),
         "box");
  expect(Bytes([](auto& m) { m.mutable_start_session(); }), "source_id");
  expect(
      Bytes([](auto& m) { m.mutable_control_source()->set_session_id("s"); }),
      "action");
  expect(Bytes([](auto& m) {
           m.mutable_start_recording()->set_session_id("s");
           m.mutable_start_recording()->set_name("../x");
         }),
         "name");
  expect(Bytes([](auto& m) { m.mutable_delete_recording()->set_name(".x"); }),
         "name");
}

TEST(RateLimit, AllowsBurstsAndThenTheRate) {
  RateLimit limit(10.0);
  auto now = std::chrono::steady_clock::time_point(std::chrono::seconds(100));
  int taken = 0;
  for (int i = 0; i < 100; ++i) taken += limit.Take(now) ? 1 : 0;
  EXPECT_EQ(taken, 20);
  now += std::chrono::milliseconds(500);
  taken = 0;
  for (int i = 0; i < 100; ++i) taken += limit.Take(now) ? 1 : 0;
  EXPECT_EQ(taken, 5);
}

}  // namespace
}  // namespace groundlock::dashboard
