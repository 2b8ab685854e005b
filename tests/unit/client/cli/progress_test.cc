// SPDX-License-Identifier: Apache-2.0
#include "client/cli/progress.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

namespace groundlock::cli {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(Progress, DrawsABarInPlaceOnATerminal) {
  std::ostringstream out;
  Progress progress(
      out, {.label = "track", .total = 4, .terminal = true, .columns = 120});
  progress.Update(2, "tracked");
  EXPECT_THAT(out.str(), HasSubstr("\rtrack  [############------------]"));
  EXPECT_THAT(out.str(), HasSubstr(" 50 %  2/4 frames"));
  EXPECT_THAT(out.str(), HasSubstr("tracked"));
  EXPECT_THAT(out.str(), Not(HasSubstr("\n")));
  progress.Update(4);
  progress.Finish();
  EXPECT_THAT(out.str(), HasSubstr("100 %  4/4 frames"));
  EXPECT_EQ(out.str().back(), '\n');
}

TEST(Progress, NeverWrapsTheLine) {
  std::ostringstream out;
  Progress progress(
      out, {.label = "track", .total = 4, .terminal = true, .columns = 30});
  progress.Update(2, std::string(200, 'x'));
  // Carriage return, at most 29 characters, "erase to the end of the line".
  EXPECT_LE(out.str().size(), 1U + 29U + 3U);
}

TEST(Progress, WritesPlainLinesElsewhere) {
  std::ostringstream out;
  {
    Progress progress(out, {.label = "import", .total = 10, .unit = "MiB"});
    for (int i = 1; i <= 10; ++i) progress.Update(i);
  }
  // All of it within a moment: only the last state is worth a line.
  EXPECT_THAT(out.str(), HasSubstr("import  100 %  10/10 MiB"));
  EXPECT_THAT(out.str(), Not(HasSubstr("\r")));
  const std::string text = out.str();
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 1);
}

TEST(Progress, CountsWithoutATotal) {
  std::ostringstream out;
  {
    Progress progress(out, {.label = "track", .total = std::nullopt});
    progress.Update(7);
  }
  EXPECT_THAT(out.str(), HasSubstr("track  7 frames"));
  EXPECT_THAT(out.str(), Not(HasSubstr("%")));
}

TEST(Progress, SaysNothingIfNothingHappened) {
  std::ostringstream out;
  { Progress progress(out, {.label = "track", .total = std::nullopt}); }
  EXPECT_EQ(out.str(), "");
}

}  // namespace
}  // namespace groundlock::cli
