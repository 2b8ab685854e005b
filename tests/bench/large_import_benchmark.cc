// SPDX-License-Identifier: Apache-2.0
// A reconstruction of a million landmarks and five million observations
// through the programs themselves: `groundlock map import` into a server over a
// real socket, then sessions in the map. Time, and the server's memory.
//   large_import_benchmark [--landmarks N] [--views N] [--folder MODEL]
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/sdk/client.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "tests/support/large_colmap_model.h"

extern char** environ;

namespace groundlock::bench {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// A program of ours, ended with this object.
class Child {
 public:
  explicit Child(std::vector<std::string> arguments) {
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    if (posix_spawn(&pid_, argv[0], nullptr, nullptr, argv.data(), environ) !=
        0) {
      pid_ = 0;
    }
  }
  ~Child() {
    if (pid_ == 0) return;
    kill(pid_, SIGTERM);
    Wait();
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  // Its exit code, -1 if there is none.
  int Wait() {
    int status = -1;
    if (pid_ != 0) waitpid(pid_, &status, 0);
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  // A field of its /proc/PID/status, MiB.
  double StatusMib(const std::string& field) const {
    std::ifstream status(absl::StrCat("/proc/", pid_, "/status"));
    std::string word;
    while (status >> word) {
      double kib = 0.0;
      if (word == field + ":" && status >> kib) return kib / 1024.0;
    }
    return 0.0;
  }
  double CpuSeconds() const {
    std::ifstream stat(absl::StrCat("/proc/", pid_, "/stat"));
    std::string word;
    double ticks = 0.0;
    for (int field = 1; stat >> word && field <= 15; ++field) {
      if (field >= 14) ticks += std::stod(word);
    }
    return ticks / static_cast<double>(sysconf(_SC_CLK_TCK));
  }

 private:
  pid_t pid_ = 0;
};

struct Server {
  std::unique_ptr<Child> child;
  std::unique_ptr<sdk::Client> client;
  std::string address;
};

absl::StatusOr<Server> StartServer(const fs::path& folder) {
  const fs::path port_file = folder / "port";
  std::error_code ignored;
  fs::remove(port_file, ignored);
  Server server;
  server.child = std::make_unique<Child>(
      std::vector<std::string>{GROUNDLOCK_SERVER,
                               "--listen",
                               "127.0.0.1:0",
                               "--store",
                               (folder / "store").string(),
                               "--port-file",
                               port_file.string()});
  int port = 0;
  for (int i = 0; i < 600 && port == 0; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    std::ifstream(port_file) >> port;
  }
  if (port == 0) return absl::InternalError("the server does not start");
  server.address = absl::StrCat("127.0.0.1:", port);
  ASSIGN_OR_RETURN(server.client, sdk::Client::Connect(server.address));
  return server;
}

// The kernel forgets the file's pages, as after a restart of the machine.
void DropFromCache(const fs::path& path) {
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return;
  fdatasync(fd);
  posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
  close(fd);
}

absl::Status OpenSession(const std::string& name, Server* server) {
  sdk::SessionSpec spec;
  spec.session_id = name;
  spec.map_name = "large";
  const double params[] = {1'000.0, 640.0, 480.0};
  ASSIGN_OR_RETURN(
      spec.camera,
      geometry::CameraModel::Create(
          geometry::CameraModelId::kSimplePinhole, 1'280, 960, params));
  const double before_mib = server->child->StatusMib("VmRSS");
  const Clock::time_point start = Clock::now();
  RETURN_IF_ERROR(server->client->CreateSession(spec).status());
  const double open_ms = 1e3 * SecondsSince(start);
  std::printf("session '%s': %.1f ms, %.1f MiB more resident\n",
              name.c_str(),
              open_ms,
              server->child->StatusMib("VmRSS") - before_mib);
  return absl::OkStatus();
}

absl::Status Import(const fs::path& model, Server* server) {
  const double before_mib = server->child->StatusMib("VmHWM");
  const double cpu_s = server->child->CpuSeconds();
  const Clock::time_point start = Clock::now();
  Child import({GROUNDLOCK,
                "map",
                "import",
                "large",
                model.string(),
                "--server",
                server->address});
  if (import.Wait() != 0) return absl::InternalError("the import failed");
  std::printf(
      "import: %.1f s, server %.1f s of CPU, its memory at most %.0f MiB "
      "resident (%.0f before)\n",
      SecondsSince(start),
      server->child->CpuSeconds() - cpu_s,
      server->child->StatusMib("VmHWM"),
      before_mib);
  return absl::OkStatus();
}

absl::Status Run(const test_support::LargeModelOptions& options,
                 const fs::path& given) {
  ASSIGN_OR_RETURN(const auto directory,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  const fs::path model = given.empty() ? directory.path() / "model" : given;
  if (!fs::exists(model / "database.db")) {
    fs::create_directories(model);
    const Clock::time_point start = Clock::now();
    RETURN_IF_ERROR(test_support::WriteLargeColmapModel(options, model));
    std::uintmax_t bytes = 0;
    for (const auto& file : fs::directory_iterator(model)) {
      bytes += file.file_size();
    }
    std::printf("model: %.0f MiB, written in %.0f s\n",
                static_cast<double>(bytes) / (1 << 20),
                SecondsSince(start));
  }
  std::fflush(stdout);
  {
    ASSIGN_OR_RETURN(Server server, StartServer(directory.path()));
    RETURN_IF_ERROR(Import(model, &server));
    server.client = nullptr;
  }
  for (const auto& file :
       fs::directory_iterator(directory.path() / "store" / "maps")) {
    std::printf("map file: %.0f MiB\n",
                static_cast<double>(file.file_size()) / (1 << 20));
    DropFromCache(file.path());
  }
  ASSIGN_OR_RETURN(Server server, StartServer(directory.path()));
  std::printf("a new server: %.1f MiB resident\n",
              server.child->StatusMib("VmRSS"));
  for (const char* name : {"first", "second", "third"}) {
    RETURN_IF_ERROR(OpenSession(name, &server));
  }
  server.client = nullptr;
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) {
  groundlock::test_support::LargeModelOptions options;
  std::filesystem::path folder;
  CLI::App app("Import and opening of a large reconstruction");
  app.add_option("--landmarks", options.num_landmarks)->capture_default_str();
  app.add_option("--views", options.num_views)->capture_default_str();
  app.add_option("--observations",
                 options.observations_per_landmark,
                 "of each landmark")
      ->capture_default_str();
  app.add_option("--loose-features",
                 options.loose_features_per_view,
                 "features of each view that observe nothing")
      ->capture_default_str();
  app.add_option(
      "--folder", folder, "where the model lies, or is written to and kept");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = groundlock::bench::Run(options, folder);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
