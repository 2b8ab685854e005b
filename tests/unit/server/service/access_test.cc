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

using ::testing::ElementsAre;
using ::testing::HasSubstr;

namespace fs = std::filesystem;

TEST(Access, WithoutTokensEverybodyMayCall) {
  const Access access({});
  EXPECT_TRUE(access.open_to_all());
  EXPECT_TRUE(access.CheckHeader("").ok());
  EXPECT_TRUE(access.CheckHeader("Bearer whatever").ok());
}

TEST(Access, OtherwiseOnlyThoseThatKnowOne) {
  const Access access({"first-token-0123456", "second-token-012345"});
  EXPECT_TRUE(access.CheckHeader("Bearer first-token-0123456").ok());
  EXPECT_TRUE(access.CheckHeader("Bearer second-token-012345").ok());
  for (const char* header : {"",
                             "Bearer ",
                             "Bearer first-token-012345",
                             "Bearer first-token-01234567",
                             "Bearer First-token-0123456",
                             "bearer first-token-0123456",
                             "Basic first-token-0123456",
                             "first-token-0123456"}) {
    EXPECT_EQ(access.CheckHeader(header).code(),
              absl::StatusCode::kUnauthenticated)
        << header;
  }
}

class TokenFile : public ::testing::Test {
 protected:
  absl::StatusOr<std::vector<std::string>> Read(const std::string& text) {
    std::ofstream(path_) << text;
    fs::permissions(path_, fs::perms::owner_read | fs::perms::owner_write);
    return ReadTokenFile(path_);
  }
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(fs::temp_directory_path());
  const fs::path path_ = directory_.path() / "tokens";
};

TEST_F(TokenFile, HasOneTokenALine) {
  EXPECT_THAT(*Read("# operators\n0123456789abcdef\n\nfedcba9876543210\r\n"),
              ElementsAre("0123456789abcdef", "fedcba9876543210"));
}

TEST_F(TokenFile, NamesTheLineAtFault) {
  const auto tokens = Read("0123456789abcdef\nshort\n");
  EXPECT_EQ(tokens.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(tokens.status().message()), HasSubstr("tokens:2:"));
  EXPECT_FALSE(Read("0123456789 abcdef\n").ok());
  EXPECT_EQ(Read("# nothing\n").status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST_F(TokenFile, MustNotBeEverybodysToRead) {
  ASSERT_TRUE(Read("0123456789abcdef\n").ok());
  fs::permissions(path_, fs::perms::others_read, fs::perm_options::add);
  EXPECT_EQ(ReadTokenFile(path_).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

}  // namespace
}  // namespace groundlock::service
