// SPDX-License-Identifier: Apache-2.0
// What each role may do by way of the dashboard: its routes, and its messages.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <set>
#include <string>

#include "map_store/base/token_file.h"
#include "tests/integration/dashboard_fixture.h"
#include "tests/integration/raw_call.h"

namespace groundlock::test {
namespace {

using boost::beast::http::verb;
using ::testing::HasSubstr;
using Roles = std::set<std::string>;

constexpr int kPermissionDenied = 7;

class DashboardRoles : public DashboardTest {
 protected:
  void Add(const std::string& name,
           const std::string& tenant,
           const std::vector<std::string>& scopes) {
    tokens_[name] = *base::CreateToken(file_, {name, tenant, scopes, ""});
  }
  void SetUp() override {
    Add("dashboard", "acme", {"sessions:watch", "maps:read"});
    Add("owner", "acme", {"sessions:own"});
    Add("stranger", "rival", {"admin"});
    Add("viewer", "acme", {"sessions:watch", "maps:read"});
    Add("starter", "acme", {"sessions:watch", "sessions:own", "maps:read"});
    Add("mapper", "acme", {"sessions:watch", "maps:write"});
    Add("chief", "acme", {"sessions:all", "maps:write"});
    service::ServerOptions options;
    options.token_file = file_.string();
    server_ = std::make_unique<TestServer>(options);
    sdk::ClientOptions owner;
    owner.token = tokens_["owner"];
    const auto client = ConnectTo(server_->address(), owner);
    ASSERT_TRUE((*client)->CreateSession(Spec("drive")).ok());
  }
  void StartDashboard() {
    token_ = tokens_["dashboard"];
    Start(*server_);
    ASSERT_TRUE(Eventually([this] {
      return Fetch(port(), verb::get, "/api/info")
                 .body()
                 .find(R"("server_state":"connected")") != std::string::npos;
    }));
  }
  HttpResponse Login(const std::string& name) {
    return Fetch(port(),
                 verb::post,
                 "/api/login",
                 {},
                 R"({"token":")" + tokens_[name] + "\"}");
  }
  Headers Cookie(const std::string& name) {
    const HttpResponse welcome = Login(name);
    EXPECT_EQ(welcome.result_int(), 204U) << name << welcome.body();
    const std::string cookie(welcome["Set-Cookie"]);
    return {{"Cookie", cookie.substr(0, cookie.find(';'))}};
  }

  const std::filesystem::path file_ = directory_.path() / "tokens";
  std::map<std::string, std::string> tokens_;
  std::unique_ptr<TestServer> server_;
};

const Roles kEverybody = {"viewer", "starter", "mapper", "chief"};
const Roles kUploaders = {"starter", "mapper", "chief"};
const Roles kChief = {"chief"};

TEST_F(DashboardRoles, OnlyThoseLogInWhoMaySeeWhatIsShown) {
  StartDashboard();
  EXPECT_EQ(Login("owner").result_int(), 403U);
  EXPECT_THAT(Login("owner").body(), HasSubstr("sessions:watch"));
  EXPECT_EQ(Login("stranger").result_int(), 403U);
  EXPECT_THAT(Login("stranger").body(), HasSubstr("another tenant"));
  for (const std::string& role : kEverybody) {
    EXPECT_EQ(Login(role).result_int(), 204U) << role;
  }
}

TEST_F(DashboardRoles, EveryRouteWithEveryRole) {
  StartDashboard();
  struct Route {
    verb method;
    const char* target;
    const char* body;
    unsigned answer;  // to those who may
    Roles roles;
  };
  const Route routes[] = {
      {verb::post,
       "/api/uploads",
       R"({"kind":"video","name":"x"})",
       201U,
       kUploaders},
      {verb::put,
       "/api/uploads/0123456789abcdef0123456789abcdef/x",
       "x",
       404U,
       kUploaders},
      {verb::delete_,
       "/api/uploads/0123456789abcdef0123456789abcdef",
       "",
       404U,
       kUploaders},
      {verb::get, "/api/recordings/x.mcap", "", 404U, kEverybody},
      {verb::get,
       "/api/recordings/x/trajectory?format=csv",
       "",
       404U,
       kEverybody},
      {verb::get,
       "/api/sessions/drive/trajectory?format=csv",
       "",
       404U,
       kEverybody},
      {verb::get, "/api/nothing", "", 404U, kEverybody},
  };
  std::map<std::string, Headers> cookies;
  for (const std::string& role : kEverybody) cookies[role] = Cookie(role);
  for (const Route& route : routes) {
    EXPECT_EQ(
        Fetch(port(), route.method, route.target, {}, route.body).result_int(),
        401U)
        << route.target;
    for (const auto& [role, cookie] : cookies) {
      EXPECT_EQ(Fetch(port(), route.method, route.target, cookie, route.body)
                    .result_int(),
                route.roles.contains(role) ? route.answer : 403U)
          << route.target << " as " << role;
    }
  }
  EXPECT_EQ(Page(port()).status(), 401);
}

// What the proxy looks at before it asks who may do it.
void MakeValid(pb::ClientMessage& message) {
  if (message.has_set_target()) {
    *message.mutable_set_target()->mutable_box() = SquareBox(20, 40);
  } else if (message.has_move_target()) {
    *message.mutable_move_target()->mutable_box() = SquareBox(20, 40);
  } else if (message.has_control_source()) {
    message.mutable_control_source()->set_action(
        pb::ControlSource::ACTION_STOP);
  } else if (message.has_start_session()) {
    message.mutable_start_session()->set_source_id("none");
  } else if (message.has_import_map()) {
    message.mutable_import_map()->set_upload_id("none");
  } else if (message.has_build_map()) {
    message.mutable_build_map()->set_upload_id("none");
  }
}

TEST_F(DashboardRoles, EveryMessageWithEveryRole) {
  StartDashboard();
  // The session is another's.
  const Roles maps = {"mapper", "chief"};
  const Roles nobody;
  const std::map<std::string, Roles> wanted = {
      {"ping", kEverybody},
      {"subscribe", kEverybody},
      {"unsubscribe", kEverybody},
      {"get_point_cloud", kEverybody},
      {"set_target", kChief},
      {"move_target", kChief},
      {"drop_target", kChief},
      {"delete_map", maps},
      {"align_map", maps},
      {"check_map", kEverybody},
      {"start_session", {"starter", "chief"}},
      {"control_source", kChief},
      {"start_recording", kChief},
      {"stop_recording", kChief},
      {"delete_recording", kChief},
      {"import_map", maps},
      {"build_map", maps},
      {"cancel", kEverybody},
      {"image_taken", nobody},  // has no reply
      {"delete_session", kChief},
  };
  const auto* requests =
      pb::ClientMessage::descriptor()->FindOneofByName("request");
  ASSERT_NE(requests, nullptr);
  EXPECT_EQ(static_cast<std::size_t>(requests->field_count()), wanted.size());
  // The chief comes last: the chief's messages do what they say.
  for (const char* role : {"viewer", "starter", "mapper", "chief"}) {
    Page page(port(), Cookie(role));
    ASSERT_EQ(page.status(), 101);
    for (const auto& [name, roles] : wanted) {
      const auto* field =
          pb::ClientMessage::descriptor()->FindFieldByName(name);
      ASSERT_NE(field, nullptr) << name;
      if (name == "image_taken") continue;
      // Last of all, since there is no session after it.
      if (name == "delete_session") continue;
      pb::ClientMessage message;
      NameObjects(*message.GetReflection()->MutableMessage(&message, field),
                  "drive",
                  "yard");
      MakeValid(message);
      const pb::ServerMessage reply = page.Ask(message);
      EXPECT_EQ(reply.error().code() == kPermissionDenied,
                !roles.contains(role))
          << name << " as " << role << ": " << reply.ShortDebugString();
    }
    pb::ClientMessage end;
    end.mutable_delete_session()->set_session_id("drive");
    EXPECT_EQ(page.Ask(end).has_done(), kChief.contains(role)) << role;
  }
}

TEST_F(DashboardRoles, ShowsNothingWhileTheServerDoesNotKnowIt) {
  Start(*server_);
  EXPECT_EQ(Login("chief").result_int(), 503U);
  EXPECT_THAT(Login("chief").body(), HasSubstr("--token-file"));
  EXPECT_EQ(Page(port()).status(), 401);
}

TEST_F(DashboardRoles, ATokenThatGoesLogsItsViewersOut) {
  StartDashboard();
  const Headers goes = Cookie("viewer");
  const Headers stays = Cookie("chief");
  Page page(port(), goes);
  ASSERT_EQ(page.status(), 101);
  ASSERT_TRUE(base::RevokeToken(file_, "viewer").ok());
  const auto last = page.ReadUntil([](const pb::ServerMessage& message) {
    return message.server_state().state() ==
           pb::ServerState::STATE_UNAUTHENTICATED;
  });
  EXPECT_TRUE(last.has_value());
  EXPECT_EQ(Page(port(), goes).status(), 401);
  EXPECT_EQ(Page(port(), stays).status(), 101);
}

TEST_F(DashboardRoles, UploadsAreTheirOwners) {
  StartDashboard();
  const Headers owner = Cookie("starter");
  const std::string body = Fetch(port(),
                                 verb::post,
                                 "/api/uploads",
                                 owner,
                                 R"({"kind":"video","name":"x"})")
                               .body();
  const std::string target =
      "/api/uploads/" + body.substr(body.find(':') + 2, 32);
  const auto ask = [&](verb method, const std::string& path, const char* role) {
    return Fetch(port(), method, path, Cookie(role), "x").result_int();
  };
  EXPECT_EQ(ask(verb::put, target + "/a.mp4", "starter"), 201U);
  EXPECT_EQ(ask(verb::put, target + "/b.mp4", "mapper"), 403U);
  EXPECT_EQ(ask(verb::delete_, target, "mapper"), 403U);
  EXPECT_EQ(ask(verb::put, target + "/b.mp4", "chief"), 201U);
  EXPECT_EQ(ask(verb::delete_, target, "starter"), 204U);
}

bool IsLoggedOut(const pb::ServerMessage& message) {
  return message.server_state().state() ==
         pb::ServerState::STATE_UNAUTHENTICATED;
}

// Results come by the dashboard's own identity: whoever stayed would see them
// for as long as the connection lasts, token or not.
TEST_F(DashboardRoles, LoggingOutEndsThePagesOfThatLogIn) {
  StartDashboard();
  const Headers cookie = Cookie("viewer");
  const Headers elsewhere = Cookie("viewer");
  Page page(port(), cookie);
  Page other(port(), elsewhere);
  ASSERT_EQ(page.status(), 101);
  ASSERT_EQ(other.status(), 101);
  EXPECT_EQ(Fetch(port(), verb::post, "/api/logout", cookie).result_int(),
            204U);
  EXPECT_TRUE(page.ReadUntil(IsLoggedOut).has_value());
  EXPECT_EQ(Page(port(), cookie).status(), 401);
  pb::ClientMessage ping;
  ping.mutable_ping();
  EXPECT_TRUE(other.Ask(ping).has_pong()) << "the same person elsewhere";
}

TEST_F(DashboardRoles, WhoLooksOnIsAskedAboutThoughItsLogInMadeRoom) {
  options_.max_logins = 2;
  StartDashboard();
  const Headers cookie = Cookie("viewer");
  Page page(port(), cookie);
  ASSERT_EQ(page.status(), 101);
  // The handshake's reply comes before the page is among those who look on:
  // a log-in that is gone by then ends it at once.
  pb::ClientMessage ping;
  ping.mutable_ping();
  ASSERT_TRUE(page.Ask(ping).has_pong());
  Cookie("chief");
  Cookie("mapper");
  EXPECT_EQ(Page(port(), cookie).status(), 401);
  ASSERT_TRUE(base::RevokeToken(file_, "viewer").ok());
  EXPECT_TRUE(page.ReadUntil(IsLoggedOut).has_value());
}

}  // namespace
}  // namespace groundlock::test
