// SPDX-License-Identifier: Apache-2.0
#include "map_store/cage/child_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "map_store/base/sanitizers.h"

namespace groundlock::cage {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

class ChildProcess : public ::testing::Test {
 protected:
  // What bash prints, line by line.
  absl::Status Run(const std::string& script) {
    lines_.clear();
    ChildProcessOptions options;
    options.arguments = {"bash", "-c", script};
    options.log = directory_.path() / "log";
    options.on_line = [this](std::string_view line) {
      lines_.emplace_back(line);
    };
    return RunChildProcess(options);
  }
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
  std::vector<std::string> lines_;
};

TEST_F(ChildProcess, IsToldNoPasswords) {
  setenv("PGPASSWORD", "secret", 1);
  setenv("GROUNDLOCK_TOKEN", "secret", 1);
  setenv("OMP_NUM_THREADS", "2", 1);
  ASSERT_TRUE(Run("env").ok());
  for (const std::string& line : lines_) {
    EXPECT_THAT(line, Not(HasSubstr("secret")));
  }
  EXPECT_THAT(lines_, Contains("OMP_NUM_THREADS=2"));
  EXPECT_THAT(lines_, Contains(HasSubstr("PATH=")));
}

TEST_F(ChildProcess, HasNoNetwork) {
#if defined(GROUNDLOCK_HAS_SHADOW)
  GTEST_SKIP() << "SKIPPED: only what is built as it is delivered";
#endif
  // A connection is refused for want of rights, not for want of a server.
  ASSERT_TRUE(Run("exec 2>&1; echo > /dev/tcp/127.0.0.1/9 || true; "
                  "grep Seccomp: /proc/self/status; "
                  "grep NoNewPrivs: /proc/self/status")
                  .ok());
  EXPECT_THAT(lines_, Contains(HasSubstr("ermission denied")));
  EXPECT_THAT(lines_, Contains("Seccomp:\t2"));
  EXPECT_THAT(lines_, Contains("NoNewPrivs:\t1"));
}

TEST_F(ChildProcess, ItsEndIsTold) {
  EXPECT_TRUE(Run("exit 0").ok());
  EXPECT_THAT(Run("echo the reason; exit 3").ToString(),
              HasSubstr("exit status 3: the reason"));
  EXPECT_THAT(Run("kill -KILL $$").ToString(), HasSubstr("signal 9"));
}

}  // namespace
}  // namespace groundlock::cage
