// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/http_rules.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace groundlock::dashboard {
namespace {

using ::testing::ElementsAre;

TEST(ParseTarget, DecodesPathAndQuery) {
  const auto target = ParseTarget("/api/uploads/a%20b/c?x=1&y=%3D&x=2&z");
  ASSERT_TRUE(target.ok()) << target.status();
  EXPECT_THAT(target->path, ElementsAre("api", "uploads", "a b", "c"));
  EXPECT_EQ(target->query.at("x"), "2");
  EXPECT_EQ(target->query.at("y"), "=");
  EXPECT_EQ(target->query.at("z"), "");
  EXPECT_THAT(ParseTarget("/")->path, ElementsAre(""));
  EXPECT_THAT(ParseTarget("/a/")->path, ElementsAre("a", ""));
}

TEST(ParseTarget, RefusesWhatWouldLeaveItsFolder) {
  for (const char* target : {"",
                             "a",
                             "http://x/a",
                             "/..",
                             "/a/../b",
                             "/a/%2e%2e/b",
                             "/a%2Fb",
                             "/%",
                             "/%4",
                             "/%zz",
                             "/a%00b",
                             "/a\nb",
                             "/./a"}) {
    EXPECT_EQ(ParseTarget(target).status().code(),
              absl::StatusCode::kInvalidArgument)
        << target;
  }
  EXPECT_FALSE(ParseTarget(std::string(100, '/')).ok());
}

TEST(CookieValue, FindsItAmongOthers) {
  EXPECT_EQ(CookieValue("a=1; login=xyz; b=2", "login"), "xyz");
  EXPECT_EQ(CookieValue("login=", "login"), "");
  EXPECT_EQ(CookieValue("mylogin=1;login2=3", "login"), std::nullopt);
  EXPECT_EQ(CookieValue("", "login"), std::nullopt);
  EXPECT_EQ(CookieValue(";;=;login", "login"), "");
}

TEST(ParseRange, UnderstandsTheFormsThatBrowsersSend) {
  const auto range = [](const char* header) {
    return *ParseRange(header, 100);
  };
  EXPECT_EQ(range("").end, 100U);
  EXPECT_FALSE(range("").partial);
  EXPECT_EQ(range("bytes=10-19").begin, 10U);
  EXPECT_EQ(range("bytes=10-19").end, 20U);
  EXPECT_TRUE(range("bytes=10-19").partial);
  EXPECT_EQ(range("bytes=90-").end, 100U);
  EXPECT_EQ(range("bytes=90-1000").end, 100U);
  EXPECT_EQ(range("bytes=90-18446744073709551615").end, 100U);
  EXPECT_EQ(range("bytes=-30").begin, 70U);
  EXPECT_EQ(range("bytes=-300").begin, 0U);
  EXPECT_EQ(ParseRange("bytes=100-", 100).status().code(),
            absl::StatusCode::kOutOfRange);
  EXPECT_EQ(ParseRange("bytes=-0", 100).status().code(),
            absl::StatusCode::kOutOfRange);
  EXPECT_EQ(ParseRange("bytes=-5", 0).status().code(),
            absl::StatusCode::kOutOfRange);
  // What is not understood counts as not said.
  for (const char* header : {"bytes=20-10",
                             "bytes=a-b",
                             "bytes=1-2,5-6",
                             "bytes=5",
                             "lines=1-2",
                             "bytes=-",
                             "bytes=99999999999999999999-"}) {
    EXPECT_FALSE(range(header).partial) << header;
  }
}

TEST(OriginAllowed, TakesItsOwnPagesAndThoseAllowed) {
  const std::vector<std::string> none;
  EXPECT_TRUE(OriginAllowed("", "127.0.0.1:8080", none));
  EXPECT_TRUE(OriginAllowed("http://127.0.0.1:8080", "127.0.0.1:8080", none));
  EXPECT_FALSE(OriginAllowed("http://127.0.0.1:9090", "127.0.0.1:8080", none));
  EXPECT_FALSE(OriginAllowed("null", "127.0.0.1:8080", none));
  EXPECT_FALSE(OriginAllowed("http://evil.example", "127.0.0.1:8080", none));
  EXPECT_FALSE(OriginAllowed("http://", "", none));
  const std::vector<std::string> allowed = {"https://dash.example.org"};
  EXPECT_TRUE(
      OriginAllowed("https://dash.example.org", "10.0.0.1:80", allowed));
  EXPECT_FALSE(
      OriginAllowed("http://dash.example.org", "10.0.0.1:80", allowed));
}

TEST(HostAllowed, TakesAddressesAndKnownNamesOnly) {
  const std::vector<std::string> allowed = {"https://dash.example.org"};
  for (const char* host : {"127.0.0.1",
                           "127.0.0.1:8080",
                           "[::1]:8080",
                           "localhost",
                           "LOCALHOST:80",
                           "dash.example.org",
                           "dash.example.org:443"}) {
    EXPECT_TRUE(HostAllowed(host, allowed)) << host;
  }
  for (const char* host :
       {"", "evil.example", "evil.example:8080", "1.2.3", "x[::1]"}) {
    EXPECT_FALSE(HostAllowed(host, allowed)) << host;
  }
}

TEST(ValidateUploadPath, KeepsToPlainNames) {
  EXPECT_TRUE(ValidateUploadPath({"sparse", "0", "images.bin"}).ok());
  EXPECT_TRUE(ValidateUploadPath({"Straße 1.jpg"}).ok());
  EXPECT_FALSE(ValidateUploadPath({}).ok());
  EXPECT_FALSE(ValidateUploadPath({""}).ok());
  EXPECT_FALSE(ValidateUploadPath({"a", ""}).ok());
  EXPECT_FALSE(ValidateUploadPath({".hidden"}).ok());
  EXPECT_FALSE(ValidateUploadPath({"a\\b"}).ok());
  EXPECT_FALSE(ValidateUploadPath({std::string(256, 'a')}).ok());
  EXPECT_FALSE(ValidateUploadPath(std::vector<std::string>(17, "a")).ok());
}

TEST(AcceptsGzip, ReadsWeights) {
  EXPECT_TRUE(AcceptsGzip("gzip"));
  EXPECT_TRUE(AcceptsGzip("br, GZIP;q=0.5"));
  EXPECT_FALSE(AcceptsGzip("br, gzip;q=0"));
  EXPECT_FALSE(AcceptsGzip("br"));
  EXPECT_FALSE(AcceptsGzip(""));
}

}  // namespace
}  // namespace groundlock::dashboard
