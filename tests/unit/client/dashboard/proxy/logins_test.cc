// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/logins.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace groundlock::dashboard {
namespace {

Login Of(const std::string& token) { return {token, {}, ""}; }

TEST(Logins, AreFoundByTheirCookiesUntilTheyGo) {
  Logins logins(10);
  const std::string a = logins.Add(Of("a"));
  const std::string b = logins.Add(Of("b"));
  EXPECT_NE(a, b);
  EXPECT_EQ(a.size(), 64U);
  EXPECT_EQ(logins.Find(a)->token, "a");
  EXPECT_EQ(logins.Find(a)->cookie, a);
  EXPECT_FALSE(logins.Find("").has_value());
  logins.Remove(a);
  EXPECT_FALSE(logins.Find(a).has_value());
  logins.Revoke("b");
  EXPECT_FALSE(logins.Find(b).has_value());
}

TEST(Logins, TheOneUsedLeastRecentlyMakesRoom) {
  Logins logins(2);
  const std::string a = logins.Add(Of("a"));
  const std::string b = logins.Add(Of("b"));
  EXPECT_TRUE(logins.Find(a).has_value());
  logins.Add(Of("c"));
  EXPECT_TRUE(logins.Find(a).has_value());
  EXPECT_FALSE(logins.Find(b).has_value());
}

TEST(Logins, OneTokenDoesNotPushOutTheOthers) {
  Logins logins(100);
  const std::string quiet = logins.Add(Of("quiet"));
  std::vector<std::string> cookies;
  for (int i = 0; i < 500; ++i) cookies.push_back(logins.Add(Of("busy")));
  EXPECT_TRUE(logins.Find(quiet).has_value());
  EXPECT_TRUE(logins.Find(cookies.back()).has_value());
  EXPECT_FALSE(logins.Find(cookies.front()).has_value());
}

}  // namespace
}  // namespace groundlock::dashboard
