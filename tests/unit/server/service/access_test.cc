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

AccessOptions OfFile(const fs::path& path) {
  AccessOptions options;
  options.token_file = path;
  return options;
}

TEST(Access, WithoutTokensEverybodyMayCall) {
  const auto access = *Access::Create({});
  EXPECT_TRUE(access->open_to_all());
  for (const char* header : {"", "Bearer whatever"}) {
    const auto principal = access->AuthenticateHeader(header);
    ASSERT_TRUE(principal.ok());
    EXPECT_TRUE((*principal)->May(Scope::kMapsWrite));
  }
  EXPECT_TRUE(access->AuthenticateSubjects({}).ok());
}

TEST(Access, OtherwiseOnlyThoseThatKnowOne) {
  AccessOptions options;
  options.tokens = {"first-token-0123456", "second-token-012345"};
  const auto access = *Access::Create(options);
  EXPECT_TRUE(access->AuthenticateHeader("Bearer first-token-0123456").ok());
  EXPECT_TRUE(access->AuthenticateHeader("Bearer second-token-012345").ok());
  for (const char* header : {"",
                             "Bearer ",
                             "Bearer first-token-012345",
                             "Bearer first-token-01234567",
                             "Bearer  first-token-0123456",
                             "bearer first-token-0123456",
                             "Basic first-token-0123456",
                             "first-token-0123456"}) {
    EXPECT_EQ(access->AuthenticateHeader(header).status().code(),
              absl::StatusCode::kUnauthenticated)
        << header;
  }
  EXPECT_FALSE(access->AuthenticateSubjects({}).ok());
  EXPECT_FALSE(access->AuthenticateSubjects({"cn:token-1"}).ok());
}

class AccessFile : public ::testing::Test {
 protected:
  void Write(const std::string& text) {
    std::ofstream(path_) << text;
    fs::permissions(path_, fs::perms::owner_read | fs::perms::owner_write);
  }
  std::string Add(const std::string& name,
                  const std::vector<std::string>& scopes,
                  const std::string& credential = "") {
    return *base::CreateToken(path_, {name, "", scopes, credential});
  }
  std::unique_ptr<Access> Open() { return *Access::Create(OfFile(path_)); }
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
  const std::string first = Add("first", {"admin"});
  const auto access = Open();
  const auto find = [&access](const std::string& token) {
    return access->AuthenticateHeader("Bearer " + token);
  };
  const auto first_caller = find(first);
  EXPECT_TRUE(first_caller.ok());
  const std::string second = Add("second", {"sessions:watch"});
  EXPECT_FALSE(find(second).ok()) << "the file has not been looked at yet";
  Look(*access);
  EXPECT_EQ(*find(first), *first_caller) << "the same as before";
  ASSERT_TRUE(find(second).ok());
  const auto second_caller = *find(second);
  ASSERT_TRUE(base::RevokeToken(path_, "first").ok());
  Look(*access);
  EXPECT_FALSE(find(first).ok());
  EXPECT_FALSE((*first_caller)->CheckValid().ok());
  EXPECT_TRUE(second_caller->CheckValid().ok());
  Write("damaged by a slip of the hand\n");
  Look(*access);
  EXPECT_TRUE(find(second).ok()) << "what was read before holds on";
  Write("");
  Look(*access);
  EXPECT_FALSE(find(second).ok()) << "an empty file lets nobody in";
  EXPECT_FALSE(second_caller->CheckValid().ok());
}

TEST_F(AccessFile, ASignalReadsItAtOnce) {
  const std::string first = Add("first", {"admin"});
  const auto access = Open();
  ASSERT_TRUE(base::RevokeToken(path_, "first").ok());
  access->Reload();
  EXPECT_FALSE(access->AuthenticateHeader("Bearer " + first).ok());
}

TEST_F(AccessFile, WhoeverMayDoOtherThingsIsAnother) {
  const std::string token = Add("somebody", {"admin"});
  const auto access = Open();
  const auto before = *access->AuthenticateHeader("Bearer " + token);
  std::string text = *base::ReadFile(path_, 1 << 20);
  text.replace(text.find("admin"), 5, "maps:read");
  Write(text);
  Look(*access);
  EXPECT_FALSE(before->CheckValid().ok());
  const auto after = *access->AuthenticateHeader("Bearer " + token);
  EXPECT_FALSE(after->May(Scope::kMapsWrite));
}

TEST_F(AccessFile, CertificatesAreKnownByWhatTheySay) {
  Add("camera", {"sessions:own"}, "cn:camera");
  Add("viewer", {"sessions:watch"}, "email:viewer@example");
  const auto access = Open();
  EXPECT_EQ((*access->AuthenticateSubjects({"dns:x", "cn:camera"}))->name,
            "camera");
  EXPECT_EQ((*access->AuthenticateSubjects({"email:viewer@example"}))->name,
            "viewer");
  for (const std::vector<std::string>& subjects :
       {std::vector<std::string>{},
        {"cn:Camera"},
        {"dns:camera"},
        {"email:viewer@example", "cn:camera"}}) {
    EXPECT_EQ(access->AuthenticateSubjects(subjects).status().code(),
              absl::StatusCode::kUnauthenticated);
  }
  EXPECT_FALSE(access->AuthenticateHeader("Bearer cn:camera").ok());
}

TEST_F(AccessFile, ScopesIncludeWhatTheySay) {
  const auto scopes_of = [this](const std::vector<std::string>& scopes) {
    fs::remove(path_);
    const std::string token = Add("somebody", scopes);
    const auto principal = *Open()->AuthenticateHeader("Bearer " + token);
    EXPECT_EQ(principal->name, "somebody");
    std::string may;
    if (principal->May(Scope::kMapsRead)) may += "r";
    if (principal->May(Scope::kMapsWrite)) may += "w";
    if (principal->May(Scope::kSessionsOwn)) may += "o";
    if (principal->May(Scope::kSessionsWatch)) may += "l";
    if (principal->May(Scope::kSessionsAll)) may += "a";
    return may;
  };
  EXPECT_EQ(scopes_of({"maps:read"}), "r");
  EXPECT_EQ(scopes_of({"maps:write"}), "rw");
  EXPECT_EQ(scopes_of({"sessions:own"}), "o");
  EXPECT_EQ(scopes_of({"sessions:watch"}), "l");
  EXPECT_EQ(scopes_of({"sessions:all"}), "ola");
  EXPECT_EQ(scopes_of({"maps:read", "sessions:watch"}), "rl");
  EXPECT_EQ(scopes_of({"admin"}), "rwola");
}

TEST_F(AccessFile, MustNameSomebodyWhenTheServerStarts) {
  Write("# nothing\n");
  EXPECT_EQ(Access::Create(OfFile(path_)).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(Access::Create(OfFile(path_ / "none")).status().ToString(),
              HasSubstr("none"));
}

}  // namespace
}  // namespace groundlock::service
