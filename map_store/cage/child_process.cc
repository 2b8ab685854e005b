// SPDX-License-Identifier: Apache-2.0
#include "map_store/cage/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <deque>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"
#include "map_store/cage/cage.h"

namespace groundlock::cage {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kPollInterval_ms = 100;
constexpr auto kGrace = std::chrono::seconds(2);
constexpr std::size_t kMaxLineBytes = 4'096;
constexpr std::size_t kLinesQuoted = 4;
constexpr int kCannotExecute = 127;  // as a shell says it
constexpr int kCannotEnter = 126;
// More than a program of others opens, and files of databases of features.
constexpr std::uint64_t kOpenFiles = 1'024;
constexpr std::uint64_t kLargestFile = std::uint64_t{64} << 30;
// Below it, libraries and threads that are only reserved are refused.
constexpr std::uint64_t kLeastMemory = std::uint64_t{4} << 30;

class FileDescriptor {
 public:
  explicit FileDescriptor(int fd) : fd_(fd) {}
  ~FileDescriptor() { Close(); }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  int get() const { return fd_; }
  void Close() {
    if (fd_ >= 0) close(fd_);
    fd_ = -1;
  }

 private:
  int fd_;
};

std::uint64_t MemoryOfMachine() {
  const auto pages = static_cast<std::uint64_t>(sysconf(_SC_PHYS_PAGES));
  const auto page_bytes = static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
  return std::max(kLeastMemory, pages * page_bytes);
}

// In the child, between fork and exec: only calls that are safe there.
[[noreturn]] void Become(char* const* argv,
                         char* const* environment,
                         int output,
                         int niceness,
                         const Cage& cage) {
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  // Threads of ours block signals that end a program.
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  const int input = open("/dev/null", O_RDONLY);
  if (input >= 0) dup2(input, STDIN_FILENO);
  dup2(output, STDOUT_FILENO);
  dup2(output, STDERR_FILENO);
  if (niceness != 0) setpriority(PRIO_PROCESS, 0, niceness);
  if (cage.Enter() != 0) _exit(kCannotEnter);
  execvpe(argv[0], argv, environment);
  _exit(kCannotExecute);
}

// Cuts what comes out of a pipe into lines.
class Lines {
 public:
  explicit Lines(const ChildProcessOptions& options)
      : options_(options), log_(options.log, std::ios::app) {}

  void Add(std::string_view bytes) {
    log_.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    for (const char c : bytes) {
      if (c == '\n' || c == '\r') {
        End();
      } else if (line_.size() < kMaxLineBytes) {
        line_.push_back(c);
      }
    }
  }
  void End() {
    if (line_.empty()) return;
    if (options_.on_line) options_.on_line(line_);
    last_.push_back(line_);
    if (last_.size() > kLinesQuoted) last_.pop_front();
    line_.clear();
  }
  std::string Last() const { return absl::StrJoin(last_, " | "); }

 private:
  const ChildProcessOptions& options_;
  std::ofstream log_;
  std::string line_;
  std::deque<std::string> last_;
};

absl::Status StatusOfEnd(int status,
                         const ChildProcessOptions& options,
                         const Lines& lines) {
  const std::string& program = options.arguments.front();
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return absl::OkStatus();
  if (WIFEXITED(status) && WEXITSTATUS(status) == kCannotExecute) {
    return absl::NotFoundError(
        absl::StrCat("the program '", program, "' cannot be started"));
  }
  if (WIFEXITED(status) && WEXITSTATUS(status) == kCannotEnter) {
    return absl::FailedPreconditionError(
        absl::StrCat("the program '",
                     program,
                     "' is not started: this kernel takes no seccomp filter, "
                     "so nothing would keep it from the network"));
  }
  std::string what = program;
  if (options.arguments.size() > 1) {
    absl::StrAppend(&what, " ", options.arguments[1]);
  }
  return absl::InternalError(absl::StrCat(what,
                                          " ",
                                          HowItEnded(status),
                                          ": ",
                                          lines.Last(),
                                          " (log: ",
                                          options.log.string(),
                                          ")"));
}

}  // namespace

absl::Status RunChildProcess(const ChildProcessOptions& options) {
  if (options.arguments.empty()) {
    return absl::InvalidArgumentError("arguments: empty");
  }
  std::vector<std::string> arguments = options.arguments;
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  std::vector<std::string> variables = CleanEnvironment();
  std::vector<char*> environment;
  for (std::string& variable : variables) {
    environment.push_back(variable.data());
  }
  environment.push_back(nullptr);
  ASSIGN_OR_RETURN(const Cage cage,
                   Cage::Create(Kind::kProgram,
                                {.memory_bytes = options.memory_bytes > 0
                                                     ? options.memory_bytes
                                                     : MemoryOfMachine(),
                                 .cpu_s = std::nullopt,
                                 .open_files = kOpenFiles,
                                 .file_bytes = kLargestFile}));
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) {
    return absl::ErrnoToStatus(errno, "cannot make a pipe");
  }
  FileDescriptor output(ends[0]);
  FileDescriptor input(ends[1]);
  const int niceness = getpriority(PRIO_PROCESS, 0) + options.niceness;
  const pid_t child = fork();
  if (child < 0) return absl::ErrnoToStatus(errno, "cannot fork");
  if (child == 0) {
    Become(argv.data(),
           environment.data(),
           input.get(),
           options.niceness == 0 ? 0 : niceness,
           cage);
  }
  setpgid(child, child);  // whichever of the two comes first
  input.Close();

  Lines lines(options);
  bool cancelled = false;
  bool killed = false;
  Clock::time_point asked_to_end;
  for (;;) {
    pollfd ready{.fd = output.get(), .events = POLLIN, .revents = 0};
    if (poll(&ready, 1, kPollInterval_ms) > 0) {
      char buffer[8'192];
      const ssize_t count = read(output.get(), buffer, sizeof(buffer));
      if (count == 0) break;  // it, and what it started, are gone
      if (count < 0 && errno != EINTR && errno != EAGAIN) break;
      if (count > 0) {
        lines.Add(std::string_view(buffer, static_cast<std::size_t>(count)));
      }
    }
    if (!cancelled && options.is_cancelled && options.is_cancelled()) {
      cancelled = true;
      asked_to_end = Clock::now();
      kill(-child, SIGTERM);
    }
    if (cancelled && !killed && Clock::now() - asked_to_end > kGrace) {
      killed = true;
      kill(-child, SIGKILL);
    }
  }
  lines.End();
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (cancelled) return absl::CancelledError("cancelled");
  return StatusOfEnd(status, options, lines);
}

}  // namespace groundlock::cage
