// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/source_runs.h"

#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "client/media/frame_encoder.h"
#include "client/media/video_source.h"
#include "client/sdk/client.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

using std::chrono::nanoseconds;
using std::chrono::steady_clock;

// At the pace of the source, what waits on the way is late.
constexpr int kMaxInFlight = 4;
// Between two attempts to open a camera that is away: doubled each time.
constexpr std::chrono::seconds kShortestPause{1};
constexpr std::chrono::seconds kLongestPause{60};

nanoseconds Now() { return steady_clock::now().time_since_epoch(); }

}  // namespace

class SourceRuns::Run {
 public:
  Run(SourceRunSpec spec, ServerAddress server)
      : spec_(std::move(spec)), server_(std::move(server)) {
    state_.set_source_id(spec_.source_id);
    state_.set_state(spec_.paused ? pb::SourceRun::STATE_PAUSED
                                  : pb::SourceRun::STATE_PLAYING);
    paused_ = spec_.paused;
    thread_ = std::thread([this] { Work(); });
  }
  ~Run() {
    Control(pb::ControlSource::ACTION_STOP);
    thread_.join();
  }
  Run(const Run&) = delete;
  Run& operator=(const Run&) = delete;

  void Control(pb::ControlSource::Action action) {
    base::MutexLock lock(&mutex_);
    switch (action) {
      case pb::ControlSource::ACTION_PLAY:
        paused_ = false;
        break;
      case pb::ControlSource::ACTION_PAUSE:
        paused_ = true;
        break;
      case pb::ControlSource::ACTION_STEP:
        if (paused_) ++steps_;
        break;
      default:
        stop_ = true;
    }
    const bool over = state_.state() == pb::SourceRun::STATE_ENDED ||
                      state_.state() == pb::SourceRun::STATE_FAILED;
    if (!over) {
      state_.set_state(paused_ ? pb::SourceRun::STATE_PAUSED
                               : pb::SourceRun::STATE_PLAYING);
    }
  }

  pb::SourceRun state() const {
    base::MutexLock lock(&mutex_);
    return state_;
  }
  bool over() const {
    const pb::SourceRun now = state();
    return now.state() == pb::SourceRun::STATE_ENDED ||
           now.state() == pb::SourceRun::STATE_FAILED;
  }

 private:
  void Work() {
    const absl::Status status = Feed();
    base::MutexLock lock(&mutex_);
    if (status.ok() || absl::IsNotFound(status) || stop_) {
      state_.set_state(pb::SourceRun::STATE_ENDED);
    } else {
      state_.set_state(pb::SourceRun::STATE_FAILED);
      state_.set_message(std::string(status.message()));
      spdlog::warn("session {}: its source {} has failed: {}",
                   spec_.session_id,
                   spec_.source_id,
                   std::string(status.message()));
    }
  }

  absl::Status Feed() {
    ASSIGN_OR_RETURN(const auto client, server_.Connect(spec_.token));
    ASSIGN_OR_RETURN(auto source, media::OpenVideoSource(spec_.input, {}));
    sdk::TrackingStreamOptions stream_options;
    stream_options.max_in_flight = kMaxInFlight;
    stream_options.on_reply = [this](const sdk::FrameReply& reply) {
      if (const auto* error = std::get_if<sdk::FrameError>(&reply)) {
        base::MutexLock lock(&mutex_);
        state_.set_message(absl::StrCat(
            "frame ", error->sequence, ": ", error->status.message()));
      }
    };
    ASSIGN_OR_RETURN(const auto stream,
                     client->Track(spec_.session_id, stream_options));
    sequence_ = stream->next_sequence();
    for (const SourceRunSpec::Target& target : spec_.targets) {
      RETURN_IF_ERROR(
          client
              ->SetTarget(spec_.session_id, target.id, target.box_px, sequence_)
              .status());
    }
    {
      base::MutexLock lock(&mutex_);
      state_.set_num_frames(source->num_frames().value_or(0));
      state_.set_fps(source->fps());
    }
    shift_ = Now();
    // Of live sources, which have no end of their own: a camera that is away
    // comes back.
    const bool live = source->live();
    nanoseconds pause = kShortestPause;
    for (;;) {
      const std::uint64_t before = sequence_;
      if (source != nullptr) {
        ASSIGN_OR_RETURN(const bool stopped, FeedOnce(*source, *stream));
        if (stopped || (!spec_.loop && !live)) break;
      }
      if (live) {
        if (sequence_ != before) pause = kShortestPause;
        source = nullptr;  // some cameras take one viewer
        if (WaitToReopen(pause)) break;
        pause = std::min<nanoseconds>(2 * pause, kLongestPause);
      }
      auto reopened = media::OpenVideoSource(spec_.input, {});
      if (!reopened.ok() && !live) return reopened.status();
      if (reopened.ok()) {
        source = *std::move(reopened);
        base::MutexLock lock(&mutex_);
        state_.clear_message();
      } else {
        base::MutexLock lock(&mutex_);
        state_.set_message(std::string(reopened.status().message()));
      }
    }
    if (IsStopped()) return absl::OkStatus();  // frames on the way may be lost
    return stream->Finish();
  }

  // Says that the source is away, and waits. Returns whether to stop.
  bool WaitToReopen(nanoseconds pause) {
    spdlog::warn(
        "session {}: its source {} is away; trying again in {} s",
        spec_.session_id,
        spec_.source_id,
        std::chrono::duration_cast<std::chrono::seconds>(pause).count());
    base::MutexLock lock(&mutex_);
    if (state_.message().empty()) {
      state_.set_message("the source is away; trying again");
    }
    mutex_.AwaitFor(pause,
                    [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return stop_; });
    return stop_;
  }

  // Once through the source, or until a live one is away. Returns whether it
  // was stopped.
  absl::StatusOr<bool> FeedOnce(media::VideoSource& source,
                                sdk::TrackingStream& stream) {
    const auto encoding =
        media::ResolveEncoding(media::EncodingChoice::kAuto, server_.target);
    // Media time 0 of this round, in frames' capture times.
    const nanoseconds round =
        std::max(shift_,
                 last_capture_ + nanoseconds(static_cast<std::int64_t>(
                                     1e9 / std::max(source.fps(), 1.0))));
    for (;;) {
      auto next = source.Next();
      if (!next.ok() && source.live()) {
        base::MutexLock lock(&mutex_);
        state_.set_message(std::string(next.status().message()));
        return stop_;
      }
      RETURN_IF_ERROR(next.status());
      const std::optional<media::SourceFrame> frame = *std::move(next);
      if (!frame.has_value()) return IsStopped();
      nanoseconds capture = frame->capture_time;
      if (!source.live()) {
        capture += round;
        if (WaitFor(capture)) return true;
      } else if (IsStopped()) {
        return true;
      }
      ASSIGN_OR_RETURN(
          sdk::Image image,
          media::EncodeFrame(*frame, encoding, /*keep_file_bytes=*/true));
      last_capture_ = capture;
      sdk::Frame message;
      message.sequence = sequence_++;
      message.capture_time = capture;
      message.image = std::move(image);
      RETURN_IF_ERROR(stream.Send(std::move(message)));
      base::MutexLock lock(&mutex_);
      state_.set_frames_sent(state_.frames_sent() + 1);
    }
  }

  bool IsStopped() const {
    base::MutexLock lock(&mutex_);
    return stop_;
  }

  // Waits until a frame of this capture time is due. Capture times run on while
  // the source is paused no more than playing does: `behind_` tells how much.
  // Returns whether to stop.
  bool WaitFor(nanoseconds capture) {
    base::MutexLock lock(&mutex_);
    const auto may_go = [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
      return stop_ || !paused_ || steps_ > 0;
    };
    // The first frame is shown even if nothing is played yet.
    if (state_.frames_sent() > 0 && !may_go()) {
      const nanoseconds before = Now();
      mutex_.Await(may_go);
      behind_ += Now() - before;
    }
    if (steps_ > 0) --steps_;
    const nanoseconds wait = capture + behind_ - Now();
    if (wait.count() > 0) {
      mutex_.AwaitFor(
          wait, [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return stop_; });
    }
    return stop_;
  }

  const SourceRunSpec spec_;
  const ServerAddress server_;

  // Of the thread.
  std::uint64_t sequence_ = 0;
  nanoseconds shift_{0};
  nanoseconds last_capture_{0};
  nanoseconds behind_{0};

  mutable base::Mutex mutex_;
  pb::SourceRun state_ ABSL_GUARDED_BY(mutex_);
  bool paused_ ABSL_GUARDED_BY(mutex_) = false;
  bool stop_ ABSL_GUARDED_BY(mutex_) = false;
  int steps_ ABSL_GUARDED_BY(mutex_) = 0;
  std::thread thread_;
};

SourceRuns::SourceRuns(ServerAddress server, int max_runs)
    : server_(std::move(server)),
      max_runs_(static_cast<std::size_t>(max_runs)) {}

SourceRuns::~SourceRuns() {
  std::map<std::string, std::shared_ptr<Run>> runs;
  {
    base::MutexLock lock(&mutex_);
    runs.swap(runs_);
  }
  for (const auto& [session, run] : runs) {
    run->Control(pb::ControlSource::ACTION_STOP);
  }
}

std::size_t SourceRuns::Working() const {
  std::size_t working = 0;
  for (const auto& [session, run] : runs_) working += run->over() ? 0 : 1;
  return working;
}

std::size_t SourceRuns::num_working() const {
  base::MutexLock lock(&mutex_);
  return Working();
}

absl::Status SourceRuns::Start(SourceRunSpec spec) {
  std::shared_ptr<Run> replaced;  // joined without the lock
  base::MutexLock lock(&mutex_);
  const std::size_t working = Working();
  if (working >= max_runs_) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the dashboard feeds ", working, " sessions already: stop one"));
  }
  // What is over is shown until there is much of it.
  if (runs_.size() >= 4 * max_runs_) {
    std::erase_if(runs_, [](const auto& run) { return run.second->over(); });
  }
  std::shared_ptr<Run>& run = runs_[spec.session_id];
  replaced = std::move(run);
  run = std::make_shared<Run>(std::move(spec), server_);
  return absl::OkStatus();
}

absl::Status SourceRuns::Control(const std::string& session_id,
                                 pb::ControlSource::Action action) {
  base::MutexLock lock(&mutex_);
  const auto run = runs_.find(session_id);
  if (run == runs_.end()) {
    return absl::NotFoundError(
        absl::StrCat("session_id: the dashboard does not feed ", session_id));
  }
  run->second->Control(action);
  return absl::OkStatus();
}

std::optional<pb::SourceRun> SourceRuns::StateOf(
    const std::string& session_id) const {
  base::MutexLock lock(&mutex_);
  const auto run = runs_.find(session_id);
  if (run == runs_.end()) return std::nullopt;
  return run->second->state();
}

}  // namespace groundlock::dashboard
