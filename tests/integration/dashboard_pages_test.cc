// SPDX-License-Identifier: Apache-2.0
// Who gets the dashboard's page, and how far strange, rude and too many pages
// come.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <list>
#include <string>

#include "tests/integration/dashboard_fixture.h"
#include "tests/integration/raw_connection.h"

namespace groundlock::test {
namespace {

using boost::beast::http::verb;
using ::testing::HasSubstr;
using ::testing::StartsWith;

TEST_F(DashboardTest, CountsWhatItDoesForPrometheusAlone) {
  TestServer server;
  options_.metrics = "127.0.0.1:0";
  ASSERT_NO_FATAL_FAILURE(Start(server));
  ASSERT_NE(dashboard_->metrics_port(), 0);
  const auto metrics = [this] {
    return Fetch(dashboard_->metrics_port(), verb::get, "/metrics").body();
  };
  EXPECT_TRUE(Eventually([&] {
    return metrics().find("groundlock_dashboard_server_connected 1") !=
           std::string::npos;
  }));
  EXPECT_EQ(Fetch(port(), verb::get, "/metrics").result_int(), 404U)
      << "not for viewers";
  EXPECT_THAT(metrics(),
              testing::AllOf(
                  testing::HasSubstr("groundlock_dashboard_viewers 0"),
                  testing::HasSubstr("groundlock_dashboard_feeds 0"),
                  testing::HasSubstr("groundlock_dashboard_sources 0"),
                  testing::HasSubstr("groundlock_dashboard_map_jobs 0"),
                  testing::HasSubstr(
                      "groundlock_dashboard_answers_total{status=\"4xx\"} 1")));
}

TEST_F(DashboardTest, ServesThePageWithItsHeaders) {
  TestServer server;
  WriteWeb("index.html", "<h1>page</h1>");
  WriteWeb("assets/app.js", "let a = 1;");
  WriteWeb("assets/app.js.gz", "compressed");
  WriteWeb(".secret", "secret");
  Start(server);
  EXPECT_EQ(Fetch(port(), verb::get, "/healthz").body(), "ok\n");
  const HttpResponse page = Fetch(port(), verb::get, "/");
  EXPECT_EQ(page.result_int(), 200U);
  EXPECT_EQ(page.body(), "<h1>page</h1>");
  EXPECT_EQ(page["X-Content-Type-Options"], "nosniff");
  EXPECT_EQ(page["Cache-Control"], "no-cache");
  EXPECT_THAT(std::string(page["Content-Security-Policy"]),
              StartsWith("default-src 'self';"));
  const std::string etag(page["ETag"]);
  ASSERT_FALSE(etag.empty());
  const HttpResponse again =
      Fetch(port(), verb::get, "/index.html", {{"If-None-Match", etag}});
  EXPECT_EQ(again.result_int(), 304U);
  EXPECT_EQ(again.body(), "");
  const HttpResponse script = Fetch(
      port(), verb::get, "/assets/app.js", {{"Accept-Encoding", "gzip, br"}});
  EXPECT_EQ(script.body(), "compressed");
  EXPECT_EQ(script["Content-Encoding"], "gzip");
  EXPECT_THAT(std::string(script["Cache-Control"]), HasSubstr("immutable"));
  EXPECT_EQ(Fetch(port(), verb::get, "/assets/app.js").body(), "let a = 1;");
  const HttpResponse head = Fetch(port(), verb::head, "/");
  EXPECT_EQ(head["Content-Length"], "13");
  EXPECT_EQ(head.body(), "");
  for (const char* target : {"/.secret", "/nothing", "/assets", "/assets/"}) {
    EXPECT_EQ(Fetch(port(), verb::get, target).result_int(), 404U) << target;
  }
  EXPECT_EQ(Fetch(port(), verb::get, "/%2e%2e/recordings").result_int(), 400U);
  EXPECT_EQ(Fetch(port(), verb::post, "/").result_int(), 405U);
  EXPECT_EQ(Fetch(port(), verb::get, "/api/nothing").result_int(), 404U);
  EXPECT_EQ(
      Fetch(port(), verb::get, "/", {{"Host", "evil.example"}}).result_int(),
      421U);
}

TEST_F(DashboardTest, SaysSoIfThePageWasNotBuilt) {
  TestServer server;
  Start(server);
  const HttpResponse page = Fetch(port(), verb::get, "/");
  EXPECT_EQ(page.result_int(), 404U);
  EXPECT_THAT(page.body(), HasSubstr("groundlock_web"));
}

TEST_F(DashboardTest, StrangePagesGetNoFurther) {
  TestServer server;
  options_.allowed_origins = {"https://dash.example.org"};
  options_.viewers.max_message_bytes = 4'096;
  options_.viewers.max_requests_per_s = 5;
  Start(server);
  EXPECT_EQ(Page(port(), {{"Origin", "http://evil.example"}}).status(), 403);
  EXPECT_EQ(Page(port(), {{"Host", "evil.example"}}).status(), 421);
  EXPECT_EQ(Page(port(), {{"Origin", "https://dash.example.org"}}).status(),
            101);
  EXPECT_EQ(
      Page(port(), {{"Origin", "http://127.0.0.1:" + std::to_string(port())}})
          .status(),
      101);
  EXPECT_EQ(Fetch(port(),
                  verb::post,
                  "/api/uploads",
                  {{"Origin", "http://evil.example"}},
                  R"({"kind":"video","name":"x"})")
                .result_int(),
            403U);
  {
    Page page(port());
    page.SendBytes("\xFF\xFF\xFF");
    const auto error = page.ReadUntil(
        [](const pb::ServerMessage& m) { return m.has_error(); });
    ASSERT_TRUE(error.has_value()) << "the connection lives on";
    EXPECT_EQ(error->error().code(), 3);  // INVALID_ARGUMENT
    pb::ClientMessage ping;
    ping.mutable_ping()->set_client_time_ms(12.5);
    EXPECT_EQ(page.Ask(ping).pong().client_time_ms(), 12.5);
    EXPECT_EQ(page.Ask(Subscribe("nobody")).error().code(), 5);  // NOT_FOUND
  }
  {
    Page page(port());
    page.SendBytes("text", /*binary=*/false);
    EXPECT_FALSE(page.ReadUntil([](const auto&) { return false; }).has_value());
  }
  {
    Page page(port());
    page.SendBytes(std::string(5'000, 'x'));
    EXPECT_FALSE(page.ReadUntil([](const auto&) { return false; }).has_value());
    EXPECT_EQ(page.close_code(), 1009);  // too big
  }
  Page page(port());
  pb::ClientMessage ping;
  ping.mutable_ping();
  for (int i = 0; i < 30; ++i) page.Send(ping);
  const auto refused = page.ReadUntil(
      [](const pb::ServerMessage& message) { return message.has_error(); });
  ASSERT_TRUE(refused.has_value());
  EXPECT_EQ(refused->error().code(), 8);  // RESOURCE_EXHAUSTED
  EXPECT_GT(refused->request_id(), 0U);
}

TEST_F(DashboardTest, TooManyViewersAndSubscriptionsAreRefused) {
  TestServer server;
  const auto client = server.Connect();
  ASSERT_TRUE(client->CreateSession(Spec("a")).ok());
  ASSERT_TRUE(client->CreateSession(Spec("b")).ok());
  options_.viewers.max_viewers = 1;
  options_.viewers.max_subscriptions = 1;
  Start(server);
  Page page(port());
  EXPECT_TRUE(page.Read()->has_hello());
  EXPECT_TRUE(page.Ask(Subscribe("a")).has_subscribed());
  EXPECT_TRUE(page.Ask(Subscribe("a", false)).has_subscribed()) << "anew";
  EXPECT_EQ(page.Ask(Subscribe("b")).error().code(), 8);
  Page second(port());
  EXPECT_FALSE(second.Read().has_value());
  EXPECT_EQ(second.close_code(), 1013);  // try again later
  pb::ClientMessage leave;
  leave.mutable_unsubscribe()->set_session_id("a");
  EXPECT_TRUE(page.Ask(leave).has_done());
  EXPECT_TRUE(page.Ask(Subscribe("b")).has_subscribed());
}

TEST_F(DashboardTest, OneAddressKeepsNobodyElseOut) {
  TestServer server;
  options_.max_connections = 8;
  options_.max_connections_per_address = 4;
  Start(server);
  {
    std::list<RawConnection> silent;
    for (int i = 0; i < 4; ++i) silent.emplace_back(port(), "127.0.0.2");
    const RawConnection fifth(port(), "127.0.0.2");
    EXPECT_TRUE(fifth.EndsWithin(60'000));
    EXPECT_EQ(Fetch(port(), verb::get, "/healthz").body(), "ok\n");
    EXPECT_EQ(Page(port()).status(), 101);
  }
  EXPECT_TRUE(Eventually([&] {
    const RawConnection next(port(), "127.0.0.2");
    return next.Send("GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n") &&
           next.HasAnswer();
  }));
}

TEST_F(DashboardTest, TokensArePassedOnAndNothingIsShownWithoutOne) {
  service::ServerOptions server_options;
  server_options.tokens = {"0123456789abcdef"};
  TestServer server(server_options);
  token_ = "0123456789abcdef";
  Start(server);
  EXPECT_THAT(Fetch(port(), verb::get, "/api/info").body(),
              HasSubstr("\"login_required\":true"));
  EXPECT_EQ(Page(port()).status(), 401);
  EXPECT_EQ(Fetch(port(), verb::get, "/api/recordings/x.mcap").result_int(),
            401U);
  EXPECT_EQ(Fetch(port(), verb::post, "/api/uploads", {}, "{}").result_int(),
            401U);
  const auto login = [&](const std::string& token) {
    return Fetch(
        port(), verb::post, "/api/login", {}, R"({"token":")" + token + "\"}");
  };
  EXPECT_EQ(login("wrong-token-0123").result_int(), 401U);
  EXPECT_EQ(login("").result_int(), 401U);
  EXPECT_EQ(Fetch(port(), verb::post, "/api/login", {}, "{").result_int(),
            400U);
  const HttpResponse welcome = login("0123456789abcdef");
  ASSERT_EQ(welcome.result_int(), 204U);
  const std::string set_cookie(welcome["Set-Cookie"]);
  EXPECT_THAT(set_cookie, HasSubstr("HttpOnly"));
  EXPECT_THAT(set_cookie, HasSubstr("SameSite=Strict"));
  EXPECT_EQ(set_cookie.find("0123456789abcdef"), std::string::npos);
  const Headers headers = {
      {"Cookie", set_cookie.substr(0, set_cookie.find(';'))}};
  Page page(port(), headers);
  ASSERT_EQ(page.status(), 101);
  EXPECT_TRUE(page.ReadUntil([](const pb::ServerMessage& message) {
                    return message.has_sessions();
                  })
                  .has_value());
  EXPECT_EQ(page.Ask(Subscribe("nobody")).error().code(), 5)
      << "the server has let it through";
  EXPECT_EQ(Fetch(port(), verb::post, "/api/logout", headers).result_int(),
            204U);
  EXPECT_EQ(Page(port(), headers).status(), 401);
}

}  // namespace
}  // namespace groundlock::test
