// SPDX-License-Identifier: Apache-2.0
// What belongs to whom: sessions to those who have begun them, maps and
// sessions to a tenant; and what is another tenant's does not exist.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "absl/strings/str_replace.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/token_file.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/test_server.h"
#include "tests/integration/text_model.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

class TenantsTest : public ::testing::Test {
 protected:
  // Adds somebody to the file, before the server starts.
  void Add(const std::string& name,
           const std::string& tenant,
           const std::vector<std::string>& scopes) {
    tokens_[name] = *base::CreateToken(file_, {name, tenant, scopes, ""});
  }
  void Start() {
    service::ServerOptions options;
    options.token_file = file_.string();
    server_ = std::make_unique<TestServer>(options);
  }
  std::unique_ptr<sdk::Client> Connect(const std::string& name) {
    sdk::ClientOptions options;
    options.token = tokens_.at(name);
    return *ConnectTo(server_->address(), options);
  }
  std::vector<std::string> SessionsOf(const std::string& name) {
    std::vector<std::string> ids;
    const auto sessions = Connect(name)->ListSessions();
    EXPECT_TRUE(sessions.ok()) << sessions.status();
    for (const auto& session : *sessions)
      ids.push_back(session.spec.session_id);
    return ids;
  }
  std::vector<std::string> MapsOf(const std::string& name) {
    std::vector<std::string> names;
    const auto maps = Connect(name)->ListMaps();
    EXPECT_TRUE(maps.ok()) << maps.status();
    for (const auto& map : *maps) names.push_back(map.name);
    return names;
  }
  void Import(const std::string& name, const std::string& map) {
    const auto imported = Connect(name)->ImportMap(
        WriteForImport(directory_.path(), map, TextModel()));
    ASSERT_TRUE(imported.ok()) << imported.status();
  }
  RawAnswer Call(const std::string& name,
                 const google::protobuf::MethodDescriptor& method,
                 const std::string& session,
                 const std::string& map) {
    const auto request = NewMessage(*method.input_type());
    NameObjects(*request, session, map);
    return CallRaw(RawChannel(server_->address()),
                   PathOf(method),
                   "Bearer " + tokens_.at(name),
                   {request->SerializeAsString()});
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path file_ = directory_.path() / "tokens";
  std::map<std::string, std::string> tokens_;
  std::unique_ptr<TestServer> server_;
};

TEST_F(TenantsTest, WhatIsAnotherTenantsDoesNotExist) {
  Add("ours", "acme", {"admin"});
  Add("theirs", "rival", {"admin"});
  Add("nameless", "", {"admin"});
  Start();
  Import("ours", "yard");
  ASSERT_TRUE(Connect("ours")->CreateSession(Spec("drive")).ok());
  for (const char* stranger : {"theirs", "nameless"}) {
    EXPECT_THAT(MapsOf(stranger), IsEmpty());
    EXPECT_THAT(SessionsOf(stranger), IsEmpty());
    for (const auto* method : EveryMethod()) {
      // What makes something would make it, and is tried below.
      if (method->name() == "CreateSession") continue;
      const RawAnswer there = Call(stranger, *method, "drive", "yard");
      const RawAnswer nowhere = Call(stranger, *method, "never", "ever_");
      EXPECT_EQ(there.status.error_code(), nowhere.status.error_code())
          << method->name();
      EXPECT_EQ(absl::StrReplaceAll(there.status.error_message(),
                                    {{"drive", "never"}, {"yard", "ever_"}}),
                nowhere.status.error_message())
          << method->name();
      EXPECT_EQ(there.messages, nowhere.messages) << method->name();
      // Nor is it there under the name that the store has for it.
      const RawAnswer stored =
          Call(stranger, *method, "acme@drive", "acme@yard");
      EXPECT_TRUE(!stored.status.ok() || stored.messages == nowhere.messages)
          << method->name();
    }
  }
  EXPECT_THAT(MapsOf("ours"), ElementsAre("yard"));
  EXPECT_THAT(SessionsOf("ours"), ElementsAre("drive"));
}

TEST_F(TenantsTest, NamesAreEachTenantsOwn) {
  Add("ours", "acme", {"admin"});
  Add("theirs", "rival", {"admin"});
  Start();
  Import("ours", "yard");
  Import("ours", "yard");
  Import("theirs", "yard");
  EXPECT_EQ(Connect("ours")->GetMap("yard", 0)->version, 2U);
  EXPECT_EQ(Connect("theirs")->GetMap("yard", 0)->version, 1U);
  ASSERT_TRUE(Connect("ours")->CreateSession(Spec("drive")).ok());
  ASSERT_TRUE(Connect("theirs")->CreateSession(Spec("drive")).ok());
  ASSERT_TRUE(Connect("theirs")->DeleteSession("drive").ok());
  ASSERT_TRUE(Connect("theirs")->DeleteMap("yard").ok());
  EXPECT_THAT(MapsOf("theirs"), IsEmpty());
  EXPECT_THAT(MapsOf("ours"), ElementsAre("yard"));
  EXPECT_THAT(SessionsOf("ours"), ElementsAre("drive"));
}

TEST_F(TenantsTest, SessionsAreTheirOwners) {
  Add("owner", "acme", {"sessions:own"});
  Add("other", "acme", {"sessions:own"});
  Add("watcher", "acme", {"sessions:watch"});
  Add("watching-owner", "acme", {"sessions:watch", "sessions:own"});
  Add("chief", "acme", {"sessions:all"});
  Start();
  const auto owner = Connect("owner");
  ASSERT_TRUE(owner->CreateSession(Spec("drive")).ok());
  EXPECT_THAT(SessionsOf("owner"), ElementsAre("drive"));
  EXPECT_THAT(SessionsOf("other"), IsEmpty());
  EXPECT_THAT(SessionsOf("watcher"), ElementsAre("drive"));
  EXPECT_THAT(SessionsOf("chief"), ElementsAre("drive"));

  using grpc::StatusCode;
  struct Role {
    const char* name;
    StatusCode acts;
    StatusCode sees;
  };
  // Acting is answered as far as to what the empty request lacks.
  for (const Role& role :
       {Role{"other", StatusCode::NOT_FOUND, StatusCode::NOT_FOUND},
        Role{"watcher", StatusCode::PERMISSION_DENIED, StatusCode::OK},
        Role{"watching-owner", StatusCode::PERMISSION_DENIED, StatusCode::OK},
        Role{"chief", StatusCode::INVALID_ARGUMENT, StatusCode::OK},
        Role{"owner", StatusCode::INVALID_ARGUMENT, StatusCode::OK}}) {
    for (const auto* method : EveryMethod()) {
      const std::string& name = method->name();
      if (name == "SetTarget" || name == "MoveTarget") {
        EXPECT_EQ(Call(role.name, *method, "drive", "").status.error_code(),
                  role.acts)
            << role.name << " " << name;
      } else if (name == "GetSession") {
        EXPECT_EQ(Call(role.name, *method, "drive", "").status.error_code(),
                  role.sees)
            << role.name << " " << name;
      }
    }
    const bool acts = role.acts == StatusCode::INVALID_ARGUMENT;
    EXPECT_EQ(Connect(role.name)->Track("drive").ok(), acts) << role.name;
    EXPECT_EQ(Connect(role.name)->Watch("drive", false).ok(),
              role.sees == StatusCode::OK)
        << role.name;
    if (!acts) {
      EXPECT_FALSE(Connect(role.name)->DeleteSession("drive").ok());
    }
  }
  v1::GetSessionResponse response;
  for (const auto* method : EveryMethod()) {
    if (method->name() != "GetSession") continue;
    const RawAnswer answer = Call("watcher", *method, "drive", "");
    ASSERT_TRUE(response.ParseFromString(answer.messages.at(0)));
  }
  EXPECT_EQ(response.session().owner(), "owner");
  EXPECT_TRUE(Connect("chief")->DeleteSession("drive").ok());
}

}  // namespace
}  // namespace groundlock::test
