// SPDX-License-Identifier: Apache-2.0
// One run of `groundlock track`: frames from a source through a session on the
// server into a CSV, an overlay video and a summary.
#ifndef GROUNDLOCK_CLIENT_CLI_TRACK_RUN_H_
#define GROUNDLOCK_CLIENT_CLI_TRACK_RUN_H_

#include <atomic>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <opencv2/core.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/cli/atomic_file.h"
#include "client/cli/imu.h"
#include "client/cli/overlay.h"
#include "client/cli/overlay_writer.h"
#include "client/cli/parse.h"
#include "client/cli/priors.h"
#include "client/cli/progress.h"
#include "client/cli/track_summary.h"
#include "client/cli/verbs.h"
#include "client/media/frame_encoder.h"
#include "client/media/video_source.h"
#include "client/sdk/client.h"

namespace groundlock::cli {

struct TrackOptions {
  std::string input;
  std::string map_name;  // empty = none: targets in 2D only
  // Unset: the map's lens; without a map none is needed.
  std::optional<geometry::CameraModel> camera;
  std::vector<TargetSpec> targets;
  media::VideoSourceOptions source;
  media::EncodingChoice encoding = media::EncodingChoice::kAuto;
  bool realtime = false;
  // With realtime: capture times are those at which a frame was ready to be
  // sent, on this machine's steady clock, as a camera here would stamp it.
  bool host_clock = false;
  std::string session_id;  // empty = one for this run alone
  std::string results;     // empty = none
  std::string overlay;     // empty = none
  std::string movers;      // empty = none; with session.report_movers
  sdk::SessionOptions session;
  Priors priors;
  InertialTrack inertial;  // empty without session.imu
  // If set, sees every result with its picture and the lens, from the thread
  // that runs, and no summary is printed.
  std::function<void(const sdk::FrameResult& result,
                     const cv::Mat& bgr,
                     const geometry::CameraModel& camera)>
      observer;
};

class TrackRun {
 public:
  TrackRun(const TrackOptions& options, VerbContext& context);
  ~TrackRun();

  // Everything from opening the input to the summary. An interruption is no
  // error: what was done until then is kept.
  absl::Status Run();

 private:
  // A frame on its way.
  struct Pending {
    std::chrono::nanoseconds capture_time{0};
    cv::Mat bgr;  // only for the overlay and an observer
  };

  absl::Status OpenInput();
  absl::Status ChooseLens();
  absl::Status OpenSession();
  absl::Status SetTargets(const std::set<std::string>& known);
  absl::Status OpenOutputs();
  // The sending thread: until the input ends, a frame cannot be read, or the
  // user interrupts.
  absl::Status SendFrames(sdk::TrackingStream& stream);
  absl::Status SendFrame(const media::SourceFrame& frame,
                         sdk::TrackingStream& stream);
  void WaitForCaptureTime(std::chrono::nanoseconds capture_time);
  // The receiving thread.
  absl::Status ReceiveReplies(sdk::TrackingStream& stream);
  absl::Status HandleReply(const sdk::FrameReply& reply);
  absl::Status WriteOverlay(const sdk::FrameReply& reply,
                            const Pending& pending);
  void NoteTargets(const sdk::FrameResult& result);
  void NoteLens(const sdk::FrameResult& result);
  // Says, once each, why no movers are looked for.
  void NoteMovers(const sdk::FrameResult& result);
  // An error if a target was never followed.
  absl::Status CheckTargets() const;
  absl::Status FinishOutputs();
  void EndSession(bool complete);

  const TrackOptions& options_;
  VerbContext& context_;
  std::unique_ptr<sdk::Client> client_;
  std::unique_ptr<media::VideoSource> source_;
  std::optional<media::SourceFrame>
      first_frame_;  // read ahead to check its size
  cv::Size frame_size_px_;
  geometry::CameraModel camera_;
  std::string session_id_;
  bool session_open_ = false;
  std::uint64_t next_sequence_ = 0;
  std::uint64_t sequence_offset_ = 0;  // of a live input that is resumed
  media::EncodingChoice encoding_ = media::EncodingChoice::kRaw;

  std::unique_ptr<AtomicFile> csv_;
  std::unique_ptr<AtomicFile> movers_csv_;
  std::unique_ptr<OverlayWriter> video_;
  GroundTrails trails_;
  std::unique_ptr<Progress> progress_;
  InertialTrack inertial_;
  TrackSummary summary_;
  std::map<std::string, std::string> target_errors_;
  std::set<std::string> targets_followed_;
  bool lens_shown_ = false;
  std::set<sdk::MoversState> movers_states_shown_;
  int errors_shown_ = 0;
  absl::Status first_frame_error_;

  std::chrono::steady_clock::time_point start_;
  std::optional<std::chrono::nanoseconds> first_capture_time_;
  std::atomic<bool> stop_ = false;  // no more frames, for whatever reason
  std::mutex mutex_;
  std::map<std::uint64_t, Pending> pending_;  // guarded by mutex_
};

}  // namespace groundlock::cli

#endif  // GROUNDLOCK_CLIENT_CLI_TRACK_RUN_H_
