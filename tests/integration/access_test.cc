// SPDX-License-Identifier: Apache-2.0
// A server that wants tokens: no call of the API gets past it without one.
#include <gmock/gmock.h>
#include <google/protobuf/descriptor.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

constexpr char kToken[] = "0123456789abcdef";

service::ServerOptions WithToken() {
  service::ServerOptions options;
  options.tokens = {kToken};
  return options;
}

// The status of any call, made with an empty message.
grpc::Status CallMethod(const std::string& address,
                        const std::string& method,
                        const std::string& authorization) {
  grpc::GenericStub stub(
      grpc::CreateChannel(address, grpc::InsecureChannelCredentials()));
  grpc::ClientContext context;
  if (!authorization.empty()) {
    context.AddMetadata("authorization", authorization);
  }
  grpc::CompletionQueue queue;
  auto call = stub.PrepareCall(&context, method, &queue);
  const auto wait = [&queue] {
    void* tag = nullptr;
    bool ok = false;
    return queue.Next(&tag, &ok) && ok;
  };
  call->StartCall(nullptr);
  wait();
  grpc::ByteBuffer empty;
  call->WriteLast(empty, grpc::WriteOptions(), nullptr);
  wait();
  grpc::ByteBuffer response;
  bool more = true;
  while (more) {
    call->Read(&response, nullptr);
    more = wait();
  }
  grpc::Status status;
  call->Finish(&status, nullptr);
  wait();
  return status;
}

TEST(Access, NoMethodAnswersWithoutAToken) {
  TestServer server(WithToken());
  int methods = 0;
  for (const auto* file :
       {v1::Session::descriptor()->file(), v1::MapInfo::descriptor()->file()}) {
    for (int s = 0; s < file->service_count(); ++s) {
      const auto* service = file->service(s);
      for (int m = 0; m < service->method_count(); ++m) {
        const std::string name =
            "/" + service->full_name() + "/" + service->method(m)->name();
        for (const char* authorization :
             {"", "Bearer wrong-token-0123", "Bearer ", "0123456789abcdef"}) {
          // One that the server does not have says so to everybody.
          const auto code =
              CallMethod(server.address(), name, authorization).error_code();
          EXPECT_TRUE(code == grpc::StatusCode::UNAUTHENTICATED ||
                      code == grpc::StatusCode::UNIMPLEMENTED)
              << name << " with \"" << authorization << "\": " << code;
        }
        ++methods;
      }
    }
  }
  EXPECT_GE(methods, 16);
}

TEST(Access, TheSdkSendsItsTokenWithEveryCall) {
  TestServer server(WithToken());
  sdk::ClientOptions options;
  options.token = kToken;
  const auto client = sdk::Client::Connect(server.address(), options);
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->CreateSession(Spec("s")).ok());
  EXPECT_EQ((*client)->ListSessions()->size(), 1U);
  EXPECT_TRUE((*client)->ListMaps().ok());
  auto watcher = (*client)->Watch("s", false);
  ASSERT_TRUE(watcher.ok()) << watcher.status();
  auto stream = (*client)->Track("s");
  ASSERT_TRUE(stream.ok()) << stream.status();
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
  EXPECT_TRUE((*watcher)->Next().ok());

  options.token = "another-token-01";
  const auto stranger = sdk::Client::Connect(server.address(), options);
  ASSERT_TRUE(stranger.ok());
  EXPECT_EQ((*stranger)->ListSessions().status().code(),
            absl::StatusCode::kUnauthenticated);
  EXPECT_EQ((*stranger)->Track("s").status().code(),
            absl::StatusCode::kUnauthenticated);
  EXPECT_EQ((*stranger)->Watch("s", true).status().code(),
            absl::StatusCode::kUnauthenticated);
}

}  // namespace
}  // namespace groundlock::test
