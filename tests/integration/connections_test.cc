// SPDX-License-Identifier: Apache-2.0
// Connections: how many there may be, how long they may take to become some,
// and how much goes through one. By real sockets.
#include <gmock/gmock.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <list>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "groundlock/v1/tracking.grpc.pb.h"
#include "tests/integration/raw_connection.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

constexpr char kTrack[] = "/groundlock.v1.TrackingService/Track";

service::ServerOptions Limited(int total, int per_address) {
  service::ServerOptions options;
  options.connections.max_connections = total;
  options.connections.max_per_address = per_address;
  return options;
}

bool IsServed(const TestServer& server) {
  sdk::ClientOptions options;
  options.connect_timeout = std::chrono::seconds(60);
  const auto client = sdk::Client::Connect(server.address(), options);
  return client.ok() && (*client)->ListSessions().ok();
}

TEST(Connections, OneAddressLeavesRoomForOthers) {
  TestServer server(Limited(100, 5));
  const int port = server.server().port();
  std::list<RawConnection> greedy;
  for (int i = 0; i < 5; ++i) greedy.emplace_back(port, "127.0.0.2");
  ASSERT_TRUE(Eventually([&] { return server.metrics().connections == 5; }));
  for (int i = 0; i < 20; ++i) {
    EXPECT_TRUE(RawConnection(port, "127.0.0.2").IsEnded());
  }
  EXPECT_EQ(server.metrics().connections_refused_address, 20U);
  for (const RawConnection& one : greedy) {
    EXPECT_TRUE(one.HasAnswer()) << "those within the limit are served";
  }
  EXPECT_TRUE(IsServed(server)) << "from 127.0.0.1";
  greedy.clear();
  EXPECT_TRUE(Eventually([&] { return server.metrics().connections == 0; }));
  EXPECT_TRUE(RawConnection(port, "127.0.0.2").HasAnswer());
}

TEST(Connections, AboveTheLimitAClientIsToldAndComesInWhenThereIsRoom) {
  TestServer server(Limited(3, 0));
  std::list<RawConnection> others;
  for (int i = 0; i < 3; ++i) others.emplace_back(server.server().port());
  ASSERT_TRUE(Eventually([&] { return server.metrics().connections == 3; }));
  sdk::ClientOptions options;
  options.connect_timeout = std::chrono::milliseconds(500);
  const auto refused = sdk::Client::Connect(server.address(), options);
  EXPECT_EQ(refused.status().code(), absl::StatusCode::kUnavailable)
      << refused.status();
  EXPECT_GE(server.metrics().connections_refused_total, 1U);
  others.pop_front();
  EXPECT_TRUE(IsServed(server));
}

// What opens a connection and does not get as far as HTTP/2's settings, in
// every way that one may not: it is ended, and what is served meanwhile goes
// on.
TEST(Connections, HalfOpenOnesAreEnded) {
  service::ServerOptions options = Limited(100, 0);
  options.connections.handshake_timeout = std::chrono::seconds(1);
  TestServer server(options);
  const int port = server.server().port();
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("s")).ok());
  const auto stream = client->Track("s");
  ASSERT_TRUE(stream.ok());
  const RawConnection silent(port);
  const RawConnection half_preface(port);
  EXPECT_TRUE(half_preface.Send(kHttp2Preface.substr(0, 10)));
  const RawConnection no_settings(port);
  EXPECT_TRUE(no_settings.Send(kHttp2Preface));
  const RawConnection half_settings(port);
  EXPECT_TRUE(half_settings.Send(kHttp2Preface));
  EXPECT_TRUE(half_settings.Send(Http2Settings().substr(0, 5)));
  for (const RawConnection* one :
       {&silent, &half_preface, &no_settings, &half_settings}) {
    EXPECT_TRUE(one->IsEnded());
  }
  EXPECT_TRUE(Eventually([&] { return server.metrics().connections == 1; }));
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
}

TEST(Connections, WhatHasNoCallsIsClosedAfterAWhile) {
  service::ServerOptions options = Limited(100, 0);
  options.connections.idle_timeout = std::chrono::milliseconds(500);
  TestServer server(options);
  const RawConnection idle(server.server().port());
  EXPECT_TRUE(idle.Send(std::string(kHttp2Preface) + Http2Settings() +
                        Http2SettingsAck()));
  EXPECT_TRUE(idle.IsEnded());
  // A client makes another connection when it needs one.
  const auto client = server.Connect();
  EXPECT_TRUE(client->ListSessions().ok());
  EXPECT_TRUE(Eventually([&] { return server.metrics().connections == 0; }));
  EXPECT_TRUE(client->ListSessions().ok());
}

// gRPC's own clients hold back what is more than the server allows.
TEST(Connections, CallsAboveAConnectionsLimitWait) {
  service::ServerOptions options = Limited(100, 0);
  options.connections.max_streams = 3;
  TestServer server(options);
  const auto channel =
      grpc::CreateChannel(server.address(), grpc::InsecureChannelCredentials());
  const auto stub = v1::TrackingService::NewStub(channel);
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts;
  std::vector<std::unique_ptr<
      grpc::ClientReaderWriter<v1::TrackRequest, v1::TrackResponse>>>
      streams;
  for (int i = 0; i < 3; ++i) {
    contexts.push_back(std::make_unique<grpc::ClientContext>());
    streams.push_back(stub->Track(contexts.back().get()));
    ASSERT_TRUE(Eventually([&] { return server.metrics().streams == i + 1; }));
  }
  grpc::ClientContext waiting;
  waiting.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::milliseconds(300));
  v1::ListSessionsResponse sessions;
  EXPECT_EQ(stub->ListSessions(&waiting, {}, &sessions).error_code(),
            grpc::StatusCode::DEADLINE_EXCEEDED);
  EXPECT_TRUE(IsServed(server)) << "through another connection";
  contexts.front()->TryCancel();
  streams.front()->Finish();
  grpc::ClientContext next;
  EXPECT_TRUE(stub->ListSessions(&next, {}, &sessions).ok());
  for (std::size_t i = 1; i < 3; ++i) {
    contexts[i]->TryCancel();
    streams[i]->Finish();
  }
}

// One that does not hold back: whether it acknowledges the server's settings,
// from when on they bind it, or not.
TEST(Connections, OneConnectionOpensNoMoreCallsThanItMay) {
  for (const bool acknowledges : {true, false}) {
    service::ServerOptions options = Limited(100, 0);
    options.connections.max_streams = 10;
    TestServer server(options);
    const RawConnection hostile(server.server().port());
    EXPECT_TRUE(hostile.Send(std::string(kHttp2Preface) + Http2Settings()));
    ASSERT_TRUE(hostile.HasAnswer());
    if (acknowledges) {
      EXPECT_TRUE(hostile.Send(Http2SettingsAck()));
    }
    std::string calls;
    for (std::uint32_t i = 0; i < 500; ++i) {
      calls += Http2Call(2 * i + 1, kTrack);
    }
    hostile.Send(calls);
    std::int64_t most = 0;
    EXPECT_TRUE(Eventually([&] {
      most = std::max(most, server.metrics().streams.load());
      return hostile.EndsWithin(0);
    })) << acknowledges;
    EXPECT_LE(most, 20) << acknowledges;
    EXPECT_TRUE(Eventually([&] { return server.metrics().streams == 0; }));
    EXPECT_TRUE(IsServed(server));
  }
}

}  // namespace
}  // namespace groundlock::test
