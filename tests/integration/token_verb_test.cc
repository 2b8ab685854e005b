// SPDX-License-Identifier: Apache-2.0
// groundlock token, and the server program that reads what it writes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "tests/integration/command_line.h"
#include "tests/integration/program.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

TEST(TokenVerb, WhoIsCreatedMayCallAndWhoIsRevokedMayNot) {
  const CommandLine local("");
  const std::string file = (local.path() / "tokens").string();
  const auto create = [&](const std::string& name, const std::string& scopes) {
    EXPECT_EQ(local.Run({"token",
                         "create",
                         "--file",
                         file,
                         "--scopes",
                         scopes,
                         "--tenant",
                         "acme",
                         "--sessions",
                         "2",
                         name}),
              0)
        << local.Read("err");
    const std::string token = local.Read("out");
    const fs::path kept = local.path() / (name + ".token");
    std::ofstream(kept) << token;
    fs::permissions(kept, fs::perms::owner_read | fs::perms::owner_write);
    EXPECT_THAT(local.Read("tokens"),
                Not(HasSubstr(token.substr(0, token.find('\n')))));
    return kept.string();
  };
  const std::string reader = create("reader", "maps:read");
  const std::string watcher = create("watcher", "sessions:watch");
  EXPECT_NE(
      local.Run(
          {"token", "create", "--file", file, "--scopes", "admin", "reader"}),
      0);
  EXPECT_THAT(local.Read("err"), HasSubstr("reader"));
  EXPECT_NE(
      local.Run(
          {"token", "create", "--file", file, "--scopes", "maps:all", "x"}),
      0);
  EXPECT_THAT(local.Read("err"), HasSubstr("maps:all"));
  ASSERT_EQ(local.Run({"token",
                       "create",
                       "--file",
                       file,
                       "--scopes",
                       "admin",
                       "--certificate",
                       "cn:ops.example",
                       "ops"}),
            0);
  EXPECT_EQ(local.Read("out"), "");
  ASSERT_EQ(local.Run({"token", "list", "--file", file}), 0);
  EXPECT_EQ(local.Read("out"),
            "reader  maps:read  token  tenant acme\n"
            "watcher  sessions:watch  token  tenant acme\n"
            "ops  admin  cn:ops.example\n");

  Program server({"--listen",
                  "127.0.0.1:0",
                  "--store",
                  "@TMP@/store",
                  "--token-file",
                  file});
  const int port = server.PortAfter("listening on 127.0.0.1:");
  const CommandLine remote("127.0.0.1:" + std::to_string(port));
  EXPECT_EQ(remote.Run({"map", "list", "--token-file", reader}), 0)
      << remote.Read("err");
  EXPECT_NE(remote.Run({"map", "list", "--token-file", watcher}), 0);
  EXPECT_THAT(remote.Read("err"), HasSubstr("watcher may not call ListMaps"));
  EXPECT_NE(remote.Run({"map", "list"}), 0);
  EXPECT_NE(remote.Run({"map", "delete", "yard", "--token-file", reader}), 0);

  ASSERT_EQ(local.Run({"token", "revoke", "--file", file, "reader"}), 0);
  server.Signal(SIGHUP);
  EXPECT_TRUE(Eventually([&] {
    return server.Log().find("SIGHUP") != std::string::npos &&
           server.Log().find("2 tokens and certificates") != std::string::npos;
  })) << server.Log();
  EXPECT_NE(remote.Run({"map", "list", "--token-file", reader}), 0);
  EXPECT_THAT(remote.Read("err"), HasSubstr("not known"));
  EXPECT_NE(local.Run({"token", "revoke", "--file", file, "reader"}), 0);
}

}  // namespace
}  // namespace groundlock::test
