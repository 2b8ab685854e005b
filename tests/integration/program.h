// SPDX-License-Identifier: Apache-2.0
// The server program, as somebody at a terminal runs it.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_PROGRAM_H_
#define GROUNDLOCK_TESTS_INTEGRATION_PROGRAM_H_

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "map_store/base/file.h"
#include "tests/integration/test_server.h"

extern char** environ;

namespace groundlock::test {

// Runs the program with its output in a file. "@TMP@" in an argument stands for
// a temporary folder.
class Program {
 public:
  explicit Program(std::vector<std::string> arguments)
      : directory_(*base::TemporaryDirectory::Create(
            std::filesystem::temp_directory_path())) {
    arguments.insert(arguments.begin(), GROUNDLOCK_SERVER);
    for (std::string& argument : arguments) {
      const std::size_t at = argument.find("@TMP@");
      if (at != std::string::npos) {
        argument.replace(at, 5, directory_.path().string());
      }
    }
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(
        &actions, 1, log().c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    posix_spawn_file_actions_adddup2(&actions, 1, 2);
    if (posix_spawn(&pid_,
                    GROUNDLOCK_SERVER,
                    &actions,
                    nullptr,
                    argv.data(),
                    environ) != 0) {
      ADD_FAILURE() << "cannot start " << GROUNDLOCK_SERVER;
    }
    posix_spawn_file_actions_destroy(&actions);
  }
  ~Program() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
  }

  std::string Log() const {
    std::ifstream stream(log());
    std::stringstream content;
    content << stream.rdbuf();
    return content.str();
  }
  // The number after `text` in the log, once it is there.
  int PortAfter(const std::string& text) const {
    const std::regex pattern(text + "([0-9]+)\n");
    std::smatch match;
    std::string content;
    Eventually([&] {
      content = Log();
      return std::regex_search(content, match, pattern) || Exited();
    });
    return match.empty() ? 0 : std::stoi(match[1]);
  }
  pid_t pid() const { return pid_; }
  void Signal(int signal) const { kill(pid_, signal); }
  bool Exited() const {
    siginfo_t info{};
    return waitid(P_PID,
                  static_cast<id_t>(pid_),
                  &info,
                  WEXITED | WNOHANG | WNOWAIT) == 0 &&
           info.si_pid == pid_;
  }
  // Its exit code; -1 if it was killed or does not end.
  int Wait() {
    if (!Eventually([this] { return Exited(); })) return -1;
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  const std::filesystem::path& directory() const { return directory_.path(); }

 private:
  std::string log() const { return (directory_.path() / "log").string(); }

  base::TemporaryDirectory directory_;
  pid_t pid_ = 0;
};

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_PROGRAM_H_
