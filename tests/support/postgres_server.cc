// SPDX-License-Identifier: Apache-2.0
#include "tests/support/postgres_server.h"

#include <fcntl.h>
#include <grp.h>
#include <pwd.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/postgres_connection.h"

namespace groundlock::test {
namespace {

namespace fs = std::filesystem;
using storage::internal::PostgresConnection;

// Debian keeps each version's programs in a folder of its own.
absl::StatusOr<std::string> FindPrograms() {
  std::vector<fs::path> folders;
  std::error_code error;
  for (fs::directory_iterator it("/usr/lib/postgresql", error), end;
       !error && it != end;
       it.increment(error)) {
    folders.push_back(it->path() / "bin");
  }
  std::sort(folders.rbegin(), folders.rend());
  folders.emplace_back("/usr/bin");
  for (const fs::path& folder : folders) {
    if (fs::exists(folder / "initdb", error) &&
        fs::exists(folder / "postgres", error)) {
      return folder.string();
    }
  }
  return absl::NotFoundError(
      "no initdb and postgres in /usr/lib/postgresql/*/bin or /usr/bin: "
      "install postgresql-15");
}

}  // namespace

absl::StatusOr<std::unique_ptr<PostgresServer>> PostgresServer::Start() {
  ASSIGN_OR_RETURN(std::string programs, FindPrograms());
  ASSIGN_OR_RETURN(base::TemporaryDirectory directory,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  std::unique_ptr<PostgresServer> server(
      new PostgresServer(std::move(directory)));
  server->programs_ = std::move(programs);
  if (geteuid() == 0) {
    const passwd* user = getpwnam("postgres");
    if (user == nullptr) {
      return absl::NotFoundError(
          "PostgreSQL does not run as root, and there is no user 'postgres'");
    }
    server->user_.emplace(user->pw_uid, user->pw_gid);
    if (chown(server->directory_.path().c_str(), user->pw_uid, user->pw_gid) !=
        0) {
      return absl::ErrnoToStatus(errno, "chown");
    }
  }
  RETURN_IF_ERROR(server->Initialize());
  RETURN_IF_ERROR(server->StartAgain());
  return server;
}

absl::StatusOr<PostgresServer*> PostgresServer::Shared() {
  static const absl::StatusOr<std::unique_ptr<PostgresServer>> server = Start();
  if (!server.ok()) return server.status();
  return server->get();
}

PostgresServer::~PostgresServer() {
  if (pid_ <= 0) return;
  kill(pid_, SIGQUIT);
  waitpid(pid_, nullptr, 0);
}

absl::StatusOr<pid_t> PostgresServer::Spawn(
    const std::vector<std::string>& command) const {
  std::vector<char*> argv;
  for (const std::string& word : command) {
    argv.push_back(const_cast<char*>(word.c_str()));
  }
  argv.push_back(nullptr);
  const std::string log = (directory_.path() / "log").string();
  const pid_t parent = getpid();
  const pid_t child = fork();
  if (child < 0) return absl::ErrnoToStatus(errno, "fork");
  if (child > 0) return child;
  if (user_.has_value() &&
      (setgroups(0, nullptr) != 0 || setgid(user_->second) != 0 ||
       setuid(user_->first) != 0)) {
    _exit(126);
  }
  // After the change of user, which would reset it.
  prctl(PR_SET_PDEATHSIG, SIGQUIT);
  const int fd = open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
  if (getppid() != parent || fd < 0 || chdir("/") != 0) _exit(126);
  dup2(fd, STDOUT_FILENO);
  dup2(fd, STDERR_FILENO);
  execv(argv[0], argv.data());
  _exit(127);
}

std::vector<std::string> PostgresServer::Command(
    const std::string& program) const {
  return {
      programs_ + "/" + program, "-D", (directory_.path() / "data").string()};
}

absl::Status PostgresServer::Initialize() {
  std::vector<std::string> command = Command("initdb");
  for (const char* word : {"--auth=trust",
                           "--username=groundlock",
                           "--encoding=UTF8",
                           "--locale=C",
                           "--no-sync"}) {
    command.emplace_back(word);
  }
  ASSIGN_OR_RETURN(const pid_t child, Spawn(command));
  int status = 0;
  if (waitpid(child, &status, 0) == child && WIFEXITED(status) &&
      WEXITSTATUS(status) == 0) {
    return absl::OkStatus();
  }
  const auto log = base::ReadFile(directory_.path() / "log", 1 << 20);
  return absl::InternalError(
      absl::StrCat("initdb failed: ", log.ok() ? *log : "no log"));
}

absl::Status PostgresServer::StartAgain() {
  std::vector<std::string> command = Command("postgres");
  for (const std::string& setting :
       {std::string("listen_addresses="),
        "unix_socket_directories=" + directory_.path().string(),
        // What the tests kill is the client: the server survives.
        std::string("fsync=off"),
        std::string("shared_buffers=16MB"),
        std::string("max_connections=50")}) {
    command.emplace_back("-c");
    command.push_back(setting);
  }
  ASSIGN_OR_RETURN(pid_, Spawn(command));
  absl::Status status;
  for (int i = 0; i < 4'000; ++i) {
    status = PostgresConnection::Connect(Url("postgres")).status();
    if (status.ok()) return status;
    if (waitpid(pid_, nullptr, WNOHANG) != 0) {
      pid_ = 0;  // it has given up
      break;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
  }
  const auto log = base::ReadFile(directory_.path() / "log", 1 << 20);
  return base::Annotate(status, log.ok() ? *log : "no log");
}

absl::Status PostgresServer::Stop() {
  if (kill(pid_, SIGINT) != 0 || waitpid(pid_, nullptr, 0) != pid_) {
    return absl::ErrnoToStatus(errno, "cannot stop PostgreSQL");
  }
  pid_ = 0;
  return absl::OkStatus();
}

std::string PostgresServer::Url(const std::string& database) const {
  return absl::StrCat("postgresql://groundlock@/",
                      database,
                      "?host=",
                      directory_.path().string());
}

absl::StatusOr<std::string> PostgresServer::MakeDatabase() {
  const std::string name = absl::StrCat("store", ++num_databases_);
  ASSIGN_OR_RETURN(const auto connection,
                   PostgresConnection::Connect(Url("postgres")));
  RETURN_IF_ERROR(
      connection->Execute(absl::StrCat("CREATE DATABASE ", name).c_str()));
  return Url(name);
}

}  // namespace groundlock::test
