// SPDX-License-Identifier: Apache-2.0
#include "client/cli/local_server.h"

#include <fcntl.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <system_error>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

// A store of thousands of maps opens in well under a second.
constexpr std::chrono::seconds kStartLimit(30);
constexpr std::chrono::milliseconds kPollInterval(20);
// The server gives open calls a moment to end; ours have ended by then.
constexpr std::chrono::seconds kStopLimit(10);
constexpr int kCannotExecute = 127;  // as a shell says it

// The server that was built or installed with this program, or the one that a
// shell would find.
std::string ServerProgram() {
  std::error_code error;
  const fs::path own = fs::read_symlink("/proc/self/exe", error);
  if (!error) {
    const fs::path beside = own.parent_path() / "groundlock-server";
    if (access(beside.c_str(), X_OK) == 0) return beside.string();
  }
  return "groundlock-server";
}

// In the child, between fork and exec: only calls that are safe there.
[[noreturn]] void Become(char* const* argv, int log, pid_t parent) {
  // Ctrl-C in the terminal is for the client, which then ends its session.
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (getppid() != parent) _exit(EXIT_FAILURE);  // it has died meanwhile
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  const int input = open("/dev/null", O_RDONLY);
  if (input >= 0) dup2(input, STDIN_FILENO);
  dup2(log, STDOUT_FILENO);
  dup2(log, STDERR_FILENO);
  execvp(argv[0], argv);
  _exit(kCannotExecute);
}

}  // namespace

absl::StatusOr<fs::path> UserDataFolder() {
  const char* const data = std::getenv("XDG_DATA_HOME");
  if (data != nullptr && fs::path(data).is_absolute()) {
    return fs::path(data) / "groundlock";
  }
  const char* const home = std::getenv("HOME");
  if (home != nullptr && *home != '\0') {
    return fs::path(home) / ".local" / "share" / "groundlock";
  }
  return absl::FailedPreconditionError(
      "neither XDG_DATA_HOME nor HOME says where maps may be kept");
}

bool LoopbackAnswers(int port) {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return false;
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const bool answers = connect(fd,
                               reinterpret_cast<const sockaddr*>(&address),
                               sizeof(address)) == 0;
  close(fd);
  return answers;
}

LocalServer::~LocalServer() {
  if (child_ > 0) {
    kill(child_, SIGTERM);
    const auto end = Clock::now() + kStopLimit;
    while (waitpid(child_, nullptr, WNOHANG) == 0) {
      if (Clock::now() > end) {
        kill(child_, SIGKILL);
        waitpid(child_, nullptr, 0);
        break;
      }
      std::this_thread::sleep_for(kPollInterval);
    }
  }
  std::error_code ignored;
  if (!port_file_.empty()) fs::remove(port_file_, ignored);
}

absl::StatusOr<std::string> LocalServer::Start(
    const std::function<bool()>& is_cancelled) {
  if (!address_.empty()) return address_;
  RETURN_IF_ERROR(Launch());
  RETURN_IF_ERROR(WaitForPort(is_cancelled));
  return address_;
}

absl::Status LocalServer::Launch() {
  ASSIGN_OR_RETURN(const fs::path folder, UserDataFolder());
  store_ = folder / "maps";
  log_ = folder / "server.log";
  port_file_ = folder / absl::StrCat(".port-", getpid());
  std::error_code error;
  fs::create_directories(store_, error);
  if (error) {
    return absl::FailedPreconditionError(
        absl::StrCat("cannot create ", store_.string(), ": ", error.message()));
  }
  fs::remove(port_file_, error);
  const int log =
      open(log_.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  if (log < 0) {
    return absl::ErrnoToStatus(errno,
                               absl::StrCat("cannot write ", log_.string()));
  }
  std::vector<std::string> arguments = {ServerProgram(),
                                        "--listen",
                                        "127.0.0.1:0",
                                        "--metrics",
                                        "",
                                        "--store",
                                        store_.string(),
                                        "--port-file",
                                        port_file_.string(),
                                        "--grace",
                                        "2"};
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  const pid_t parent = getpid();
  child_ = fork();
  if (child_ == 0) Become(argv.data(), log, parent);
  close(log);
  if (child_ < 0) return absl::ErrnoToStatus(errno, "cannot fork");
  return absl::OkStatus();
}

absl::Status LocalServer::WaitForPort(
    const std::function<bool()>& is_cancelled) {
  const auto end = Clock::now() + kStartLimit;
  for (;;) {
    // The server writes the file whole, and only once it serves.
    if (int port = 0; std::ifstream(port_file_) >> port) {
      address_ = absl::StrCat("127.0.0.1:", port);
      return absl::OkStatus();
    }
    int status = 0;
    if (waitpid(child_, &status, WNOHANG) == child_) {
      child_ = -1;
      if (WIFEXITED(status) && WEXITSTATUS(status) == kCannotExecute) {
        return absl::NotFoundError(
            "groundlock-server is neither beside this program nor in PATH: "
            "install it, or name a running one with --server HOST:PORT");
      }
      return absl::UnavailableError(absl::StrCat(
          "the program's own server ended at once; its log: ", log_.string()));
    }
    if (is_cancelled()) return absl::CancelledError("cancelled");
    if (Clock::now() > end) {
      return absl::UnavailableError(
          absl::StrCat("the program's own server does not serve after ",
                       kStartLimit.count(),
                       " s; its log: ",
                       log_.string()));
    }
    std::this_thread::sleep_for(kPollInterval);
  }
}

}  // namespace groundlock::cli
