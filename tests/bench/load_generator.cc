// SPDX-License-Identifier: Apache-2.0
// Sessions that send real JPEG frames at a camera's rate over real sockets, and
// what they get back: latency from capture to result, frames dropped, processor
// time per frame. Starts a server of its own in this process, so that its
// processor time is the client's and the server's together, or loads another.
//   load_generator [--sessions N] [--fps R] [--seconds S] [--server HOST:PORT]
//                  [--tls FOLDER]
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "client/sdk/client.h"
#include "map_store/base/file.h"
#include "map_store/base/mutex.h"
#include "map_store/base/process.h"
#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "map_store/formats/formats.h"
#include "map_store/storage/store.h"
#include "server/service/server.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

using Clock = std::chrono::steady_clock;
using test_support::Quantile;
using test_support::Quantiles;

struct Arguments {
  std::string server;
  std::string sequence = "occlusion";
  std::string tracker;
  // As deploy/certificates.sh leaves it; empty: no encryption.
  std::filesystem::path tls;
  int sessions = 8;
  double frames_per_second = 24.0;
  double seconds = 20.0;
  double warm_up_s = 3.0;
  int workers = 0;
};

double Milliseconds(Clock::duration duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

// Processor time of this process' threads so far, in seconds, by name.
std::map<std::string, double> CpuSecondsByThread() {
  const double ticks_per_s = static_cast<double>(sysconf(_SC_CLK_TCK));
  std::map<std::string, double> seconds;
  for (const auto& task :
       std::filesystem::directory_iterator("/proc/self/task")) {
    std::ifstream file(task.path() / "stat");
    std::string line;
    std::getline(file, line);
    // "ID (NAME) STATE ..."; user and system time are the 12th and the 13th
    // after the name.
    const std::size_t begin = line.find('(');
    const std::size_t end = line.rfind(')');
    if (begin == std::string::npos || end == std::string::npos) continue;
    std::istringstream rest(line.substr(end + 1));
    std::string skipped;
    for (int i = 0; i < 12 && rest >> skipped; ++i) {
    }
    const double user = std::atof(skipped.c_str());
    rest >> skipped;
    seconds[line.substr(begin + 1, end - begin - 1)] +=
        (user + std::atof(skipped.c_str())) / ticks_per_s;
  }
  return seconds;
}

// What all sessions measured, after the warm-up.
class Report {
 public:
  explicit Report(std::uint64_t first_sequence)
      : first_sequence_(first_sequence) {}

  void Add(const sdk::FrameReply& reply, double latency_ms) {
    const std::uint64_t sequence = sdk::SequenceOf(reply);
    const base::MutexLock lock(&mutex_);
    const auto* result = std::get_if<sdk::FrameResult>(&reply);
    if (sequence < first_sequence_) return;
    ++frames_;
    if (std::holds_alternative<sdk::FrameDropped>(reply)) ++dropped_;
    if (std::holds_alternative<sdk::FrameError>(reply)) ++failed_;
    if (result == nullptr) return;
    latency_ms_.push_back(latency_ms);
    tracked_ += result->camera.state == sdk::CameraState::kTracked;
    for (const sdk::TargetResult& target : result->targets) {
      targets_tracked_ += target.state == sdk::TargetState::kTracked;
    }
    queue_ms_.push_back(result->times.queue_ms);
    decode_ms_.push_back(result->times.decode_ms);
    localize_ms_.push_back(result->times.localize_ms);
    track_ms_.push_back(result->times.track_ms);
    total_ms_.push_back(result->times.total_ms);
  }

  //   cpu_s  since the warm-up, by thread.
  void Print(const std::map<std::string, double>& cpu_s,
             double wall_s,
             bool whole_process) const {
    const base::MutexLock lock(&mutex_);
    const double frames = std::max(1, frames_);
    std::printf(
        "%d frames in %.1f s (%.1f per second): %d dropped, %d failed, camera "
        "tracked in %.2f %%, target in %.2f %%\n",
        frames_,
        wall_s,
        frames_ / wall_s,
        dropped_,
        failed_,
        100.0 * tracked_ / frames,
        100.0 * targets_tracked_ / frames);
    double all_s = 0.0;
    for (const auto& [thread, seconds] : cpu_s) all_s += seconds;
    std::printf("CPU per frame, %s: %.2f ms:",
                whole_process ? "server and client together" : "client alone",
                1e3 * all_s / frames);
    for (const auto& [thread, seconds] : cpu_s) {
      if (seconds < 0.01 * all_s) continue;
      std::printf("  %s %.2f", thread.c_str(), 1e3 * seconds / frames);
    }
    std::printf("\n");
    std::printf("capture to result, ms  %s\n", Quantiles(latency_ms_).c_str());
    std::printf("  queue                %s\n", Quantiles(queue_ms_).c_str());
    std::printf("  decode               %s\n", Quantiles(decode_ms_).c_str());
    std::printf("  localize             %s\n", Quantiles(localize_ms_).c_str());
    std::printf("  track                %s\n", Quantiles(track_ms_).c_str());
    std::printf("  server, all          %s\n", Quantiles(total_ms_).c_str());
  }

 private:
  const std::uint64_t first_sequence_;
  mutable base::Mutex mutex_;
  int frames_ ABSL_GUARDED_BY(mutex_) = 0;
  int dropped_ ABSL_GUARDED_BY(mutex_) = 0;
  int failed_ ABSL_GUARDED_BY(mutex_) = 0;
  int tracked_ ABSL_GUARDED_BY(mutex_) = 0;
  int targets_tracked_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<double> latency_ms_ ABSL_GUARDED_BY(mutex_);
  std::vector<double> queue_ms_ ABSL_GUARDED_BY(mutex_);
  std::vector<double> decode_ms_ ABSL_GUARDED_BY(mutex_);
  std::vector<double> localize_ms_ ABSL_GUARDED_BY(mutex_);
  std::vector<double> track_ms_ ABSL_GUARDED_BY(mutex_);
  std::vector<double> total_ms_ ABSL_GUARDED_BY(mutex_);
};

// One camera: frames of the sequence forwards and backwards, without an end.
// Take one that turns around slowly: a camera that is thrown into reverse from
// one frame to the next is rightly doubted, and searched for.
class Camera {
 public:
  static absl::StatusOr<std::unique_ptr<Camera>> Start(
      sdk::Client* client,
      const sdk::SessionSpec& spec,
      const std::vector<std::string>* jpegs,
      const std::optional<geometry::Box2>& target_px,
      Report* report) {
    std::unique_ptr<Camera> camera(new Camera(jpegs, report));
    ASSIGN_OR_RETURN(const sdk::SessionInfo session,
                     client->CreateSession(spec));
    if (target_px) {
      RETURN_IF_ERROR(client
                          ->SetTarget(session.spec.session_id,
                                      "target",
                                      *target_px,
                                      std::uint64_t{1})
                          .status());
    }
    sdk::TrackingStreamOptions options;
    options.max_in_flight = 64;  // a late answer does not hold the camera back
    options.on_reply = [raw = camera.get()](const sdk::FrameReply& reply) {
      raw->OnReply(reply);
    };
    ASSIGN_OR_RETURN(camera->stream_,
                     client->Track(session.spec.session_id, options));
    return camera;
  }

  // Sends `count` frames, the first at `begin`; returns when all are answered.
  absl::Status Run(Clock::time_point begin,
                   Clock::duration interval,
                   int count) {
    begin_ = begin;
    interval_ = interval;
    const int last = static_cast<int>(jpegs_->size()) - 1;
    for (int i = 0; i < count; ++i) {
      std::this_thread::sleep_until(begin_ + i * interval_);
      const int phase = i % (2 * last);
      sdk::Frame frame;
      frame.sequence = static_cast<std::uint64_t>(i) + 1;
      frame.capture_time = i * interval_;
      frame.image.encoding = sdk::ImageEncoding::kJpeg;
      frame.image.bytes = (*jpegs_)[phase <= last ? phase : 2 * last - phase];
      RETURN_IF_ERROR(stream_->Send(std::move(frame)));
    }
    return stream_->Finish();
  }

 private:
  Camera(const std::vector<std::string>* jpegs, Report* report)
      : jpegs_(jpegs), report_(report) {}

  void OnReply(const sdk::FrameReply& reply) {
    const auto i = static_cast<int>(sdk::SequenceOf(reply)) - 1;
    report_->Add(reply, Milliseconds(Clock::now() - (begin_ + i * interval_)));
  }

  const std::vector<std::string>* jpegs_;
  Report* report_;
  Clock::time_point begin_;
  Clock::duration interval_{};
  std::unique_ptr<sdk::TrackingStream> stream_;
};

absl::Status ImportMap(sdk::Client& client,
                       const test_support::Sequence& sequence) {
  sdk::ImportRequest request;
  request.name = "load";
  ASSIGN_OR_RETURN(const formats::ImportFiles files,
                   formats::FindImportFiles(sequence.reconstruction, {}));
  for (const formats::ImportFile& file : files.files) {
    request.files.push_back({file.path, file.remote});
  }
  request.model_path = files.model;
  request.database_path = files.database;
  if (!sequence.align.empty()) {
    ASSIGN_OR_RETURN(request.world_from_source,
                     test_support::ReadAlignment(sequence.align));
  }
  return client.ImportMap(request).status();
}

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(const auto sequence,
                   test_support::FindSequence(arguments.sequence));
  ASSIGN_OR_RETURN(const auto camera_model,
                   test_support::ReadCamera(sequence.camera));
  ASSIGN_OR_RETURN(const auto truth,
                   test_support::ReadTrueFrames(sequence.truth));
  ASSIGN_OR_RETURN(const auto images,
                   test_support::ReadFrames(sequence.video, 1));
  std::vector<std::string> jpegs;
  for (const auto& [index, image] : images) {
    const std::vector<std::uint8_t> bytes = test_support::EncodeJpeg(image);
    jpegs.emplace_back(bytes.begin(), bytes.end());
  }
  if (jpegs.size() < 2) return absl::InvalidArgumentError("too few frames");

  ASSIGN_OR_RETURN(
      const auto directory,
      base::TemporaryDirectory::Create(std::filesystem::temp_directory_path()));
  service::Metrics metrics;
  std::unique_ptr<storage::Store> store;
  std::unique_ptr<service::GroundlockServer> server;
  std::string address = arguments.server;
  if (address.empty()) {
    ASSIGN_OR_RETURN(store,
                     storage::OpenStore((directory.path() / "store").string()));
    service::ServerOptions options;
    options.listen = "127.0.0.1:0";
    options.scratch_directory = (directory.path() / "scratch").string();
    options.worker_threads = arguments.workers;
    if (!arguments.tls.empty()) {
      options.tls.certificate = arguments.tls / "server.pem";
      options.tls.key = arguments.tls / "server.key";
    }
    ASSIGN_OR_RETURN(
        server,
        service::GroundlockServer::Start(options, store.get(), &metrics));
    address = "127.0.0.1:" + std::to_string(server->port());
  }
  sdk::ClientOptions client_options;
  if (!arguments.tls.empty()) {
    client_options.tls.enabled = true;
    client_options.tls.ca = arguments.tls / "ca.pem";
  }
  ASSIGN_OR_RETURN(const auto client,
                   sdk::Client::Connect(address, client_options));
  RETURN_IF_ERROR(ImportMap(*client, sequence));

  sdk::SessionSpec spec;
  spec.map_name = "load";
  spec.camera = camera_model;
  spec.options.flow_mode = sdk::FlowMode::kLive;
  spec.options.tracker = arguments.tracker;
  const auto interval = std::chrono::duration_cast<Clock::duration>(
      std::chrono::duration<double>(1.0 / arguments.frames_per_second));
  const int warm_up =
      static_cast<int>(arguments.warm_up_s * arguments.frames_per_second);
  const int measured =
      static_cast<int>(arguments.seconds * arguments.frames_per_second);
  Report report(static_cast<std::uint64_t>(warm_up) + 1);
  const auto first = truth.find(0);
  std::vector<std::unique_ptr<sdk::Client>> clients;
  std::vector<std::unique_ptr<Camera>> cameras;
  for (int i = 0; i < arguments.sessions; ++i) {
    // A connection each, as from a camera each.
    ASSIGN_OR_RETURN(clients.emplace_back(),
                     sdk::Client::Connect(address, client_options));
    ASSIGN_OR_RETURN(
        cameras.emplace_back(),
        Camera::Start(
            clients.back().get(),
            spec,
            &jpegs,
            first != truth.end() ? first->second.target_px : std::nullopt,
            &report));
  }
  const Clock::time_point begin = Clock::now() + std::chrono::milliseconds(100);
  std::vector<absl::Status> statuses(cameras.size());
  std::map<std::string, double> cpu_start;
  std::map<std::string, double> cpu;
  {
    std::vector<std::jthread> threads;
    base::NameThisThread("cameras");  // and those it starts
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      // Cameras do not fire together.
      const Clock::duration offset = interval * i / cameras.size();
      threads.emplace_back([&, i, offset] {
        statuses[i] =
            cameras[i]->Run(begin + offset, interval, warm_up + measured);
      });
    }
    std::this_thread::sleep_until(begin + warm_up * interval);
    cpu_start = CpuSecondsByThread();
    // Before the cameras' threads end, and with them their count.
    std::this_thread::sleep_until(begin + (warm_up + measured) * interval);
    cpu = CpuSecondsByThread();
  }
  for (auto& [thread, seconds] : cpu) seconds -= cpu_start[thread];
  const double wall_s =
      std::chrono::duration<double>(Clock::now() - begin).count() -
      arguments.warm_up_s;
  for (const absl::Status& status : statuses) RETURN_IF_ERROR(status);
  std::printf("%d sessions at %.0f frames/s\n",
              arguments.sessions,
              arguments.frames_per_second);
  report.Print(cpu, wall_s, server != nullptr);
  cameras.clear();
  if (server != nullptr) server->Shutdown(std::chrono::seconds(5));
  return absl::OkStatus();
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) {
  groundlock::bench::Arguments arguments;
  CLI::App app("Loads a server with sessions at a camera's rate");
  app.add_option("--server", arguments.server, "HOST:PORT; its own if none");
  app.add_option("--tls", arguments.tls, "folder of deploy/certificates.sh");
  app.add_option("--sequence", arguments.sequence);
  app.add_option("--tracker", arguments.tracker);
  app.add_option("--sessions", arguments.sessions)->check(CLI::PositiveNumber);
  app.add_option("--fps", arguments.frames_per_second)
      ->check(CLI::PositiveNumber);
  app.add_option("--seconds", arguments.seconds)->check(CLI::PositiveNumber);
  app.add_option("--workers", arguments.workers, "of its own server");
  CLI11_PARSE(app, argc, argv);
  groundlock::features::SetUpOpenCv();
  const absl::Status status = groundlock::bench::Run(arguments);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
