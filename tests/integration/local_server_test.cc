// SPDX-License-Identifier: Apache-2.0
// The program without a server that anybody started: it runs one of its own.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/wait.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "tests/integration/command_line.h"
#include "tests/integration/test_server.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// Processes whose command line names `text`, e.g. a store of the test's own.
std::vector<pid_t> ProcessesThatName(const std::string& text) {
  std::vector<pid_t> found;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator("/proc", error)) {
    std::ifstream file(entry.path() / "cmdline");
    const std::string line{std::istreambuf_iterator<char>(file), {}};
    const std::string name = entry.path().filename();
    if (line.find(text) != std::string::npos &&
        line.find("groundlock-server") != std::string::npos) {
      found.push_back(std::stoi(name));
    }
  }
  return found;
}

class LocalServer : public ::testing::Test {
 protected:
  LocalServer() { setenv("XDG_DATA_HOME", data().c_str(), 1); }
  fs::path data() const { return command_.path() / "data"; }
  std::string store() const { return (data() / "groundlock/maps").string(); }

  const CommandLine command_{""};
};

TEST_F(LocalServer, ServesTheCommandAndEndsWithIt) {
  ASSERT_EQ(command_.Run({"map", "list", "--local"}), 0)
      << command_.Read("err");
  EXPECT_THAT(command_.Read("err"), HasSubstr("maps are in " + store()));
  EXPECT_TRUE(fs::is_directory(store()));
  EXPECT_THAT(ProcessesThatName(store()), ::testing::IsEmpty());
}

TEST_F(LocalServer, KeepsMapsFromOneCommandToTheNext) {
  ASSERT_EQ(command_.Run({"simulate",
                          "yard",
                          "mapping",
                          "--out",
                          (command_.path() / "yard").string(),
                          "--size",
                          "320x180"}),
            0)
      << command_.Read("err");
  ASSERT_EQ(command_.Run({"map",
                          "import",
                          "yard",
                          (command_.path() / "yard/map").string(),
                          "--local"}),
            0)
      << command_.Read("err");
  ASSERT_EQ(command_.Run({"map", "show", "yard", "--local"}), 0)
      << command_.Read("err");
  EXPECT_THAT(command_.Read("out"), HasSubstr("yard"));
}

TEST_F(LocalServer, IsNotStartedWhereAServerIsNamed) {
  EXPECT_NE(command_.Run({"map", "list", "--server", "127.0.0.1:1"}), 0);
  EXPECT_FALSE(fs::exists(store()));
  EXPECT_NE(command_.Run({"map", "list", "--local", "--server", "127.0.0.1:1"}),
            0);
  EXPECT_THAT(command_.Read("err"), HasSubstr("--server"));
}

TEST_F(LocalServer, DiesWithAProgramThatIsKilled) {
  // Building takes far longer than the server needs to appear.
  const fs::path yard = command_.path() / "yard";
  ASSERT_EQ(command_.Run({"simulate",
                          "yard",
                          "occlusion",
                          "--out",
                          yard,
                          "--size",
                          "320x180",
                          "--frames",
                          "48"}),
            0)
      << command_.Read("err");
  const pid_t pid = command_.Start({"map",
                                    "build",
                                    "yard",
                                    "--video",
                                    yard / "occlusion.mp4",
                                    "--work",
                                    command_.path() / "work",
                                    "--local"});
  EXPECT_TRUE(
      Eventually([this] { return !ProcessesThatName(store()).empty(); }));
  kill(pid, SIGKILL);
  int status = 0;
  waitpid(pid, &status, 0);
  EXPECT_TRUE(WIFSIGNALED(status)) << "it ended before it was killed";
  EXPECT_TRUE(
      Eventually([this] { return ProcessesThatName(store()).empty(); }));
}

}  // namespace
}  // namespace groundlock::test
