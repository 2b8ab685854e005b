// SPDX-License-Identifier: Apache-2.0
// What goes in and out of a session of the service.
#ifndef GROUNDLOCK_SERVER_SERVICE_SESSION_TYPES_H_
#define GROUNDLOCK_SERVER_SERVICE_SESSION_TYPES_H_

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "server/image/frame.h"
#include "server/service/frame_memory.h"
#include "server/service/spans.h"
#include "server/tracking/tracking_session.h"

namespace groundlock::service {

struct SessionSpec {
  std::string id;
  std::string tenant;    // ids are unlike each other within it
  std::string owner;     // the principal that has begun it
  std::string map_name;  // empty = none
  std::uint64_t map_version = 0;
  // Unset: of the map, or none without a map.
  std::optional<geometry::CameraModel> camera;
  // The camera is the map's lens: it fits the same picture in other sizes too.
  bool takes_lens_of_map = false;
  tracking::SessionOptions options;
  bool live = false;
  bool report_matches = false;
  SpanContext span;  // of the call that has made it
};

// A frame as it came from the client.
struct FrameJob {
  std::uint64_t sequence = 0;
  std::chrono::nanoseconds capture_time{0};
  image::Encoding encoding = image::Encoding::kAuto;
  std::string bytes;
  int width_px = 0;
  int height_px = 0;
  std::optional<geometry::CameraModel> camera;
  tracking::SensorReadings sensors;
  // Not OK: a field is wrong, and the frame will be answered so.
  absl::Status status;
  std::chrono::steady_clock::time_point received;
  FrameMemory::Held memory;  // that its image takes; null = that is not counted
};

struct TargetFault {
  std::string target_id;
  std::string message;
};
struct FrameOutcome {
  tracking::FrameResult result;
  std::vector<TargetFault> target_faults;
  std::chrono::nanoseconds queue_time{0};
};
enum class DropReason { kOverload, kShutdown };

// The one answer to a frame. A Status says why it could not be processed.
struct Answer {
  std::uint64_t sequence = 0;
  std::variant<FrameOutcome, absl::Status, DropReason> content;
  // The frame, while watchers want images; else null.
  std::shared_ptr<const FrameJob> frame;
};

// The stream that feeds a session. Called without the session's lock held.
class FrameSink {
 public:
  virtual ~FrameSink() = default;
  // NextAnswer has something, or Drained may have changed.
  virtual void OnAnswers() = 0;
  // A frame that was refused for want of room may be offered again.
  virtual void OnRoom() = 0;
  // The session takes no more frames from this stream. Unless `drain`, it has
  // no more answers for it either.
  virtual void OnEnd(const absl::Status& reason, bool drain) = 0;
};

class ResultWatcher {
 public:
  virtual ~ResultWatcher() = default;
  virtual bool wants_images() const = 0;
  // Called from the session's worker: must not wait.
  virtual void OnAnswer(const std::shared_ptr<const Answer>& answer) = 0;
  virtual void OnEnd(const absl::Status& reason) = 0;
};

struct SessionDescription {
  SessionSpec spec;
  std::chrono::system_clock::time_point created;
  std::uint64_t next_sequence = 0;
  std::uint64_t frames_processed = 0;
  std::uint64_t frames_dropped = 0;
  std::uint64_t frames_failed = 0;
  std::vector<std::string> target_ids;
  bool streaming = false;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SESSION_TYPES_H_
