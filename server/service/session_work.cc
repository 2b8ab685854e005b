// SPDX-License-Identifier: Apache-2.0
// What a session does on its strand: target operations and frames.
#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

#include "map_store/base/status.h"
#include "server/image/frame.h"
#include "server/service/session.h"
#include "server/service/session_lens.h"

namespace groundlock::service {
namespace {

// A live frame that waited so long is one of too many, and so are those of a
// session whose frames waited so long in the mean over the last few.
constexpr std::chrono::milliseconds kHurryAfter{5};
constexpr std::chrono::milliseconds kHurryAfterMean{2};
constexpr double kNewestWait = 1.0 / 8.0;              // its weight in the mean
constexpr std::chrono::milliseconds kLongestWait{20};  // that the mean takes in

// TrackingSession puts "target 'ID': " before what went wrong with a target.
TargetFault MakeTargetFault(const absl::Status& error) {
  constexpr std::string_view kBefore = "target '";
  constexpr std::string_view kAfter = "': ";
  std::string_view message = base::Std(error.message());
  const std::size_t end = message.find(kAfter);
  if (!message.starts_with(kBefore) || end == std::string_view::npos) {
    return {"", std::string(message)};
  }
  return {std::string(message.substr(kBefore.size(), end - kBefore.size())),
          std::string(message.substr(end + kAfter.size()))};
}

}  // namespace

bool Session::Step() {
  std::vector<Command> commands;
  std::shared_ptr<FrameJob> job;
  bool keep_frame = false;
  std::shared_ptr<FrameSink> room_for;
  {
    base::MutexLock lock(&mutex_);
    commands = std::exchange(commands_, {});
    for (Slot& slot : slots_) {
      if (slot.waiting == nullptr) continue;
      job = TakeWaiting(slot);
      if (std::exchange(room_wanted_, false)) room_for = sink_;
      break;
    }
    keep_frame = WantsImages();
  }
  if (room_for != nullptr) room_for->OnRoom();
  RunCommands(commands);
  std::shared_ptr<const Answer> answer;
  if (job != nullptr) answer = Process(job, keep_frame);
  std::vector<std::string> target_ids = core_->TargetIds();

  Notice notice;
  bool more = false;
  {
    base::MutexLock lock(&mutex_);
    target_ids_ = std::move(target_ids);
    // The frame in work is the oldest without an answer.
    if (answer != nullptr && !slots_.empty()) slots_.front().answer = answer;
    notice = Publish();
    more = num_waiting_ > 0;
  }
  notice.Send();
  return more;
}

void Session::RunCommands(const std::vector<Command>& commands) {
  absl::Status ended;
  {
    base::MutexLock lock(&mutex_);
    ended = ended_;
  }
  for (const Command& command : commands) {
    absl::Status status = ended;
    if (status.ok()) {
      try {
        status = command.run(*core_);
      } catch (const std::exception& error) {
        status = absl::InternalError(error.what());
      }
    }
    if (status.ok()) {
      // Seen by those whom `done` tells.
      std::vector<std::string> target_ids = core_->TargetIds();
      base::MutexLock lock(&mutex_);
      target_ids_ = std::move(target_ids);
    }
    command.done(status);
  }
}

std::shared_ptr<const Answer> Session::Process(
    const std::shared_ptr<FrameJob>& job, bool keep_frame) {
  auto answer = std::make_shared<Answer>();
  answer->sequence = job->sequence;
  absl::StatusOr<FrameOutcome> outcome;
  try {
    outcome = ProcessFrame(*job);
  } catch (const std::exception& error) {
    // Third-party code threw through a room that should have caught it.
    outcome = absl::InternalError(error.what());
  }
  last_processed_ = job->sequence;
  AddSpans(*job, outcome);
  if (outcome.ok()) {
    const tracking::StageTimes& times = outcome->result.times;
    metrics_->queue.Add(outcome->queue_time);
    metrics_->decode.Add(times.decode);
    metrics_->localize.Add(times.localize);
    metrics_->track.Add(times.track);
    metrics_->total.Add(times.total);
    answer->content = *std::move(outcome);
    if (keep_frame) answer->frame = job;
  } else {
    answer->content = base::Annotate(
        outcome.status(), base::Std(absl::StrCat("frame ", job->sequence)));
  }
  return answer;
}

void Session::AddSpans(const FrameJob& job,
                       const absl::StatusOr<FrameOutcome>& outcome) const {
  SpanQueue* const spans = metrics_->spans;
  if (spans == nullptr || !spans->WantsFrame(spec_.span, job.sequence)) return;
  using Clock = std::chrono::system_clock;
  Span frame;
  frame.name = "frame";
  frame.context = SpanQueue::NewContext();
  frame.link = spec_.span;
  frame.end = Clock::now();
  // Durations are measured by a clock that nobody sets.
  frame.start =
      frame.end - std::chrono::duration_cast<Clock::duration>(
                      std::chrono::steady_clock::now() - job.received);
  frame.attributes = {
      {"groundlock.session", spec_.id},
      {"groundlock.sequence", static_cast<std::int64_t>(job.sequence)},
      {"groundlock.bytes", static_cast<std::int64_t>(job.bytes.size())}};
  if (!spec_.map_name.empty()) {
    frame.attributes.emplace_back("groundlock.map", spec_.map_name);
  }
  frame.status = outcome.status();
  if (outcome.ok()) {
    const tracking::StageTimes& times = outcome->result.times;
    frame.attributes.emplace_back(
        "groundlock.targets",
        static_cast<std::int64_t>(outcome->result.targets.size()));
    // The stages follow one another.
    Clock::time_point begin = frame.start;
    const std::pair<const char*, std::chrono::nanoseconds> stages[] = {
        {"queue", outcome->queue_time},
        {"decode", times.decode},
        {"localize", times.localize},
        {"track", times.track}};
    for (const auto& [name, duration] : stages) {
      Span stage;
      stage.name = name;
      stage.context = SpanQueue::NewContext(frame.context);
      stage.parent = frame.context.span;
      stage.start = begin;
      begin += std::chrono::duration_cast<Clock::duration>(duration);
      stage.end = begin;
      spans->Add(std::move(stage));
    }
  }
  spans->Add(std::move(frame));
}

bool Session::IsLate(std::chrono::nanoseconds wait) {
  if (!spec_.live) return false;
  const double wait_s =
      std::chrono::duration<double>(
          std::clamp<std::chrono::nanoseconds>(
              wait, std::chrono::nanoseconds{0}, kLongestWait))
          .count();
  mean_wait_s_ += kNewestWait * (wait_s - mean_wait_s_);
  return wait > kHurryAfter ||
         mean_wait_s_ > std::chrono::duration<double>(kHurryAfterMean).count();
}

absl::StatusOr<FrameOutcome> Session::ProcessFrame(const FrameJob& job) {
  const auto start = std::chrono::steady_clock::now();
  RETURN_IF_ERROR(job.status);
  const image::EncodedImage encoded{
      job.encoding,
      {reinterpret_cast<const std::uint8_t*>(job.bytes.data()),
       job.bytes.size()},
      job.width_px,
      job.height_px};
  ASSIGN_OR_RETURN(image::Frame frame,
                   image::DecodeImage(encoded, limits_.image));
  const auto decoded = std::chrono::steady_clock::now();
  frame.sequence = job.sequence;
  frame.capture_time = job.capture_time;
  std::optional<geometry::CameraModel> camera = job.camera;
  if (!camera && (spec_.takes_lens_of_map || !spec_.camera)) {
    ASSIGN_OR_RETURN(camera, LensForSize(spec_.camera, frame.size_px()));
  }
  std::vector<absl::Status> target_errors;
  FrameOutcome outcome;
  outcome.queue_time = start - job.received;
  core_->SetHurried(IsLate(outcome.queue_time));
  ASSIGN_OR_RETURN(
      outcome.result,
      core_->ProcessFrame(frame, camera, job.sensors, &target_errors));
  outcome.result.sequence = job.sequence;
  outcome.result.capture_time = job.capture_time;
  outcome.result.times.decode = decoded - start;
  outcome.result.times.total = std::chrono::steady_clock::now() - start;
  if (!spec_.report_matches) outcome.result.camera.inliers = {};
  for (const absl::Status& error : target_errors) {
    outcome.target_faults.push_back(MakeTargetFault(error));
  }
  return outcome;
}

}  // namespace groundlock::service
