// SPDX-License-Identifier: Apache-2.0
// A server under churn for as long as one likes: sessions, targets, watchers,
// imports, connections that break, bytes that are nothing, clients that say
// nothing more. Prints now and then what the server holds, which is to stay
// flat, and what has been done to it.
//   soak [--minutes M] [--sample-s S] [--only WHAT,WHAT]
#include <arpa/inet.h>
#include <grpcpp/grpcpp.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "groundlock/v1/tracking.grpc.pb.h"
#include "map_store/base/status.h"
#include "map_store/base/token_file.h"
#include "tests/bench/child_program.h"
#include "tests/integration/raw_call.h"
#include "tests/integration/test_server.h"
#include "tests/integration/text_model.h"
#include "tests/support/random_message.h"

namespace groundlock::bench {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

struct Arguments {
  double minutes = 60.0;
  double sample_s = 60.0;
  std::vector<std::string> only;  // empty: everything
};

// What the threads share.
struct Soak {
  std::string address;
  int port = 0;
  std::string token;      // of the many
  std::string low_token;  // of the one with random calls
  fs::path folder;
  std::atomic<bool> stop{false};
  std::atomic<int> sessions{0};
  std::atomic<int> frames{0};
  std::atomic<int> watched{0};
  std::atomic<int> imports{0};
  std::atomic<int> broken{0};
  std::atomic<int> garbage{0};
  std::atomic<int> half_open{0};
  std::atomic<int> random_calls{0};
  std::atomic<int> failures{0};  // of what should have worked
};

void Check(Soak& soak, const absl::Status& status, const char* what) {
  if (status.ok() || soak.stop) return;
  if (++soak.failures <= 20) {
    std::fprintf(stderr, "%s: %s\n", what, status.ToString().c_str());
  }
}

std::unique_ptr<sdk::Client> Connect(const Soak& soak) {
  sdk::ClientOptions options;
  options.token = soak.token;
  auto client = sdk::Client::Connect(soak.address, options);
  return client.ok() ? *std::move(client) : nullptr;
}

// Sessions that begin, are fed and end, over connections that do likewise.
void ChurnSessions(Soak& soak, int number) {
  for (int round = 0; !soak.stop; ++round) {
    const auto client = Connect(soak);
    if (client == nullptr) {
      Check(soak, absl::UnavailableError("no connection"), "session");
      continue;
    }
    const std::string id = "churn-" + std::to_string(number);
    Check(soak, client->CreateSession(test::Spec(id)).status(), "create");
    Check(soak,
          client->SetTarget(id, "", geometry::Box2::FromXywh(20, 40, 24, 24))
              .status(),
          "target");
    auto stream = client->Track(id);
    Check(soak, stream.status(), "track");
    if (stream.ok()) {
      for (std::uint64_t i = 0; i < 40; ++i) {
        const int x = 20 + static_cast<int>(i);
        Check(soak, (*stream)->Send(test::SquareFrame(i, x, 40)), "send");
        const auto reply = (*stream)->Next();
        Check(soak, reply.status(), "reply");
        if (!reply.ok()) break;
        ++soak.frames;
      }
      // Every third one is not closed, but let go.
      if (round % 3 == 0) {
        (*stream)->Cancel();
      } else {
        Check(soak, (*stream)->Finish(), "finish");
      }
    }
    Check(soak, client->DeleteSession(id), "delete");
    ++soak.sessions;
  }
}

// Whoever watches, with images and without, and leaves.
void ChurnWatchers(Soak& soak) {
  const auto client = Connect(soak);
  if (client == nullptr) return;
  for (int round = 0; !soak.stop; ++round) {
    const std::string id = "churn-" + std::to_string(round % 2);
    const auto watch = client->Watch(id, round % 2 == 0);
    if (!watch.ok()) {  // between two sessions
      std::this_thread::sleep_for(milliseconds(20));
      continue;
    }
    for (int i = 0; i < 5 && (*watch)->Next().ok(); ++i) ++soak.watched;
    (*watch)->Cancel();
  }
}

void ChurnMaps(Soak& soak) {
  const auto client = Connect(soak);
  if (client == nullptr) return;
  const auto request =
      test::WriteForImport(soak.folder, "soak", test::TextModel());
  while (!soak.stop) {
    for (int i = 0; i < 3; ++i) {
      Check(soak, client->ImportMap(request).status(), "import");
      ++soak.imports;
    }
    Check(soak, client->ListMaps().status(), "list");
    Check(soak, client->DeleteMap("soak"), "delete map");
    std::this_thread::sleep_for(milliseconds(500));
  }
}

// Calls of a client that is gone in the middle of them.
void BreakCalls(Soak& soak) {
  std::mt19937 random(1);
  while (!soak.stop) {
    const auto channel = test::RawChannel(soak.address);
    const auto stub = v1::TrackingService::NewStub(channel);
    for (int i = 0; i < 10 && !soak.stop; ++i) {
      grpc::ClientContext context;
      context.AddMetadata("authorization", "Bearer " + soak.token);
      const auto stream = stub->Track(&context);
      v1::TrackRequest request;
      if (i % 2 == 0) request.mutable_attach()->set_session_id("churn-9");
      stream->Write(request);
      std::this_thread::sleep_for(milliseconds(random() % 20));
      context.TryCancel();
      v1::TrackResponse response;
      while (stream->Read(&response)) {
      }
      stream->Finish();
      ++soak.broken;
    }
  }
}

int Dial(int port) {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<std::uint16_t>(port));
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (connect(fd, reinterpret_cast<const sockaddr*>(&to), sizeof(to)) != 0) {
    close(fd);
    return -1;
  }
  return fd;
}

// Bytes that are nothing, or begin as HTTP/2 and end there; and connections of
// which nothing more is heard for a while.
void Bother(Soak& soak) {
  const std::string preface = "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
  std::mt19937 random(2);
  std::deque<int> silent;
  while (!soak.stop) {
    const int fd = Dial(soak.port);
    if (fd < 0) {
      Check(soak, absl::UnavailableError("cannot dial"), "bother");
      std::this_thread::sleep_for(milliseconds(100));
      continue;
    }
    std::string bytes = random() % 2 == 0 ? preface : "";
    for (unsigned i = random() % 2'000; i > 0; --i) {
      bytes += static_cast<char>(random());
    }
    send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    ++soak.garbage;
    if (random() % 4 == 0) {
      silent.push_back(fd);
      ++soak.half_open;
    } else {
      close(fd);
    }
    if (silent.size() > 50) {
      close(silent.front());
      silent.pop_front();
    }
    std::this_thread::sleep_for(milliseconds(20));
  }
  for (const int fd : silent) close(fd);
}

void CallAtRandom(Soak& soak) {
  test_support::RandomMessages random(3, {"churn-0", "soak", "0"});
  const auto methods = test::EveryMethod();
  const auto channel = test::RawChannel(soak.address);
  while (!soak.stop) {
    const auto* method = methods[random.Below(methods.size())];
    const auto request = test::NewMessage(*method->input_type());
    test::CallRaw(channel,
                  test::PathOf(*method),
                  "Bearer " + soak.low_token,
                  {random.Bytes(*request)},
                  /*max_answers=*/3,
                  milliseconds(300));
    ++soak.random_calls;
    std::this_thread::sleep_for(milliseconds(5));
  }
}

void PrintRow(const Soak& soak, const ChildProgram& server, double minutes) {
  std::printf("%8.2f %9.1f %8d %6d %9d %9d %8d %8d %8d %8d %8d %8d %8d %9d\n",
              minutes,
              server.ResidentMib(),
              server.NumThreads(),
              server.NumOpenFiles(),
              soak.sessions.load(),
              soak.frames.load(),
              soak.watched.load(),
              soak.imports.load(),
              soak.broken.load(),
              soak.garbage.load(),
              soak.half_open.load(),
              soak.random_calls.load(),
              soak.failures.load(),
              static_cast<int>(server.CpuSeconds()));
  std::fflush(stdout);
}

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(const auto directory,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  Soak soak;
  soak.folder = directory.path();
  const fs::path tokens = directory.path() / "tokens";
  ASSIGN_OR_RETURN(soak.token,
                   base::CreateToken(tokens, {"many", "", {"admin"}, "", {}}));
  base::Quotas few;
  few.sessions = 8;
  ASSIGN_OR_RETURN(
      soak.low_token,
      base::CreateToken(tokens,
                        {"low", "", {"sessions:own", "maps:read"}, "", few}));
  const fs::path port_file = directory.path() / "port";
  ChildProgram server({GROUNDLOCK_SERVER,
                       "--listen",
                       "127.0.0.1:0",
                       "--store",
                       (directory.path() / "store").string(),
                       "--token-file",
                       tokens.string(),
                       "--client-timeout",
                       "10",
                       "--idle-timeout",
                       "30",
                       "--port-file",
                       port_file.string(),
                       "--log-level",
                       "error"},
                      directory.path() / "log");
  ASSIGN_OR_RETURN(const std::string port, PortIn(port_file));
  soak.address = "127.0.0.1:" + port;
  soak.port = std::stoi(port);
  std::printf(
      " minutes   RSS MiB  threads  files  sessions    frames  watched  "
      "imports   broken  garbage half-open   random failures  server s\n");
  PrintRow(soak, server, 0.0);
  std::vector<std::thread> threads;
  const auto start = [&](const char* name, const auto& work) {
    const auto& only = arguments.only;
    if (!only.empty() &&
        std::find(only.begin(), only.end(), name) == only.end()) {
      return;
    }
    threads.emplace_back(work);
  };
  start("sessions", [&soak] { ChurnSessions(soak, 0); });
  start("sessions", [&soak] { ChurnSessions(soak, 1); });
  start("watchers", [&soak] { ChurnWatchers(soak); });
  start("maps", [&soak] { ChurnMaps(soak); });
  start("broken", [&soak] { BreakCalls(soak); });
  start("garbage", [&soak] { Bother(soak); });
  start("random", [&soak] { CallAtRandom(soak); });
  const auto begin = Clock::now();
  const std::chrono::duration<double> length(60.0 * arguments.minutes);
  for (int sample = 1; Clock::now() - begin < length; ++sample) {
    std::this_thread::sleep_until(
        begin +
        std::chrono::duration_cast<Clock::duration>(
            std::chrono::duration<double>(sample * arguments.sample_s)));
    const std::chrono::duration<double> passed = Clock::now() - begin;
    PrintRow(soak, server, passed.count() / 60.0);
  }
  soak.stop = true;
  for (std::thread& thread : threads) thread.join();
  // What was under way is over, what was silent has been let go.
  std::this_thread::sleep_for(std::chrono::seconds(35));
  const std::chrono::duration<double> passed = Clock::now() - begin;
  std::printf("at rest:\n");
  PrintRow(soak, server, passed.count() / 60.0);
  const auto client = Connect(soak);
  if (client == nullptr) return absl::InternalError("it answers no more");
  return client->ListSessions().status();
}

int Main(int argc, char** argv) {
  CLI::App app("A server under churn");
  Arguments arguments;
  app.add_option("--minutes", arguments.minutes)->capture_default_str();
  app.add_option("--sample-s", arguments.sample_s)->capture_default_str();
  app.add_option("--only",
                 arguments.only,
                 "sessions, watchers, maps, broken, garbage, random; to see "
                 "which of them costs what")
      ->delimiter(',');
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = Run(arguments);
  if (status.ok()) return EXIT_SUCCESS;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return EXIT_FAILURE;
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) { return groundlock::bench::Main(argc, argv); }
