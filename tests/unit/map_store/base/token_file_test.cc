// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/token_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include "map_store/base/file.h"

namespace groundlock::base {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

namespace fs = std::filesystem;

class TokenFileTest : public ::testing::Test {
 protected:
  static absl::StatusOr<std::vector<TokenEntry>> Entries(const fs::path& path) {
    auto file = ReadTokenFile(path);
    if (!file.ok()) return file.status();
    return std::move(file->entries);
  }
  absl::StatusOr<std::vector<TokenEntry>> Read(const std::string& text) {
    std::ofstream(path_) << text;
    fs::permissions(path_, fs::perms::owner_read | fs::perms::owner_write);
    return Entries(path_);
  }
  TemporaryDirectory directory_ =
      *TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path path_ = directory_.path() / "tokens";
};

// FIPS 180-2, appendix B.1.
TEST(Sha256, IsTheStandards) {
  EXPECT_EQ(Sha256("abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST_F(TokenFileTest, KeepsHashesAndNoTokens) {
  const auto token =
      CreateToken(path_, {"camera-1", "", {"sessions:all", "maps:read"}, ""});
  ASSERT_TRUE(token.ok()) << token.status();
  EXPECT_EQ(token->size(), 43U) << "256 bits";
  const auto other =
      CreateToken(path_, {"viewer", "acme", {"sessions:watch"}, ""});
  ASSERT_TRUE(other.ok());
  EXPECT_NE(*token, *other);
  const std::string text = *ReadFile(path_, 1 << 20);
  EXPECT_THAT(text, Not(HasSubstr(*token)));
  EXPECT_EQ(fs::status(path_).permissions(),
            fs::perms::owner_read | fs::perms::owner_write);
  const auto entries = Entries(path_);
  ASSERT_TRUE(entries.ok()) << entries.status();
  ASSERT_EQ(entries->size(), 2U);
  EXPECT_EQ((*entries)[0].name, "camera-1");
  EXPECT_THAT((*entries)[0].scopes, ElementsAre("sessions:all", "maps:read"));
  EXPECT_EQ((*entries)[0].credential, "sha256:" + Sha256(*token));
  EXPECT_EQ((*entries)[0].tenant, "");
  EXPECT_EQ((*entries)[1].tenant, "acme");
  EXPECT_EQ(CreateToken(path_, {"viewer", "", {"admin"}, ""}).status().code(),
            absl::StatusCode::kAlreadyExists);
}

TEST_F(TokenFileTest, TakesTokensAsTheyAre) {
  const auto entries =
      Read("# operators\n0123456789abcdef\n\nfedcba9876543210\r\n");
  ASSERT_TRUE(entries.ok()) << entries.status();
  ASSERT_EQ(entries->size(), 2U);
  EXPECT_EQ((*entries)[1].name, "line-4");
  EXPECT_EQ((*entries)[1].credential, "sha256:" + Sha256("fedcba9876543210"));
  EXPECT_THAT((*entries)[1].scopes, ElementsAre("admin"));
  EXPECT_TRUE(Read("# nothing\n")->empty());
}

TEST_F(TokenFileTest, RevokingLeavesTheRestAsItIs) {
  const std::string before = "# operators\n0123456789abcdef\n";
  ASSERT_TRUE(Read(before).ok());
  ASSERT_TRUE(CreateToken(path_, {"viewer", "", {"sessions:watch"}, ""}).ok());
  ASSERT_TRUE(RevokeToken(path_, "viewer").ok());
  EXPECT_EQ(*ReadFile(path_, 1 << 20), before);
  EXPECT_EQ(RevokeToken(path_, "viewer").code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(RevokeToken(path_, "line-2").ok());
  EXPECT_TRUE(Entries(path_)->empty());
}

TEST_F(TokenFileTest, NamesTheLineAtFault) {
  const std::string hash = " sha256:" + std::string(64, '0') + "\n";
  EXPECT_TRUE(Read("a admin" + hash).ok());
  EXPECT_TRUE(Read("a admin" + hash + "b admin cn:b tenant=acme\n").ok());
  for (const std::string& line :
       {std::string("short\n"),
        "again admin" + hash,
        std::string("a admin cn:\n"),
        std::string("a admin ip:192.0.2.1\n"),
        std::string("a admin cn:b tenant=\n"),
        std::string("a admin cn:b tenant=a/b\n"),
        std::string("a admin cn:b tenant=.a\n"),
        std::string("a admin cn:b tenants=a\n"),
        std::string("a admin cn:b tenant=a tenant=b\n"),
        std::string("0123456789 abcdef\n"),
        "a everything" + hash,
        "a " + hash,
        "a/b admin" + hash,
        "first admin" + hash,
        std::string("a admin sha256:00\n"),
        "a admin sha256:" + std::string(64, 'G')}) {
    const auto entries = Read("first admin" + hash + line);
    EXPECT_EQ(entries.status().code(), absl::StatusCode::kInvalidArgument)
        << line;
    EXPECT_THAT(entries.status().ToString(), HasSubstr("tokens:2")) << line;
  }
  const fs::path fresh = directory_.path() / "new";
  for (const TokenEntry& wrong :
       {TokenEntry{"a b", "", {"admin"}, ""},
        TokenEntry{"a\nb admin", "", {"admin"}, ""},
        TokenEntry{"a", "", {"all"}, ""},
        TokenEntry{"a", "", {}, ""},
        TokenEntry{"a", "a b", {"admin"}, ""},
        TokenEntry{"a", std::string(33, 'a'), {"admin"}, ""},
        TokenEntry{"a", "", {"admin"}, "cn:a b"},
        TokenEntry{"a", "", {"admin"}, "uri:" + std::string(300, 'a')}}) {
    EXPECT_EQ(CreateToken(fresh, wrong).status().code(),
              absl::StatusCode::kInvalidArgument);
  }
  EXPECT_FALSE(fs::exists(fresh));
}

TEST_F(TokenFileTest, MustNotBeEverybodysToRead) {
  ASSERT_TRUE(Read("0123456789abcdef\n").ok());
  fs::permissions(path_, fs::perms::others_read, fs::perm_options::add);
  EXPECT_EQ(Entries(path_).status().code(),
            absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(CreateToken(path_, {"a", "", {"admin"}, ""}).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST_F(TokenFileTest, CertificatesAreKnownByWhatTheySay) {
  const auto none = CreateToken(
      path_, {"camera", "acme", {"sessions:own"}, "uri:spiffe://acme/camera"});
  ASSERT_TRUE(none.ok()) << none.status();
  EXPECT_EQ(*none, "") << "there is no token";
  EXPECT_EQ(CreateToken(path_, {"b", "", {"admin"}, "uri:spiffe://acme/camera"})
                .status()
                .code(),
            absl::StatusCode::kAlreadyExists);
  EXPECT_THAT(
      *Entries(path_),
      ElementsAre(TokenEntry{
          "camera", "acme", {"sessions:own"}, "uri:spiffe://acme/camera"}));
}

TEST_F(TokenFileTest, QuotasAreTheirOwnOrTheDefaults) {
  const std::string hash = " sha256:" + std::string(64, '0');
  const std::string other = " sha256:" + std::string(64, '1');
  const auto entries =
      Read("a admin" + hash + " sessions=3 tenant=t\n" + "b admin" + other +
           " bytes-per-s=0 builds=2\n" + "0123456789abcdef\n" +
           "* bytes-per-s=50M frames-per-s=48\n");
  ASSERT_TRUE(entries.ok()) << entries.status();
  const Quotas defaults{0, 48, 50 << 20, 0, 0};
  EXPECT_EQ(ReadTokenFile(path_)->defaults, defaults);
  EXPECT_EQ((*entries)[0].quotas, (Quotas{3, 48, 50 << 20, 0, 0}));
  EXPECT_EQ((*entries)[1].quotas, (Quotas{0, 48, 0, 2, 0}));
  EXPECT_EQ((*entries)[2].quotas, defaults);
  for (const char* wrong : {"sessions=",
                            "sessions=-1",
                            "sessions=x",
                            "sessions=1 sessions=2",
                            "stored-bytes=9999999T",
                            "stored-bytes=1P",
                            "steps=1",
                            "sessions"}) {
    EXPECT_FALSE(Read("a admin" + hash + " " + wrong + "\n").ok()) << wrong;
    EXPECT_FALSE(Read("* " + std::string(wrong) + "\n").ok()) << wrong;
  }
  EXPECT_FALSE(Read("* tenant=a\n").ok());
  EXPECT_FALSE(Read("* builds=1\n* builds=1\n").ok());
  ASSERT_TRUE(Read("* builds=1\n").ok());
  ASSERT_TRUE(
      CreateToken(path_, {"c", "", {"admin"}, "", {1, 0, 2 << 20, 0, 5}}).ok());
  EXPECT_EQ((*Entries(path_))[0].quotas, (Quotas{1, 0, 2 << 20, 1, 5}));
  ASSERT_TRUE(RevokeToken(path_, "c").ok());
  EXPECT_EQ(*ReadFile(path_, 1 << 20), "* builds=1\n");
}

TEST_F(TokenFileTest, SeveralMayBeCreatedAtOnce) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([this, t] {
      for (int i = 0; i < 8; ++i) {
        const std::string name =
            "t" + std::to_string(t) + "-" + std::to_string(i);
        EXPECT_TRUE(CreateToken(path_, {name, "", {"admin"}, ""}).ok());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(Entries(path_)->size(), 32U);
}

}  // namespace
}  // namespace groundlock::base
