// SPDX-License-Identifier: Apache-2.0
// The program `groundlock` as a user runs it, mostly against a server of the
// test.
// Needs GROUNDLOCK, the program's path, as a macro.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_COMMAND_LINE_H_
#define GROUNDLOCK_TESTS_INTEGRATION_COMMAND_LINE_H_

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "map_store/base/file.h"

extern char** environ;

namespace groundlock::test {

class CommandLine {
 public:
  // server: HOST:PORT that every command is given; empty = none.
  explicit CommandLine(std::string server) : server_(std::move(server)) {}

  // A folder of the test's own, removed at the end.
  const std::filesystem::path& path() const { return directory_.path(); }

  pid_t Start(std::vector<std::string> arguments) const {
    arguments.insert(arguments.begin(), GROUNDLOCK);
    if (!server_.empty()) {
      arguments.push_back("--server");
      arguments.push_back(server_);
    }
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    const std::string out = (path() / "out").string();
    const std::string err = (path() / "err").string();
    constexpr int kFlags = O_WRONLY | O_CREAT | O_TRUNC;
    posix_spawn_file_actions_addopen(&actions, 1, out.c_str(), kFlags, 0644);
    posix_spawn_file_actions_addopen(&actions, 2, err.c_str(), kFlags, 0644);
    pid_t pid = -1;
    posix_spawn(&pid, GROUNDLOCK, &actions, nullptr, argv.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    return pid;
  }
  // The exit code, -1 if it was killed.
  static int Wait(pid_t pid) {
    int status = 0;
    waitpid(pid, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  int Run(const std::vector<std::string>& arguments) const {
    return Wait(Start(arguments));
  }
  // What a file in path() holds; "out" and "err" are what the program wrote.
  std::string Read(const std::string& file) const {
    std::ifstream stream(path() / file);
    return {std::istreambuf_iterator<char>(stream), {}};
  }

 private:
  const std::string server_;
  base::TemporaryDirectory directory_ =
      *base::TemporaryDirectory::Create(std::filesystem::temp_directory_path());
};

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_COMMAND_LINE_H_
