// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/child_program.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <iterator>
#include <sstream>
#include <system_error>
#include <thread>

#include "absl/strings/str_cat.h"

extern char** environ;

namespace groundlock::bench {

ChildProgram::ChildProgram(std::vector<std::string> arguments,
                           const std::filesystem::path& log) {
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(
      &actions, 1, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  posix_spawn_file_actions_adddup2(&actions, 1, 2);
  if (posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ) !=
      0) {
    pid_ = 0;
  }
  posix_spawn_file_actions_destroy(&actions);
}

ChildProgram::~ChildProgram() {
  if (pid_ == 0) return;
  kill(pid_, SIGTERM);
  waitpid(pid_, nullptr, 0);
}

int ChildProgram::Wait() {
  int status = -1;
  if (pid_ != 0) waitpid(pid_, &status, 0);
  pid_ = 0;
  return status;
}

double ChildProgram::CpuSeconds() const {
  std::ifstream file(absl::StrCat("/proc/", pid_, "/stat"));
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const std::size_t name_end = text.rfind(')');
  if (name_end == std::string::npos) return 0.0;
  // State is field 3, the user's time 14, the system's 15.
  std::istringstream fields(text.substr(name_end + 1));
  std::string skipped;
  for (int field = 3; field < 14; ++field) fields >> skipped;
  double user = 0.0;
  double system = 0.0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

double ChildProgram::ResidentMib() const {
  std::ifstream file(absl::StrCat("/proc/", pid_, "/statm"));
  double pages = 0.0;
  file >> pages >> pages;
  return pages * static_cast<double>(sysconf(_SC_PAGESIZE)) / (1 << 20);
}

namespace {

int CountEntries(const std::string& folder) {
  std::error_code error;
  int count = 0;
  for (std::filesystem::directory_iterator it(folder, error), end;
       !error && it != end;
       it.increment(error)) {
    ++count;
  }
  return count;
}

}  // namespace

int ChildProgram::NumThreads() const {
  return CountEntries(absl::StrCat("/proc/", pid_, "/task"));
}

int ChildProgram::NumOpenFiles() const {
  return CountEntries(absl::StrCat("/proc/", pid_, "/fd"));
}

absl::StatusOr<std::string> PortIn(const std::filesystem::path& file) {
  for (int i = 0; i < 600; ++i) {
    std::ifstream stream(file);
    std::string port;
    if (stream >> port) return port;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return absl::DeadlineExceededError(absl::StrCat(file.string(), ": no port"));
}

}  // namespace groundlock::bench
