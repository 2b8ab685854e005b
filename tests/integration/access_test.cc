// SPDX-License-Identifier: Apache-2.0
// A server that wants tokens: no call of the API gets past it without one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/token_file.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

using ::testing::ElementsAre;

constexpr char kToken[] = "0123456789abcdef";

service::ServerOptions WithToken() {
  service::ServerOptions options;
  options.tokens = {kToken};
  return options;
}

TEST(Access, NoMethodAnswersWithoutAToken) {
  TestServer server(WithToken());
  const auto channel = RawChannel(server.address());
  for (const auto* method : EveryMethod()) {
    for (const char* authorization :
         {"", "Bearer wrong-token-0123", "Bearer ", "0123456789abcdef"}) {
      EXPECT_EQ(CallRaw(channel, PathOf(*method), authorization, {""})
                    .status.error_code(),
                grpc::StatusCode::UNAUTHENTICATED)
          << method->name() << " with \"" << authorization << '"';
    }
  }
  EXPECT_EQ(server.metrics().calls_unauthenticated, 4 * EveryMethod().size());
}

// With which roles each method may be called, written down once more: the
// server's own table is what this one checks. Roles are tokens of one scope
// each, and one without any that a server knows (a JWT may be so) is "none".
const std::map<std::string, std::set<std::string>>& Wanted() {
  static const auto* const wanted = [] {
    const std::set<std::string> reads = {"maps:read", "maps:write", "admin"};
    const std::set<std::string> writes = {"maps:write", "admin"};
    const std::set<std::string> acts = {
        "sessions:own", "sessions:all", "admin"};
    const std::set<std::string> sees = {
        "sessions:own", "sessions:watch", "sessions:all", "admin"};
    std::set<std::string> all(base::kScopes.begin(), base::kScopes.end());
    return new std::map<std::string, std::set<std::string>>{
        {"CreateSession", acts},  {"ListSessions", sees},
        {"GetSession", sees},     {"DeleteSession", acts},
        {"SetTarget", acts},      {"MoveTarget", acts},
        {"DropTarget", acts},     {"Track", acts},
        {"WatchSession", sees},   {"Localize", reads},
        {"GetCaller", all},       {"ImportMap", writes},
        {"BuildMap", writes},     {"ListMaps", reads},
        {"GetMap", reads},        {"DeleteMap", writes},
        {"GetPointCloud", reads}, {"ExportMap", reads},
        {"AlignMap", writes},     {"CheckMap", reads}};
  }();
  return *wanted;
}

TEST(Access, EveryMethodWithEveryRole) {
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto file = directory.path() / "tokens";
  std::map<std::string, std::string> tokens;
  for (const std::string_view scope : base::kScopes) {
    std::string name(scope);
    std::replace(name.begin(), name.end(), ':', '-');
    tokens[std::string(scope)] =
        *base::CreateToken(file, {name, "", {std::string(scope)}, ""});
  }
  service::ServerOptions options;
  options.token_file = file.string();
  TestServer server(options);
  const auto channel = RawChannel(server.address());
  std::uint64_t refused = 0;
  for (const auto* method : EveryMethod()) {
    ASSERT_TRUE(Wanted().contains(method->name()))
        << method->name() << ": who may call it?";
    const std::set<std::string>& roles = Wanted().at(method->name());
    for (const auto& [role, token] : tokens) {
      const grpc::Status status =
          CallRaw(channel, PathOf(*method), "Bearer " + token, {""}).status;
      const bool denied =
          status.error_code() == grpc::StatusCode::PERMISSION_DENIED;
      EXPECT_NE(status.error_code(), grpc::StatusCode::UNAUTHENTICATED);
      EXPECT_NE(status.error_code(), grpc::StatusCode::UNIMPLEMENTED);
      EXPECT_NE(status.error_code(), grpc::StatusCode::DEADLINE_EXCEEDED);
      EXPECT_EQ(denied, !roles.contains(role))
          << method->name() << " with " << role << ": "
          << status.error_message();
      if (denied) ++refused;
    }
  }
  EXPECT_EQ(EveryMethod().size(), Wanted().size());
  EXPECT_EQ(server.metrics().calls_denied, refused);
  EXPECT_EQ(server.metrics().calls_unauthenticated, 0U);
}

TEST(Access, TellsCallersWhoTheyAre) {
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto file = directory.path() / "tokens";
  service::ServerOptions options;
  const std::string token =
      *base::CreateToken(file, {"camera", "acme", {"sessions:all"}, ""});
  options.token_file = file.string();
  TestServer server(options);
  const RawAnswer answer = CallRaw(RawChannel(server.address()),
                                   "/groundlock.v1.TrackingService/GetCaller",
                                   "Bearer " + token,
                                   {""});
  ASSERT_TRUE(answer.status.ok()) << answer.status.error_message();
  v1::GetCallerResponse caller;
  ASSERT_TRUE(caller.ParseFromString(answer.messages.at(0)));
  EXPECT_FALSE(caller.open_to_all());
  EXPECT_EQ(caller.name(), "camera");
  EXPECT_EQ(caller.tenant(), "acme");
  EXPECT_THAT(caller.scopes(),
              ElementsAre("sessions:own", "sessions:watch", "sessions:all"));
}

// Streams that are open when their token goes end, too, and those of others do
// not.
TEST(Access, ARevokedTokenIsRefusedWithoutARestart) {
  const auto directory =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  const auto file = directory.path() / "tokens";
  const auto connect = [](const TestServer& server, const std::string& token) {
    sdk::ClientOptions options;
    options.token = token;
    return *ConnectTo(server.address(), options);
  };
  const std::string stays =
      *base::CreateToken(file, {"stays", "", {"admin"}, ""});
  const std::string goes =
      *base::CreateToken(file, {"goes", "", {"admin"}, ""});
  service::ServerOptions options;
  options.token_file = file.string();
  TestServer server(options);
  const auto staying = connect(server, stays);
  const auto going = connect(server, goes);
  ASSERT_TRUE(going->CreateSession(Spec("s")).ok());
  auto feed = going->Track("s");
  ASSERT_TRUE(feed.ok()) << feed.status();
  auto watch_that_goes = going->Watch("s", false);
  auto watch_that_stays = staying->Watch("s", false);
  ASSERT_TRUE(watch_that_goes.ok() && watch_that_stays.ok());
  ASSERT_TRUE((*feed)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*feed)->Next().ok());
  EXPECT_TRUE((*watch_that_goes)->Next().ok());
  EXPECT_TRUE((*watch_that_stays)->Next().ok());
  ASSERT_TRUE(base::RevokeToken(file, "goes").ok());
  EXPECT_EQ((*watch_that_goes)->Next().status().code(),
            absl::StatusCode::kUnauthenticated);
  EXPECT_EQ((*feed)->Next().status().code(),
            absl::StatusCode::kUnauthenticated);
  EXPECT_EQ(going->ListMaps().status().code(),
            absl::StatusCode::kUnauthenticated);
  // The session lives on, and whoever may feeds it.
  auto next_feed = staying->Track("s");
  ASSERT_TRUE(next_feed.ok()) << next_feed.status();
  ASSERT_TRUE((*next_feed)->Send(SquareFrame(1, 10, 10)).ok());
  EXPECT_TRUE((*next_feed)->Next().ok());
  EXPECT_TRUE((*watch_that_stays)->Next().ok());
}

TEST(Access, TheSdkSendsItsTokenWithEveryCall) {
  TestServer server(WithToken());
  sdk::ClientOptions options;
  options.token = kToken;
  const auto client = ConnectTo(server.address(), options);
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->CreateSession(Spec("s")).ok());
  const auto caller = (*client)->GetCaller();
  ASSERT_TRUE(caller.ok()) << caller.status();
  EXPECT_FALSE(caller->open_to_all);
  EXPECT_THAT(caller->scopes, testing::Contains("sessions:own"));
  const auto sessions = (*client)->ListSessions();
  ASSERT_EQ(sessions->size(), 1U);
  EXPECT_EQ(sessions->front().owner, caller->name);
  EXPECT_TRUE((*client)->ListMaps().ok());
  auto watcher = (*client)->Watch("s", false);
  ASSERT_TRUE(watcher.ok()) << watcher.status();
  auto stream = (*client)->Track("s");
  ASSERT_TRUE(stream.ok()) << stream.status();
  ASSERT_TRUE((*stream)->Send(SquareFrame(0, 10, 10)).ok());
  EXPECT_TRUE((*stream)->Next().ok());
  EXPECT_TRUE((*watcher)->Next().ok());

  options.token = "another-token-01";
  const auto stranger = ConnectTo(server.address(), options);
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
