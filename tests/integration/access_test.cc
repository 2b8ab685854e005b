// SPDX-License-Identifier: Apache-2.0
// A server that wants tokens: no call of the API gets past it without one.
#include <gmock/gmock.h>
#include <google/protobuf/descriptor.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/token_file.h"
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

// What each method wants, written down once more: the server's own table is
// what this one checks.
const std::map<std::string, std::string>& Wanted() {
  static const auto* const wanted =
      new std::map<std::string, std::string>{{"CreateSession", "sessions:all"},
                                             {"ListSessions", "sessions:watch"},
                                             {"GetSession", "sessions:watch"},
                                             {"DeleteSession", "sessions:all"},
                                             {"SetTarget", "sessions:all"},
                                             {"MoveTarget", "sessions:all"},
                                             {"DropTarget", "sessions:all"},
                                             {"Track", "sessions:all"},
                                             {"WatchSession", "sessions:watch"},
                                             {"Localize", "maps:read"},
                                             {"ImportMap", "maps:write"},
                                             {"BuildMap", "maps:write"},
                                             {"ListMaps", "maps:read"},
                                             {"GetMap", "maps:read"},
                                             {"DeleteMap", "maps:write"},
                                             {"GetPointCloud", "maps:read"},
                                             {"ExportMap", "maps:read"},
                                             {"AlignMap", "maps:write"},
                                             {"CheckMap", "maps:read"}};
  return *wanted;
}

bool Includes(const std::string& scope, const std::string& wanted) {
  return scope == wanted || scope == "admin" ||
         (scope == "maps:write" && wanted == "maps:read") ||
         (scope == "sessions:all" && wanted == "sessions:watch");
}

TEST(Access, EveryMethodWithEveryScope) {
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto file = directory.path() / "tokens";
  std::map<std::string, std::string> tokens;
  for (const std::string_view scope : base::kScopes) {
    std::string name(scope);
    std::replace(name.begin(), name.end(), ':', '-');
    tokens[std::string(scope)] =
        *base::CreateToken(file, name, {std::string(scope)});
  }
  service::ServerOptions options;
  options.token_file = file.string();
  TestServer server(options);
  std::size_t methods = 0;
  std::uint64_t refused = 0;
  for (const auto* proto :
       {v1::Session::descriptor()->file(), v1::MapInfo::descriptor()->file()}) {
    for (int s = 0; s < proto->service_count(); ++s) {
      const auto* service = proto->service(s);
      for (int m = 0; m < service->method_count(); ++m) {
        const std::string& method = service->method(m)->name();
        ASSERT_TRUE(Wanted().contains(method))
            << method << ": what does it want?";
        ++methods;
        for (const auto& [scope, token] : tokens) {
          const grpc::Status status =
              CallMethod(server.address(),
                         "/" + service->full_name() + "/" + method,
                         "Bearer " + token);
          const bool denied =
              status.error_code() == grpc::StatusCode::PERMISSION_DENIED;
          EXPECT_NE(status.error_code(), grpc::StatusCode::UNAUTHENTICATED);
          EXPECT_EQ(denied, !Includes(scope, Wanted().at(method)))
              << method << " with " << scope << ": " << status.error_message();
          if (denied) ++refused;
        }
      }
    }
  }
  EXPECT_EQ(methods, Wanted().size());
  EXPECT_EQ(server.metrics().calls_refused, refused);
}

TEST(Access, ARevokedTokenIsRefusedWithoutARestart) {
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto file = directory.path() / "tokens";
  ASSERT_TRUE(base::CreateToken(file, "stays", {"admin"}).ok());
  sdk::ClientOptions client_options;
  client_options.token = *base::CreateToken(file, "goes", {"admin"});
  service::ServerOptions options;
  options.token_file = file.string();
  TestServer server(options);
  const auto client = sdk::Client::Connect(server.address(), client_options);
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_TRUE((*client)->ListMaps().ok());
  ASSERT_TRUE(base::RevokeToken(file, "goes").ok());
  EXPECT_TRUE(Eventually([&] {
    return (*client)->ListMaps().status().code() ==
           absl::StatusCode::kUnauthenticated;
  }));
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
