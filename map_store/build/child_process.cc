// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/child_process.h"

#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstddef>
#include <deque>
#include <fstream>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "map_store/base/status.h"

namespace groundlock::build::internal {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kPollInterval_ms = 100;
constexpr auto kGrace = std::chrono::seconds(2);
constexpr std::size_t kMaxLineBytes = 4'096;
constexpr std::size_t kLinesQuoted = 4;
constexpr int kCannotExecute = 127;  // as a shell says it

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

// The variables that programs of others are told.
std::vector<std::string> ChildEnvironment() {
  constexpr std::array<std::string_view, 10> kNames = {"PATH",
                                                       "HOME",
                                                       "USER",
                                                       "TMPDIR",
                                                       "LANG",
                                                       "TZ",
                                                       "DISPLAY",
                                                       "XAUTHORITY",
                                                       "XDG_RUNTIME_DIR",
                                                       "LD_LIBRARY_PATH"};
  constexpr std::array<std::string_view, 8> kPrefixes = {
      "LC_", "QT_", "OMP_", "OPENBLAS_", "MKL_", "CUDA_", "MALLOC_", "COLMAP_"};
  std::vector<std::string> environment;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string_view text = *entry;
    const std::string_view name = text.substr(0, text.find('='));
    const bool passes =
        std::find(kNames.begin(), kNames.end(), name) != kNames.end() ||
        std::any_of(kPrefixes.begin(), kPrefixes.end(), [&](auto prefix) {
          return name.starts_with(prefix);
        });
    if (passes) environment.emplace_back(text);
  }
  return environment;
}

#if defined(__x86_64__)
constexpr unsigned kArchitecture = AUDIT_ARCH_X86_64;
#elif defined(__aarch64__)
constexpr unsigned kArchitecture = AUDIT_ARCH_AARCH64;
#endif

// No sockets but those of this machine's file system, by which other programs'
// windows and logs are reached; nor what makes sockets by another way.
void ForbidNetwork() {
#if defined(__x86_64__) || defined(__aarch64__)
  constexpr unsigned kDenied = SECCOMP_RET_ERRNO | EACCES;
  constexpr unsigned kX32 =
      0x40000000;  // numbers of another calling convention
  sock_filter filter[] = {
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, arch)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, kArchitecture, 1, 0),
      BPF_STMT(BPF_RET | BPF_K, kDenied),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)),
      BPF_JUMP(BPF_JMP | BPF_JGE | BPF_K, kX32, 4, 0),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, __NR_io_uring_setup, 3, 0),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, __NR_socket, 0, 3),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, args)),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, AF_UNIX, 1, 0),
      BPF_STMT(BPF_RET | BPF_K, kDenied),
      BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
  };
  const sock_fprog program{static_cast<unsigned short>(std::size(filter)),
                           filter};
  // A kernel without it runs the program all the same.
  prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program);
#endif
}

// In the child, between fork and exec: only calls that are safe there.
[[noreturn]] void Become(char* const* argv,
                         char* const* environment,
                         int output,
                         int niceness) {
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
  const rlimit no_core{0, 0};
  setrlimit(RLIMIT_CORE, &no_core);
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0) ForbidNetwork();
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
  std::string what = program;
  if (options.arguments.size() > 1) {
    absl::StrAppend(&what, " ", options.arguments[1]);
  }
  const std::string how =
      WIFEXITED(status)
          ? absl::StrCat("failed with exit status ", WEXITSTATUS(status))
          : absl::StrCat("was ended by signal ", WTERMSIG(status));
  return absl::InternalError(absl::StrCat(what,
                                          " ",
                                          how,
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
  std::vector<std::string> variables = ChildEnvironment();
  std::vector<char*> environment;
  for (std::string& variable : variables) {
    environment.push_back(variable.data());
  }
  environment.push_back(nullptr);
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
           options.niceness == 0 ? 0 : niceness);
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

}  // namespace groundlock::build::internal
