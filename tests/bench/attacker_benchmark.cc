// SPDX-License-Identifier: Apache-2.0
// What somebody with a token that is good for little can do to the frames of
// others: a session streams at a camera's rate, alone and while thousands of
// random calls are made, in turns; prints how long its frames took.
//   attacker_benchmark [--calls N] [--rounds R] [--fps F]
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <thread>
#include <vector>

#include "client/sdk/client.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "map_store/base/token_file.h"
#include "tests/bench/child_program.h"
#include "tests/integration/raw_call.h"
#include "tests/support/random_message.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

struct Arguments {
  int calls = 10'000;
  int rounds = 10;
  int attackers = 4;
  double frames_per_second = 24.0;
  double alone_s = 5.0;  // of each round
  // Of the process that attacks: whom, with what.
  std::string attack;
  std::string token;
  std::uint64_t seed = 0;
};

// A square that moves over a structured ground, 1280x720, as a camera sends it.
std::vector<std::string> DrawFrames() {
  cv::Mat ground(720, 1280, CV_8UC3);
  cv::RNG random(1);
  random.fill(ground, cv::RNG::UNIFORM, 60, 160);
  cv::GaussianBlur(ground, ground, {0, 0}, 3.0);
  std::vector<std::string> frames;
  for (int i = 0; i < 96; ++i) {
    cv::Mat image = ground.clone();
    const int x = 400 + 3 * (i < 48 ? i : 96 - i);
    cv::rectangle(image, {x, 300, 60, 60}, {20, 20, 220}, cv::FILLED);
    cv::rectangle(image, {x + 15, 315, 20, 30}, {230, 200, 20}, cv::FILLED);
    std::vector<std::uint8_t> jpeg;
    cv::imencode(".jpg", image, jpeg, {cv::IMWRITE_JPEG_QUALITY, 75});
    frames.emplace_back(jpeg.begin(), jpeg.end());
  }
  return frames;
}

// Streams frames at their rate until told to stop, and keeps how long each
// took, ms, apart for those under attack.
class Victim {
 public:
  Victim(std::unique_ptr<sdk::TrackingStream> stream, double frames_per_second)
      : stream_(std::move(stream)),
        interval_(1.0 / frames_per_second),
        frames_(DrawFrames()) {}

  void Run() {
    auto next = Clock::now();
    for (std::uint64_t i = 0; !stop; ++i) {
      next += std::chrono::duration_cast<Clock::duration>(interval_);
      std::this_thread::sleep_until(next);
      const bool attacked = under_attack;
      const auto begin = Clock::now();
      sdk::Frame frame;
      frame.sequence = i;
      frame.capture_time = begin.time_since_epoch();
      frame.image = {
          sdk::ImageEncoding::kJpeg, frames_[i % frames_.size()], 0, 0};
      if (!stream_->Send(std::move(frame)).ok()) break;
      const auto reply = stream_->Next();
      const std::chrono::duration<double, std::milli> took =
          Clock::now() - begin;
      if (!reply.ok() || !reply->has_value() ||
          !std::holds_alternative<sdk::FrameResult>(**reply)) {
        ++failed;
        continue;
      }
      (attacked ? attacked_ms : alone_ms).push_back(took.count());
    }
  }

  std::atomic<bool> stop{false};
  std::atomic<bool> under_attack{false};
  std::atomic<int> failed{0};
  std::vector<double> alone_ms;
  std::vector<double> attacked_ms;

 private:
  std::unique_ptr<sdk::TrackingStream> stream_;
  const std::chrono::duration<double> interval_;
  const std::vector<std::string> frames_;
};

// Makes the calls, and prints how they ended. A process of its own, at the
// lowest priority: what its messages cost to make would not be this machine's.
void Attack(const Arguments& arguments) {
  setpriority(PRIO_PROCESS, 0, 19);
  std::map<int, int> answers;
  std::mutex mutex;
  std::vector<std::thread> threads;
  for (int a = 0; a < arguments.attackers; ++a) {
    threads.emplace_back([&, a] {
      test_support::RandomMessages random(
          arguments.seed * 100 + static_cast<std::uint64_t>(a),
          {"victim", "yard", "square", "0"});
      const auto methods = test::EveryMethod();
      const auto channel = test::RawChannel(arguments.attack);
      for (int i = 0; i < arguments.calls / arguments.attackers; ++i) {
        const auto* method = methods[random.Below(methods.size())];
        const auto request = test::NewMessage(*method->input_type());
        std::vector<std::string> messages;
        for (std::size_t m = random.Below(4) + 1; m > 0; --m) {
          messages.push_back(random.Bytes(*request));
        }
        const auto answer = test::CallRaw(channel,
                                          test::PathOf(*method),
                                          "Bearer " + arguments.token,
                                          messages,
                                          /*max_answers=*/3,
                                          std::chrono::milliseconds(300));
        const std::lock_guard<std::mutex> lock(mutex);
        ++answers[answer.status.error_code()];
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (const auto& [code, count] : answers) {
    std::printf("answers %d %d\n", code, count);
  }
}

// Adds what an attack has printed.
void AddAnswers(const fs::path& log, std::map<int, int>& answers) {
  std::ifstream stream(log);
  std::string line;
  while (std::getline(stream, line)) {
    int code = 0;
    int count = 0;
    if (std::sscanf(line.c_str(), "answers %d %d", &code, &count) == 2) {
      answers[code] += count;
    }
  }
}

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(const auto directory,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  const fs::path tokens = directory.path() / "tokens";
  ASSIGN_OR_RETURN(
      const std::string victims,
      base::CreateToken(tokens, {"victim", "", {"sessions:own"}, "", {}}));
  ASSIGN_OR_RETURN(
      const std::string attackers,
      base::CreateToken(
          tokens, {"attacker", "", {"sessions:own", "maps:read"}, "", {}}));
  const fs::path port_file = directory.path() / "port";
  ChildProgram server({GROUNDLOCK_SERVER,
                       "--listen",
                       "127.0.0.1:0",
                       "--store",
                       (directory.path() / "store").string(),
                       "--token-file",
                       tokens.string(),
                       "--port-file",
                       port_file.string()},
                      directory.path() / "log");
  ASSIGN_OR_RETURN(const std::string port, PortIn(port_file));
  const std::string address = "127.0.0.1:" + port;
  sdk::ClientOptions options;
  options.token = victims;
  ASSIGN_OR_RETURN(const auto client, sdk::Client::Connect(address, options));
  sdk::SessionSpec spec;
  spec.session_id = "victim";
  spec.options.flow_mode = sdk::FlowMode::kLive;
  RETURN_IF_ERROR(client->CreateSession(spec).status());
  RETURN_IF_ERROR(client
                      ->SetTarget("victim",
                                  "square",
                                  geometry::Box2::FromXywh(400, 300, 60, 60))
                      .status());
  ASSIGN_OR_RETURN(auto stream, client->Track("victim"));
  Victim victim(std::move(stream), arguments.frames_per_second);
  std::thread streaming([&victim] { victim.Run(); });

  std::map<int, int> answers;
  double attacked_s = 0.0;
  for (int round = 0; round < arguments.rounds; ++round) {
    std::this_thread::sleep_for(
        std::chrono::duration<double>(arguments.alone_s));
    victim.under_attack = true;
    const auto begin = Clock::now();
    const fs::path log = directory.path() / "attack";
    ChildProgram attack({"/proc/self/exe",
                         "--attack",
                         address,
                         "--token",
                         attackers,
                         "--seed",
                         std::to_string(round),
                         "--attackers",
                         std::to_string(arguments.attackers),
                         "--calls",
                         std::to_string(arguments.calls / arguments.rounds)},
                        log);
    attack.Wait();
    AddAnswers(log, answers);
    attacked_s += std::chrono::duration<double>(Clock::now() - begin).count();
    victim.under_attack = false;
  }
  victim.stop = true;
  streaming.join();
  const auto print = [](const char* name, const std::vector<double>& times) {
    std::printf(
        "%-9s %6zu frames, ms: median %6.2f  p95 %6.2f  p99 %6.2f  max %6.2f\n",
        name,
        times.size(),
        test_support::Quantile(times, 0.5),
        test_support::Quantile(times, 0.95),
        test_support::Quantile(times, 0.99),
        test_support::Quantile(times, 1.0));
  };
  print("alone", victim.alone_ms);
  print("attacked", victim.attacked_ms);
  int calls = 0;
  for (const auto& [code, count] : answers) calls += count;
  std::printf("%d calls in %.1f s; by gRPC's code:", calls, attacked_s);
  for (const auto& [code, count] : answers) {
    std::printf("  %d: %d", code, count);
  }
  std::printf("\nframes without a result: %d\np99 attacked : alone = %.2f\n",
              victim.failed.load(),
              test_support::Quantile(victim.attacked_ms, 0.99) /
                  test_support::Quantile(victim.alone_ms, 0.99));
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("Random calls of a stranger beside a session of another");
  Arguments arguments;
  app.add_option("--calls", arguments.calls)->capture_default_str();
  app.add_option("--rounds", arguments.rounds)->capture_default_str();
  app.add_option("--attackers", arguments.attackers)->capture_default_str();
  app.add_option("--fps", arguments.frames_per_second)->capture_default_str();
  app.add_option("--attack", arguments.attack)->group("");
  app.add_option("--token", arguments.token)->group("");
  app.add_option("--seed", arguments.seed)->group("");
  CLI11_PARSE(app, argc, argv);
  if (!arguments.attack.empty()) {
    Attack(arguments);
    return EXIT_SUCCESS;
  }
  const absl::Status status = Run(arguments);
  if (status.ok()) return EXIT_SUCCESS;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return EXIT_FAILURE;
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) { return groundlock::bench::Main(argc, argv); }
