// SPDX-License-Identifier: Apache-2.0
#include "server/service/access.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "map_store/base/file.h"

namespace groundlock::service {
namespace {

using ::testing::HasSubstr;

namespace fs = std::filesystem;

TEST(Access, WithoutTokensEverybodyMayCall) {
  const auto access = Access::FromTokens({});
  EXPECT_TRUE(access->open_to_all());
  for (const char* header : {"", "Bearer whatever"}) {
    const auto principal = access->AuthenticateHeader(header);
    ASSERT_TRUE(principal.ok());
    EXPECT_TRUE((*principal)->May(Scope::kMapsWrite));
  }
}

TEST(Access, OtherwiseOnlyThoseThatKnowOne) {
  const auto access =
      Access::FromTokens({"first-token-0123456", "second-token-012345"});
  EXPECT_TRUE(access->AuthenticateHeader("Bearer first-token-0123456").ok());
  EXPECT_TRUE(access->AuthenticateHeader("Bearer second-token-012345").ok());
  for (const char* header : {"",
                             "Bearer ",
                             "Bearer first-token-012345",
                             "Bearer first-token-01234567",
                             "Bearer First-token-0123456",
                             "bearer first-token-0123456",
                             "Basic first-token-0123456",
                             "first-token-0123456"}) {
    EXPECT_EQ(access->AuthenticateHeader(header).status().code(),
              absl::StatusCode::kUnauthenticated)
        << header;
  }
}

class AccessFile : public ::testing::Test {
 protected:
  void Write(const std::string& text) {
    std::ofstream(path_) << text;
    fs::permissions(path_, fs::perms::owner_read | fs::perms::owner_write);
  }
  // Time passes, so that the file is looked at again.
  void Look(Access& access) {
    now_ += std::chrono::seconds(3);
    access.OnTick(now_);
  }
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path path_ = directory_.path() / "tokens";
  std::chrono::steady_clock::time_point now_ = std::chrono::steady_clock::now();
};

TEST_F(AccessFile, TokensThatComeAndGoCountWithoutARestart) {
  const std::string first = *base::CreateToken(path_, "first", {"admin"});
  const auto access = *Access::FromFile(path_);
  const auto knows = [&access](const std::string& token) {
    return access->AuthenticateHeader("Bearer " + token).ok();
  };
  EXPECT_TRUE(knows(first));
  const std::string second =
      *base::CreateToken(path_, "second", {"sessions:watch"});
  EXPECT_FALSE(knows(second)) << "the file has not been looked at yet";
  Look(*access);
  EXPECT_TRUE(knows(first));
  EXPECT_TRUE(knows(second));
  ASSERT_TRUE(base::RevokeToken(path_, "first").ok());
  Look(*access);
  EXPECT_FALSE(knows(first));
  EXPECT_TRUE(knows(second));
  Write("damaged by a slip of the hand\n");
  Look(*access);
  EXPECT_TRUE(knows(second)) << "what was read before holds on";
  Write("");
  Look(*access);
  EXPECT_FALSE(knows(second)) << "an empty file lets nobody in";
}

TEST_F(AccessFile, ScopesIncludeWhatTheySay) {
  const auto scopes_of = [this](const std::vector<std::string>& scopes) {
    fs::remove(path_);
    const std::string token = *base::CreateToken(path_, "somebody", scopes);
    const auto access = *Access::FromFile(path_);
    const auto principal = *access->AuthenticateHeader("Bearer " + token);
    EXPECT_EQ(principal->name, "somebody");
    std::string may;
    if (principal->May(Scope::kMapsRead)) may += "r";
    if (principal->May(Scope::kMapsWrite)) may += "w";
    if (principal->May(Scope::kSessionsWatch)) may += "l";
    if (principal->May(Scope::kSessionsAll)) may += "a";
    return may;
  };
  EXPECT_EQ(scopes_of({"maps:read"}), "r");
  EXPECT_EQ(scopes_of({"maps:write"}), "rw");
  EXPECT_EQ(scopes_of({"sessions:watch"}), "l");
  EXPECT_EQ(scopes_of({"sessions:all"}), "la");
  EXPECT_EQ(scopes_of({"maps:read", "sessions:watch"}), "rl");
  EXPECT_EQ(scopes_of({"admin"}), "rwla");
}

TEST_F(AccessFile, MustHoldATokenWhenTheServerStarts) {
  Write("# nothing\n");
  EXPECT_EQ(Access::FromFile(path_).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(Access::FromFile(path_ / "none").status().ToString(),
              HasSubstr("none"));
}

}  // namespace
}  // namespace groundlock::service
