// SPDX-License-Identifier: Apache-2.0
#include "client/cli/track_run.h"

#include <algorithm>
#include <opencv2/imgproc.hpp>
#include <thread>
#include <utility>
#include <variant>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "client/cli/map_lens.h"
#include "client/cli/movers_csv.h"
#include "client/cli/results_csv.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

// Frames on the way: enough to hide the wire, few enough that an interruption
// ends soon and raw frames do not pile up.
constexpr int kMaxInFlight = 8;
// At a camera's pace what waits on the way is late.
constexpr int kMaxInFlightInRealTime = 4;
// After an interruption, how long the server may take for the next answer.
constexpr auto kDrainFor = std::chrono::seconds(10);
// More failed frames than this are only counted.
constexpr int kMaxErrorsShown = 5;

std::string SizeText(int width, int height) {
  return absl::StrCat(width, "x", height);
}

}  // namespace

TrackRun::TrackRun(const TrackOptions& options, VerbContext& context)
    : options_(options), context_(context), inertial_(options.inertial) {}
TrackRun::~TrackRun() = default;

absl::Status TrackRun::Run() {
  // The input and the outputs first: their errors are the user's, and leave no
  // session behind.
  RETURN_IF_ERROR(OpenInput());
  RETURN_IF_ERROR(OpenOutputs());
  ASSIGN_OR_RETURN(client_, Connect(context_));
  RETURN_IF_ERROR(ChooseLens());
  encoding_ = media::ResolveEncoding(options_.encoding, context_.common.server);
  absl::Status status = OpenSession();
  if (!status.ok()) {
    EndSession(/*complete=*/false);
    return status;
  }

  sdk::TrackingStreamOptions stream_options;
  stream_options.max_in_flight = options_.realtime || source_->live()
                                     ? kMaxInFlightInRealTime
                                     : kMaxInFlight;
  auto stream = client_->Track(session_id_, stream_options);
  if (!stream.ok()) {
    EndSession(/*complete=*/false);
    return stream.status();
  }
  start_ = steady_clock::now();
  absl::Status sent;
  std::thread sender([&] {
    sent = SendFrames(**stream);
    stop_ = true;
    (*stream)->CloseSend();
  });
  status = ReceiveReplies(**stream);
  stop_ = true;
  if (!status.ok()) (*stream)->Cancel();
  sender.join();
  stream->reset();
  progress_.reset();
  const double wall_s =
      std::chrono::duration<double>(steady_clock::now() - start_).count();

  const bool interrupted = context_.interrupt.interrupted();
  EndSession(status.ok() && sent.ok() && !interrupted);
  RETURN_IF_ERROR(FinishOutputs());
  if (options_.observer) {
    // Whoever looks on tells what there is to tell.
  } else if (context_.common.json) {
    context_.out << summary_.ToJson(wall_s, session_id_) << '\n';
  } else {
    context_.out << summary_.ToText(wall_s);
  }
  if (interrupted) {
    return absl::CancelledError(absl::StrCat(
        "interrupted; the results up to there are kept",
        options_.session_id.empty()
            ? ""
            : absl::StrCat(", session ",
                           session_id_,
                           " waits on the server: the same command goes on")));
  }
  RETURN_IF_ERROR(status);
  RETURN_IF_ERROR(sent);
  if (summary_.processed() == 0 && summary_.failed() > 0) {
    return base::Annotate(first_frame_error_, "no frame could be processed");
  }
  return CheckTargets();
}

absl::Status TrackRun::OpenInput() {
  ASSIGN_OR_RETURN(source_,
                   media::OpenVideoSource(options_.input, options_.source));
  ASSIGN_OR_RETURN(first_frame_, source_->Next());
  if (!first_frame_) {
    return absl::InvalidArgumentError(
        absl::StrCat(options_.input, ": no frames in the range asked for"));
  }
  ASSIGN_OR_RETURN(const cv::Mat bgr, media::DecodeFrame(*first_frame_));
  frame_size_px_ = bgr.size();
  if (!options_.camera) return absl::OkStatus();
  const geometry::CameraModel& camera = *options_.camera;
  if (bgr.cols != camera.width_px() || bgr.rows != camera.height_px()) {
    return absl::InvalidArgumentError(
        absl::StrCat(options_.input,
                     ": frames are ",
                     SizeText(bgr.cols, bgr.rows),
                     ", but the camera file is for ",
                     SizeText(camera.width_px(), camera.height_px())));
  }
  return absl::OkStatus();
}

absl::Status TrackRun::ChooseLens() {
  if (options_.camera) {
    camera_ = *options_.camera;
    if (options_.map_name.empty()) return absl::OkStatus();
    // A map that is not there is the session's error.
    const auto map = client_->GetMap(options_.map_name, /*version=*/0);
    const std::string warning =
        map.ok() && map->lens ? LensWarning(camera_, *map->lens) : "";
    if (!warning.empty()) context_.err << "warning: " << warning << '\n';
    return absl::OkStatus();
  }
  // Nothing is measured without a map: the lens is not used.
  if (options_.map_name.empty()) return absl::OkStatus();
  ASSIGN_OR_RETURN(const geometry::CameraModel lens,
                   LensOfMap(*client_, options_.map_name));
  ASSIGN_OR_RETURN(camera_,
                   LensForSize(lens,
                               options_.map_name,
                               frame_size_px_.width,
                               frame_size_px_.height));
  context_.err << "lens: that of map " << options_.map_name << " ("
               << LensText(lens)
               << (camera_ == lens ? ")" : "), scaled to the frames' size")
               << '\n';
  return absl::OkStatus();
}

absl::Status TrackRun::OpenOutputs() {
  if (!options_.results.empty()) {
    ASSIGN_OR_RETURN(csv_, AtomicFile::Create(options_.results));
    RETURN_IF_ERROR(csv_->Append(ResultsCsvHeader()));
  }
  if (!options_.movers.empty()) {
    ASSIGN_OR_RETURN(movers_csv_, AtomicFile::Create(options_.movers));
    RETURN_IF_ERROR(movers_csv_->Append(MoversCsvHeader()));
  }
  if (!options_.overlay.empty()) {
    ASSIGN_OR_RETURN(video_,
                     OverlayWriter::Create(
                         options_.overlay, frame_size_px_, source_->fps()));
  }
  return absl::OkStatus();
}

absl::Status TrackRun::OpenSession() {
  std::set<std::string> known;
  if (!options_.session_id.empty()) {
    const auto existing = client_->GetSession(options_.session_id);
    if (existing.ok()) {
      session_id_ = options_.session_id;
      session_open_ = true;
      next_sequence_ = existing->next_sequence;
      known.insert(existing->target_ids.begin(), existing->target_ids.end());
      context_.err << "session " << session_id_ << " goes on from frame "
                   << next_sequence_ << '\n';
      // A camera's frames are numbered anew by every run.
      if (source_->live()) sequence_offset_ = next_sequence_;
      return SetTargets(known);
    }
    if (existing.status().code() != absl::StatusCode::kNotFound) {
      return existing.status();
    }
  }
  sdk::SessionSpec spec;
  spec.session_id = options_.session_id;
  spec.map_name = options_.map_name;
  if (options_.camera || !options_.map_name.empty()) spec.camera = camera_;
  spec.options = options_.session;
  spec.options.flow_mode = options_.realtime || source_->live()
                               ? sdk::FlowMode::kLive
                               : sdk::FlowMode::kLossless;
  spec.options.report_matches |= !options_.overlay.empty();
  ASSIGN_OR_RETURN(const sdk::SessionInfo session,
                   client_->CreateSession(spec));
  session_id_ = session.spec.session_id;
  session_open_ = true;
  return SetTargets(known);
}

absl::Status TrackRun::SetTargets(const std::set<std::string>& known) {
  for (const TargetSpec& target : options_.targets) {
    if (known.count(target.id) > 0) {
      targets_followed_.insert(target.id);
      continue;
    }
    const std::uint64_t frame =
        std::max(target.frame.value_or(first_frame_->number) + sequence_offset_,
                 next_sequence_);
    RETURN_IF_ERROR(base::Annotate(
        client_
            ->SetTarget(
                session_id_, target.id, target.box_px, frame, target.body)
            .status(),
        absl::StrCat("target ", target.id)));
  }
  return absl::OkStatus();
}

absl::Status TrackRun::SendFrames(sdk::TrackingStream& stream) {
  next_sequence_ = std::max(next_sequence_, stream.next_sequence());
  std::optional<media::SourceFrame> frame =
      std::exchange(first_frame_, std::nullopt);
  while (frame && !stop_ && !context_.interrupt.interrupted()) {
    frame->number += sequence_offset_;
    // Frames that the server has had from an earlier run of this session.
    if (frame->number >= next_sequence_) {
      if (options_.realtime && !source_->live()) {
        WaitForCaptureTime(frame->capture_time);
        if (options_.host_clock) {
          frame->capture_time = steady_clock::now().time_since_epoch();
        }
      }
      RETURN_IF_ERROR(SendFrame(*frame, stream));
    }
    ASSIGN_OR_RETURN(frame, source_->Next());
  }
  return absl::OkStatus();
}

absl::Status TrackRun::SendFrame(const media::SourceFrame& frame,
                                 sdk::TrackingStream& stream) {
  sdk::Frame message;
  message.sequence = frame.number;
  message.capture_time = frame.capture_time;
  if (const auto prior = options_.priors.find(frame.number);
      prior != options_.priors.end()) {
    message.prior = prior->second;
  }
  message.inertial = inertial_.Until(frame.capture_time);
  ASSIGN_OR_RETURN(
      message.image,
      media::EncodeFrame(
          frame, encoding_, options_.encoding == media::EncodingChoice::kAuto));
  Pending pending{.capture_time = frame.capture_time, .bgr = {}};
  if (video_ || options_.observer) {
    // A broken image still gets its row, and the server's reason for it.
    if (auto bgr = media::DecodeFrame(frame); bgr.ok()) pending.bgr = *bgr;
  }
  {
    const std::lock_guard lock(mutex_);
    pending_.emplace(frame.number, std::move(pending));
  }
  return stream.Send(std::move(message));
}

void TrackRun::WaitForCaptureTime(nanoseconds capture_time) {
  if (!first_capture_time_) first_capture_time_ = capture_time;
  const auto due = start_ + (capture_time - *first_capture_time_);
  while (!stop_ && !context_.interrupt.interrupted() &&
         steady_clock::now() < due) {
    // In short turns, so that an interruption does not wait for the next frame.
    std::this_thread::sleep_until(
        std::min(due, steady_clock::now() + milliseconds(50)));
  }
}

absl::Status TrackRun::ReceiveReplies(sdk::TrackingStream& stream) {
  const Terminal terminal = StderrTerminal();
  progress_ = std::make_unique<Progress>(
      context_.err,
      Progress::Options{.label = "track",
                        .total = source_->num_frames(),
                        .unit = "frames",
                        .terminal = terminal.is_terminal,
                        .columns = terminal.columns});
  auto last_answer = steady_clock::now();
  bool told = false;
  while (true) {
    if (context_.interrupt.interrupted() && !std::exchange(told, true)) {
      context_.err << "\ninterrupted: waiting for the frames on the way (once "
                      "more to stop at once)\n";
    }
    const auto reply = stream.NextWithin(milliseconds(100));
    if (reply.status().code() == absl::StatusCode::kDeadlineExceeded) {
      if (!context_.interrupt.interrupted()) {
        last_answer = steady_clock::now();
      } else if (steady_clock::now() - last_answer > kDrainFor) {
        return absl::DeadlineExceededError("the server does not answer");
      }
      continue;
    }
    RETURN_IF_ERROR(reply.status());
    if (!reply->has_value()) return absl::OkStatus();
    last_answer = steady_clock::now();
    RETURN_IF_ERROR(HandleReply(**reply));
    // Nothing left to follow: the rest of the input would be for nothing.
    if (!options_.targets.empty() &&
        target_errors_.size() == options_.targets.size()) {
      return CheckTargets();
    }
  }
}

absl::Status TrackRun::HandleReply(const sdk::FrameReply& reply) {
  const std::uint64_t frame = sdk::SequenceOf(reply);
  Pending pending;
  {
    const std::lock_guard lock(mutex_);
    if (auto node = pending_.extract(frame)) pending = std::move(node.mapped());
  }
  summary_.Add(reply);
  if (const auto* error = std::get_if<sdk::FrameError>(&reply)) {
    if (first_frame_error_.ok()) first_frame_error_ = error->status;
    if (++errors_shown_ <= kMaxErrorsShown) {
      // Most of the server's messages begin like that themselves.
      const std::string prefix = absl::StrCat("frame ", frame, ": ");
      if (!absl::StartsWith(error->status.message(), prefix)) {
        context_.err << prefix;
      }
      context_.err << error->status.message()
                   << (errors_shown_ == kMaxErrorsShown
                           ? " (further ones are only counted)"
                           : "")
                   << '\n';
    }
  }
  const auto* result = std::get_if<sdk::FrameResult>(&reply);
  if (result != nullptr) {
    NoteTargets(*result);
    NoteLens(*result);
    NoteMovers(*result);
    if (movers_csv_) {
      RETURN_IF_ERROR(movers_csv_->Append(MoversCsvRows(*result)));
    }
    if (options_.observer) options_.observer(*result, pending.bgr, camera_);
  }
  if (csv_) {
    RETURN_IF_ERROR(csv_->Append(
        result != nullptr ? ResultsCsvRows(*result)
                          : ResultsCsvEmptyRow(frame, pending.capture_time)));
  }
  if (video_) RETURN_IF_ERROR(WriteOverlay(reply, pending));
  progress_->Update(
      summary_.processed() + summary_.dropped() + summary_.failed(),
      summary_.last_states());
  return absl::OkStatus();
}

void TrackRun::NoteTargets(const sdk::FrameResult& result) {
  for (const sdk::TargetResult& target : result.targets) {
    targets_followed_.insert(target.id);
  }
  for (const sdk::TargetError& error : result.target_errors) {
    context_.err << "frame " << result.sequence << ": target " << error.id
                 << ": " << error.message << '\n';
    target_errors_[error.id] = error.message;
  }
}

void TrackRun::NoteLens(const sdk::FrameResult& result) {
  if (!result.camera.lens_contradiction || lens_shown_) return;
  lens_shown_ = true;
  context_.err << "frame " << result.sequence << ": warning: "
               << SeenLensWarning(camera_, *result.camera.lens_contradiction)
               << '\n';
}

void TrackRun::NoteMovers(const sdk::FrameResult& result) {
  if (!options_.session.report_movers) return;
  const char* reason = nullptr;
  switch (result.movers_state) {
    case sdk::MoversState::kNotAsked:
      // As it goes on, a session keeps the options that it was made with.
      reason = "the session was not made to look for them";
      break;
    case sdk::MoversState::kNoMap:
      reason = "there is no map that they could move against";
      break;
    case sdk::MoversState::kNoGround:
      reason =
          "the map does not know its ground, or the camera is not above it "
          "(groundlock map align sets the ground)";
      break;
    case sdk::MoversState::kPoseContradicted:
      reason = "too much of the picture contradicts the camera's pose";
      break;
    case sdk::MoversState::kWatching:
    case sdk::MoversState::kStarting:
    case sdk::MoversState::kNoPose:  // the camera's own states tell
      return;
  }
  if (!movers_states_shown_.insert(result.movers_state).second) return;
  context_.err << "frame " << result.sequence << ": no movers: " << reason
               << '\n';
}

absl::Status TrackRun::WriteOverlay(const sdk::FrameReply& reply,
                                    const Pending& pending) {
  if (pending.bgr.empty()) return absl::OkStatus();
  cv::Mat bgr = pending.bgr.clone();
  const auto* result = std::get_if<sdk::FrameResult>(&reply);
  if (result != nullptr) {
    trails_.Add(*result);
    DrawOverlay(camera_, *result, trails_, OverlayColours{}, bgr);
  } else {
    const auto* error = std::get_if<sdk::FrameError>(&reply);
    // Perhaps the video changed it, which is the error.
    if (bgr.size() != frame_size_px_) cv::resize(bgr, bgr, frame_size_px_);
    DrawNoResult(absl::StrCat("frame ",
                              sdk::SequenceOf(reply),
                              error != nullptr
                                  ? absl::StrCat(": ", error->status.message())
                                  : std::string(" dropped")),
                 bgr);
  }
  return video_->Write(bgr, pending.capture_time);
}

absl::Status TrackRun::CheckTargets() const {
  for (const TargetSpec& target : options_.targets) {
    if (const auto it = target_errors_.find(target.id);
        it != target_errors_.end()) {
      return absl::InvalidArgumentError(
          absl::StrCat("target ", target.id, ": ", it->second));
    }
    if (targets_followed_.count(target.id) == 0) {
      return absl::InvalidArgumentError(
          absl::StrCat("target ",
                       target.id,
                       ": its frame ",
                       target.frame.value_or(0),
                       " was not among the frames processed"));
    }
  }
  return absl::OkStatus();
}

absl::Status TrackRun::FinishOutputs() {
  absl::Status csv, movers, video;
  if (csv_) csv = csv_->Finish();
  if (movers_csv_) movers = movers_csv_->Finish();
  // A video without a single frame is not a file that any player opens.
  if (video_ && summary_.processed() > 0) video = video_->Finish();
  RETURN_IF_ERROR(csv);
  RETURN_IF_ERROR(movers);
  return video;
}

void TrackRun::EndSession(bool complete) {
  if (!session_open_) return;
  // A session that the user named outlives what went wrong, to be resumed.
  if (!complete && !options_.session_id.empty()) return;
  const absl::Status status = client_->DeleteSession(session_id_);
  if (!status.ok() && status.code() != absl::StatusCode::kNotFound) {
    context_.err << "session " << session_id_
                 << " could not be ended: " << status.message() << '\n';
  }
}

}  // namespace groundlock::cli
