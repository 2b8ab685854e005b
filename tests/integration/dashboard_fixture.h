// SPDX-License-Identifier: Apache-2.0
// A dashboard's proxy before a real server, for pages without a browser.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_DASHBOARD_FIXTURE_H_
#define GROUNDLOCK_TESTS_INTEGRATION_DASHBOARD_FIXTURE_H_

#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "client/dashboard/proxy/dashboard.h"
#include "map_store/base/file.h"
#include "tests/integration/browser.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {

// A server with a session whose frames are answered at once, without work.
struct ServerWithSession {
  explicit ServerWithSession(const sdk::SessionSpec& spec = Spec("drive")) {
    gate.OpenForGood();
    EXPECT_TRUE(client->CreateSession(spec).ok());
  }

  Gate gate;
  TestServer server{{}, GatedCores(&gate)};
  decltype(server.Connect()) client = server.Connect();
};

// A box around a SquareImage's square.
inline v1::Box2 SquareBox(int x, int y) {
  v1::Box2 box;
  box.set_x(x);
  box.set_y(y);
  box.set_width(24);
  box.set_height(24);
  return box;
}

class DashboardTest : public ::testing::Test {
 protected:
  void Start(TestServer& server) {
    options_.listen = "127.0.0.1:0";
    options_.server.target = server.address();
    options_.web = directory_.path() / "web";
    options_.recordings = directory_.path() / "recordings";
    options_.uploads = directory_.path() / "uploads";
    options_.token = token_;
    options_.poll_interval = std::chrono::milliseconds(50);
    auto dashboard = dashboard::Dashboard::Start(options_);
    ASSERT_TRUE(dashboard.ok()) << dashboard.status();
    dashboard_ = *std::move(dashboard);
    // It serves once it knows whether the server wants a token.
    ASSERT_TRUE(Eventually([&] {
      return Fetch(port(), boost::beast::http::verb::get, "/api/info")
                 .body()
                 .find("\"login_required\":null") == std::string::npos;
    }));
  }
  int port() const { return dashboard_->port(); }
  // The id of a new upload that waits for a video.
  std::string NewVideoUpload(const std::string& name) const {
    const HttpResponse created =
        Fetch(port(),
              boost::beast::http::verb::post,
              "/api/uploads",
              {},
              R"({"kind":"video","name":")" + name + R"("})");
    EXPECT_EQ(created.result_int(), 201U);
    const std::string& body = created.body();
    return body.substr(body.find(':') + 2, 32);
  }
  void WriteWeb(const std::string& name, const std::string& text) {
    const std::filesystem::path path = directory_.path() / "web" / name;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream(path) << text;
  }

  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  dashboard::DashboardOptions options_;
  std::string token_;  // the dashboard's own
  std::unique_ptr<dashboard::Dashboard> dashboard_;
};

inline pb::ClientMessage Subscribe(const std::string& session,
                                   bool images = true) {
  pb::ClientMessage message;
  message.mutable_subscribe()->set_session_id(session);
  message.mutable_subscribe()->set_include_images(images);
  return message;
}

inline bool IsLive(const pb::ServerMessage& message) {
  return message.subscription_state().state() ==
         pb::SubscriptionState::STATE_LIVE;
}

// A page that watches the session and knows it.
inline std::unique_ptr<Page> Watching(int port, const std::string& session) {
  auto page = std::make_unique<Page>(port);
  EXPECT_EQ(page->status(), 101);
  EXPECT_TRUE(page->Ask(Subscribe(session)).has_subscribed());
  EXPECT_TRUE(page->ReadUntil(IsLive).has_value());
  return page;
}

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_DASHBOARD_FIXTURE_H_
