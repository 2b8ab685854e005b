// SPDX-License-Identifier: Apache-2.0
// The whole way of a frame through a session, from its JPEG to its result, with
// re-anchoring on, stage by stage; `fast` and `baseline` in one run, accuracy
// beside time. Frames come at the camera's rate, so that anchors have the time
// between them that they have in life.
//   frame_path_benchmark [SEQUENCE…] [--repeat N] [--baseline-every N]
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <map>
#include <opencv2/core/utility.hpp>
#include <string>
#include <thread>
#include <vector>

#include "map_store/base/status.h"
#include "map_store/features/open_cv_setup.h"
#include "server/service/background_executor.h"
#include "server/tracking/tracking_session.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

using Clock = std::chrono::steady_clock;
using test_support::Quantile;
using test_support::Quantiles;
using test_support::ThreadCpuSeconds;

// A localizer that adds up what it takes of its thread's processor time.
class TimedLocalizer : public localization::Localizer {
 public:
  TimedLocalizer(std::unique_ptr<localization::Localizer> timed, double* cpu_s)
      : timed_(std::move(timed)), cpu_s_(cpu_s) {}

  absl::StatusOr<localization::LocalizationResult> Localize(
      const localization::LocalizationRequest& request) override {
    const double start = ThreadCpuSeconds();
    auto result = timed_->Localize(request);
    *cpu_s_ += ThreadCpuSeconds() - start;
    return result;
  }
  void Reset() override { timed_->Reset(); }

 private:
  std::unique_ptr<localization::Localizer> timed_;
  double* cpu_s_;
};

struct Arguments {
  std::vector<std::string> sequences = {
      "srun", "scale", "outofview", "occlusion"};
  std::string tracker = "dcf";
  int baseline_every = 24;
  bool unpaced = false;
};

double Milliseconds(Clock::duration duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

// Values by stage, in the order in which stages were first seen.
class Stages {
 public:
  void Add(const std::string& name, double value) {
    const auto [entry, is_new] = values_.try_emplace(name);
    if (is_new) order_.push_back(name);
    entry->second.push_back(value);
  }
  void Print() const {
    for (const std::string& name : order_) {
      std::printf(
          "  %-26s %s\n", name.c_str(), Quantiles(values_.at(name)).c_str());
    }
  }
  const std::vector<double>& operator[](const std::string& name) {
    return values_[name];
  }

 private:
  std::map<std::string, std::vector<double>> values_;
  std::vector<std::string> order_;
};

// Wall clock and processor time of a piece of the frame's thread.
template <typename Work>
void Measure(const std::string& name, Stages& stages, const Work& work) {
  const Clock::time_point start = Clock::now();
  const double cpu_start = ThreadCpuSeconds();
  work();
  stages.Add(name + ", CPU ms", 1e3 * (ThreadCpuSeconds() - cpu_start));
  stages.Add(name + ", ms", Milliseconds(Clock::now() - start));
}

class Benchmark {
 public:
  explicit Benchmark(const Arguments& arguments) : arguments_(arguments) {}

  absl::Status Run() {
    for (const std::string& name : arguments_.sequences) {
      RETURN_IF_ERROR(RunSequence(name));
    }
    std::printf("fast, %d frames, %d tracked (%.2f %%)\n",
                frames_,
                tracked_,
                100.0 * tracked_ / std::max(1, frames_));
    fast_.Print();
    std::printf("  anchors, CPU ms per frame  %8.3f\n",
                1e3 * anchor_cpu_s_ / std::max(1, frames_));
    std::printf("baseline, a sample of %zu frames\n",
                baseline_["localize, CPU ms"].size());
    baseline_.Print();
    std::printf("localize, baseline : fast, medians of CPU time  %.1f\n",
                Quantile(baseline_["localize, CPU ms"], 0.5) /
                    Quantile(fast_["localize, CPU ms"], 0.5));
    return absl::OkStatus();
  }

 private:
  absl::Status RunSequence(const std::string& name) {
    ASSIGN_OR_RETURN(sequence_, test_support::FindSequence(name));
    ASSIGN_OR_RETURN(
        map_,
        test_support::ImportMap(sequence_.reconstruction, sequence_.align));
    ASSIGN_OR_RETURN(camera_, test_support::ReadCamera(sequence_.camera));
    ASSIGN_OR_RETURN(truth_, test_support::ReadTrueFrames(sequence_.truth));
    jpegs_.clear();
    ASSIGN_OR_RETURN(const auto images,
                     test_support::ReadFrames(sequence_.video, 1));
    for (const auto& [index, image] : images) {
      jpegs_[index] = test_support::EncodeJpeg(image);
    }
    RETURN_IF_ERROR(RunFast());
    return RunBaseline();
  }

  absl::Status RunFast() {
    // As the server does it: one thread for the anchors of all sessions.
    service::BackgroundExecutor anchors(
        "anchors", 1, 64, service::BackgroundExecutor::Priority::kLow);
    tracking::SessionOptions options;
    options.tracker.name = arguments_.tracker;
    options.localization.wait_for_anchor = false;
    ASSIGN_OR_RETURN(auto localizer,
                     localization::CreateLocalizer(
                         options.localizer,
                         map_,
                         options.localization,
                         [&](auto, auto task) {
                           anchors.Post([this, task = std::move(task)] {
                             const double start = ThreadCpuSeconds();
                             task();
                             anchor_cpu_s_ += ThreadCpuSeconds() - start;
                           });
                         }));
    double localize_cpu_s = 0.0;
    ASSIGN_OR_RETURN(const auto session,
                     tracking::TrackingSession::Create(
                         std::make_unique<TimedLocalizer>(std::move(localizer),
                                                          &localize_cpu_s),
                         ground::SurfaceOf(*map_),
                         camera_,
                         options));
    const Clock::time_point begin = Clock::now();
    bool has_target = false;
    for (const auto& [index, jpeg] : jpegs_) {
      const std::chrono::nanoseconds time(
          std::llround(1e9 * (index / sequence_.frames_per_second)));
      if (!arguments_.unpaced) std::this_thread::sleep_until(begin + time);
      const auto known = truth_.find(index);
      if (!has_target && known != truth_.end() && known->second.target_px) {
        has_target = true;
        RETURN_IF_ERROR(session->SetTarget("1", *known->second.target_px, {}));
      }
      absl::StatusOr<tracking::FrameResult> result;
      absl::StatusOr<image::Frame> frame;
      const Clock::time_point start = Clock::now();
      const double cpu_start = ThreadCpuSeconds();
      Measure("decode", fast_, [&] {
        frame = image::DecodeImage({.bytes = jpeg}, {});
      });
      RETURN_IF_ERROR(frame.status());
      frame->sequence = static_cast<std::uint64_t>(index) + 1;
      frame->capture_time = time;
      Measure("pyramid", fast_, [&] { frame->Pyramid(); });
      localize_cpu_s = 0.0;
      const double session_start = ThreadCpuSeconds();
      Measure("session", fast_, [&] {
        result = session->ProcessFrame(*frame, std::nullopt, nullptr);
      });
      fast_.Add("track, CPU ms",
                1e3 * (ThreadCpuSeconds() - session_start - localize_cpu_s));
      RETURN_IF_ERROR(result.status());
      fast_.Add("localize, ms", Milliseconds(result->times.localize));
      fast_.Add("track, ms", Milliseconds(result->times.track));
      fast_.Add("whole path, CPU ms", 1e3 * (ThreadCpuSeconds() - cpu_start));
      fast_.Add("whole path, ms", Milliseconds(Clock::now() - start));
      ++frames_;
      AddAccuracy(index, result->camera, fast_, &tracked_);
    }
    return RunFastLocalizer(options.localization, anchors);
  }

  // Localisation alone: its processor time, which the session does not tell.
  absl::Status RunFastLocalizer(const localization::LocalizerOptions& options,
                                service::BackgroundExecutor& anchors) {
    ASSIGN_OR_RETURN(const auto localizer,
                     localization::CreateLocalizer(
                         "fast", map_, options, [&](auto, auto task) {
                           anchors.Post(std::move(task));
                         }));
    const Clock::time_point begin = Clock::now();
    for (const auto& [index, jpeg] : jpegs_) {
      const std::chrono::nanoseconds time(
          std::llround(1e9 * (index / sequence_.frames_per_second)));
      if (!arguments_.unpaced) std::this_thread::sleep_until(begin + time);
      ASSIGN_OR_RETURN(const image::Frame frame, MakeFrame(index, time));
      absl::Status status;
      const double cpu_start = ThreadCpuSeconds();
      status = localizer->Localize(MakeRequest(index, frame)).status();
      fast_.Add("localize, CPU ms", 1e3 * (ThreadCpuSeconds() - cpu_start));
      RETURN_IF_ERROR(status);
    }
    return absl::OkStatus();
  }

  absl::Status RunBaseline() {
    ASSIGN_OR_RETURN(const auto localizer,
                     localization::CreateLocalizer("baseline", map_, {}));
    for (const auto& [index, jpeg] : jpegs_) {
      if (index % arguments_.baseline_every != 0) continue;
      const std::chrono::nanoseconds time(
          std::llround(1e9 * (index / sequence_.frames_per_second)));
      ASSIGN_OR_RETURN(const image::Frame frame, MakeFrame(index, time));
      absl::StatusOr<localization::LocalizationResult> result;
      Measure("localize", baseline_, [&] {
        result = localizer->Localize(MakeRequest(index, frame));
      });
      RETURN_IF_ERROR(result.status());
      AddAccuracy(index, *result, baseline_, nullptr);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<image::Frame> MakeFrame(int index,
                                         std::chrono::nanoseconds time) const {
    ASSIGN_OR_RETURN(image::Frame frame,
                     image::DecodeImage({.bytes = jpegs_.at(index)}, {}));
    frame.sequence = static_cast<std::uint64_t>(index) + 1;
    frame.capture_time = time;
    return frame;
  }

  localization::LocalizationRequest MakeRequest(
      int index, const image::Frame& frame) const {
    localization::LocalizationRequest request{&frame, camera_, {}};
    const auto known = truth_.find(index);
    if (known != truth_.end() && known->second.target_px) {
      request.masks_px.push_back(*known->second.target_px);
    }
    return request;
  }

  void AddAccuracy(int index,
                   const localization::LocalizationResult& result,
                   Stages& stages,
                   int* tracked) const {
    if (result.state != localization::CameraState::kTracked) return;
    if (tracked != nullptr) ++*tracked;
    const auto known = truth_.find(index);
    if (known == truth_.end()) return;
    geometry::Rigid3 expected = known->second.world_from_camera;
    if (sequence_.align.empty()) {
      expected = test_support::WorldFromSourcePose(*map_, expected);
    }
    stages.Add(
        map_->info().metric ? "centre error, cm" : "centre error, units",
        (map_->info().metric ? 100.0 : 1.0) *
            (expected.translation - result.world_from_camera->translation)
                .norm());
    stages.Add("angle error, deg",
               geometry::AngleBetween_rad(expected.rotation,
                                          result.world_from_camera->rotation) *
                   180.0 / M_PI);
  }

  Arguments arguments_;
  test_support::Sequence sequence_;
  std::shared_ptr<const map::Map> map_;
  geometry::CameraModel camera_;
  std::map<int, test_support::TrueFrame> truth_;
  std::map<int, std::vector<std::uint8_t>> jpegs_;
  Stages fast_, baseline_;
  int frames_ = 0;
  int tracked_ = 0;
  double anchor_cpu_s_ = 0.0;  // by the anchors' thread, read after its end
};

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) {
  groundlock::bench::Arguments arguments;
  CLI::App app("Times the way of a frame through a session");
  app.add_option("sequences", arguments.sequences);
  app.add_option("--tracker", arguments.tracker);
  app.add_option("--baseline-every", arguments.baseline_every)
      ->check(CLI::PositiveNumber);
  app.add_flag("--unpaced",
               arguments.unpaced,
               "frames one after the other, not at the camera's rate");
  CLI11_PARSE(app, argc, argv);
  groundlock::features::SetUpOpenCv();
  const absl::Status status = groundlock::bench::Benchmark(arguments).Run();
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
