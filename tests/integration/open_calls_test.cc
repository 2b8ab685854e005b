// SPDX-License-Identifier: Apache-2.0
// How many calls may be open, by real sockets: of clients that keep to HTTP/2,
// and of those that do not.
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <list>
#include <memory>
#include <string>
#include <vector>

#include "groundlock/v1/tracking.grpc.pb.h"
#include "tests/integration/raw_connection.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

constexpr char kTrack[] = "/groundlock.v1.TrackingService/Track";

service::ServerOptions Limited(int total, int per_address) {
  service::ServerOptions options;
  options.calls = {total, per_address};
  // Calls that say nothing stay for longer than any test.
  options.client_silence = std::chrono::hours(1);
  return options;
}

// HEADERS of calls that begin and say nothing more.
std::string Calls(int count) {
  std::string calls;
  for (int i = 0; i < count; ++i) {
    calls += Http2Call(static_cast<std::uint32_t>(2 * i + 1), kTrack);
  }
  return calls;
}

// A client with a connection of its own.
class Channel {
 public:
  explicit Channel(const std::string& address) {
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    stub_ = v1::TrackingService::NewStub(grpc::CreateCustomChannel(
        address, grpc::InsecureChannelCredentials(), arguments));
  }
  ~Channel() {
    if (stream_ == nullptr) return;
    held_.TryCancel();
    stream_->Finish();
  }
  // Begins a call that stays.
  void Hold() { stream_ = stub_->Track(&held_); }
  grpc::Status ListSessions(
      std::chrono::milliseconds patience = std::chrono::minutes(1)) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + patience);
    v1::ListSessionsResponse sessions;
    return stub_->ListSessions(&context, {}, &sessions);
  }

 private:
  std::unique_ptr<v1::TrackingService::Stub> stub_;
  grpc::ClientContext held_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::TrackRequest, v1::TrackResponse>>
      stream_;
};

// It passes over what the server tells it that it may have.
TEST(OpenCalls, AClientThatNeverAcknowledgesTheSettingsHasNoMoreThanItMay) {
  TestServer server(Limited(1'000, 10));
  const service::Metrics& metrics = server.metrics();
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  const auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  ASSERT_TRUE(Eventually([&] { return metrics.calls == 1; }));

  std::list<RawConnection> hostile;
  std::int64_t most = 0;
  for (std::uint64_t round = 1; round <= 3; ++round) {
    const RawConnection& one =
        hostile.emplace_back(server.server().port(), "127.0.0.2");
    ASSERT_TRUE(one.Send(std::string(kHttp2Preface) + Http2Settings()));
    ASSERT_TRUE(one.Send(Calls(500)));
    EXPECT_TRUE(Eventually([&] {
      most = std::max(most, metrics.calls.load());
      return metrics.calls_over_limit == 500 * round - 10;
    })) << metrics.calls_over_limit;
    EXPECT_TRUE(Eventually([&] { return metrics.calls == 1 + 10; }))
        << "those that it may have it has";
    // Beside it another is served, in its stream and by new calls.
    ASSERT_TRUE((*stream)->Send(SquareFrame(round, 10, 10)).ok());
    EXPECT_TRUE((*stream)->Next().ok());
    EXPECT_TRUE(client->ListSessions().ok());
  }
  EXPECT_LE(most, 1 + 10 + 1);  // ListSessions of the round before
  EXPECT_EQ(metrics.calls_over_limit, 1'490U) << "none of the other's";
  // What it lets go is given back.
  hostile.clear();
  EXPECT_TRUE(Eventually([&] { return metrics.calls == 1; }));
  const RawConnection next(server.server().port(), "127.0.0.2");
  ASSERT_TRUE(next.Send(std::string(kHttp2Preface) + Http2Settings()));
  ASSERT_TRUE(next.Send(Calls(10)));
  EXPECT_TRUE(Eventually([&] { return metrics.calls == 11; }));
  EXPECT_EQ(metrics.calls_over_limit, 1'490U);
}

// Health is for everybody, and as bounded.
TEST(OpenCalls, WhoWatchesHealthIsCountedToo) {
  TestServer server(Limited(1'000, 10));
  const RawConnection hostile(server.server().port(), "127.0.0.2");
  std::string calls = std::string(kHttp2Preface) + Http2Settings();
  for (std::uint32_t i = 0; i < 500; ++i) {
    calls += Http2Call(2 * i + 1, "/grpc.health.v1.Health/Watch");
  }
  ASSERT_TRUE(hostile.Send(calls));
  EXPECT_TRUE(Eventually([&] {
    return server.metrics().calls_over_limit == 490 &&
           server.metrics().calls == 10;
  })) << server.metrics().calls_over_limit;
  EXPECT_TRUE(Channel(server.address()).ListSessions().ok());
}

TEST(OpenCalls, AClientWithManyConnectionsKeepsNobodyElseOut) {
  service::ServerOptions options;
  options.connections = {.max_connections = 100,
                         .max_connections_per_address = 10};
  TestServer server(options);
  const service::Metrics& metrics = server.metrics();
  {
    std::list<RawConnection> hostile;
    for (int i = 0; i < 30; ++i) {
      hostile.emplace_back(server.server().port(), "127.0.0.2");
    }
    EXPECT_TRUE(Eventually([&] {
      return metrics.connections_over_limit == 20 && metrics.connections == 10;
    })) << metrics.connections_over_limit;
    EXPECT_TRUE(Channel(server.address()).ListSessions().ok());
  }
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 0; }));
  const RawConnection later(server.server().port(), "127.0.0.2");
  ASSERT_TRUE(later.Send(std::string(kHttp2Preface) + Http2Settings()));
  EXPECT_TRUE(later.HasAnswer());
}

// Whoever acknowledges them and does not keep to them is cut off by gRPC.
TEST(OpenCalls, AClientThatAcknowledgesTheSettingsAndBreaksThemHasNoMore) {
  TestServer server(Limited(1'000, 10));
  const RawConnection hostile(server.server().port(), "127.0.0.2");
  ASSERT_TRUE(hostile.Send(std::string(kHttp2Preface) + Http2Settings()));
  ASSERT_TRUE(hostile.HasAnswer());
  ASSERT_TRUE(hostile.Send(Http2SettingsAck()));
  hostile.Send(Calls(500));
  std::int64_t most = 0;
  EXPECT_TRUE(Eventually([&] {
    most = std::max(most, server.metrics().calls.load());
    return hostile.EndsWithin(0);
  }));
  EXPECT_LE(most, 10);
  EXPECT_TRUE(Eventually([&] { return server.metrics().calls == 0; }));
  EXPECT_TRUE(Channel(server.address()).ListSessions().ok());
}

TEST(OpenCalls, AboveTheTotalAClientIsToldAndServedWhenThereIsRoom) {
  TestServer server(Limited(2, 0));
  auto first = std::make_unique<Channel>(server.address());
  Channel second(server.address());
  Channel third(server.address());
  first->Hold();
  second.Hold();
  ASSERT_TRUE(Eventually([&] { return server.metrics().calls == 2; }));
  const grpc::Status refused = third.ListSessions();
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED);
  EXPECT_EQ(refused.error_message(), "the server has 2 calls open, all it may");
  EXPECT_EQ(server.metrics().calls_over_limit, 1U);
  first = nullptr;
  ASSERT_TRUE(Eventually([&] { return server.metrics().calls == 1; }));
  EXPECT_TRUE(third.ListSessions().ok());
}

// gRPC's own clients hold back what is more than a connection may have.
TEST(OpenCalls, CallsAboveAConnectionsLimitWait) {
  TestServer server(Limited(100, 2));
  auto holding = std::make_unique<Channel>(server.address());
  holding->Hold();
  ASSERT_TRUE(Eventually([&] { return server.metrics().calls == 1; }));
  EXPECT_EQ(holding->ListSessions(std::chrono::milliseconds(300)).error_code(),
            grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_TRUE(Channel(server.address()).ListSessions().ok())
      << "through another connection";
  EXPECT_EQ(server.metrics().calls_over_limit, 0U);
}

// Calls that nobody answers for, and that end in every way.
TEST(OpenCalls, WhatEndsIsGivenBackHoweverItEnds) {
  // More than the hundred calls below: on a busy machine a call that is over
  // for its client is still open here for some time.
  service::ServerOptions options = Limited(1'000, 200);
  options.tokens = {"secret"};
  TestServer server(options);
  const service::Metrics& metrics = server.metrics();
  // Refused for who makes them.
  for (int i = 0; i < 100; ++i) {
    EXPECT_EQ(Channel(server.address()).ListSessions().error_code(),
              grpc::StatusCode::UNAUTHENTICATED);
  }
  EXPECT_TRUE(Eventually([&] { return metrics.calls == 0; }));
  // Broken off, with answers on their way or before there are any.
  const auto refused = [&] {
    return metrics.calls_unauthenticated + metrics.calls_over_limit;
  };
  for (int i = 0; i < 20; ++i) {
    const std::uint64_t before = refused();
    RawConnection broken(server.server().port());
    ASSERT_TRUE(broken.Send(std::string(kHttp2Preface) + Http2Settings()));
    ASSERT_TRUE(broken.Send(Calls(20)));
    if (i % 2 == 0) {
      broken.Reset();
    } else {
      EXPECT_TRUE(Eventually([&] { return refused() >= before + 20; }));
    }
  }
  // What was sent last may still be on its way in.
  EXPECT_TRUE(Eventually([&] {
    return Channel(server.address()).ListSessions().error_code() ==
           grpc::StatusCode::UNAUTHENTICATED;
  }));
  EXPECT_TRUE(Eventually([&] { return metrics.calls == 0; }));
}

}  // namespace
}  // namespace groundlock::test
