// SPDX-License-Identifier: Apache-2.0
// A session in a file: its results and images as they come, readable by
// Foxglove and by the dashboard's page. Topics: see the end of
// proto/groundlock/dashboard/v1/dashboard.proto.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_SESSION_RECORDING_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_SESSION_RECORDING_H_

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/dashboard/recording/mcap_writer.h"
#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"

namespace groundlock::recording {

struct SessionRecordingOptions {
  McapWriterOptions mcap;
  // What may wait for the disk; beyond, images are left out, and then results.
  std::uint64_t max_waiting_bytes = 64 << 20;
  // What was recorded is on disk after this time, s.
  std::chrono::milliseconds flush_interval{1'000};
};

struct SessionRecordingState {
  std::uint64_t frames = 0;    // results on disk or on their way there
  std::uint64_t left_out = 0;  // images and results that found no room
  std::uint64_t file_bytes = 0;
  std::chrono::duration<double> duration{0.0};
  absl::Status status;  // why nothing is written any more
};

// Has a thread of its own that writes. Thread-safe.
class SessionRecording {
 public:
  // kAlreadyExists, kFailedPrecondition.
  static absl::StatusOr<std::unique_ptr<SessionRecording>> Create(
      const std::filesystem::path& path,
      const groundlock::v1::Session& session,
      const std::optional<groundlock::v1::MapInfo>& map,
      const SessionRecordingOptions& options);
  virtual ~SessionRecording() = default;  // finishes

  // Does not wait.
  virtual void Add(
      std::shared_ptr<const groundlock::v1::WatchSessionResponse> update) = 0;
  virtual void AddPoints(
      std::shared_ptr<const groundlock::v1::GetPointCloudResponse> block) = 0;
  // Writes what waits and closes the file; returns when it is whole.
  virtual absl::Status Finish() = 0;
  virtual SessionRecordingState state() const = 0;
};

struct RecordingDescription {
  bool complete = false;
  groundlock::v1::Session session;
  std::optional<groundlock::v1::MapInfo> map;
  std::chrono::system_clock::time_point start_time;
  std::chrono::duration<double> duration{0.0};
  std::uint64_t frames = 0;
};

// kNotFound, kDataLoss.
absl::StatusOr<RecordingDescription> DescribeRecording(
    const std::filesystem::path& path);

// The results in order, until `take` returns false.
absl::Status ReadResults(
    const std::filesystem::path& path,
    const std::function<bool(const groundlock::v1::FrameResult&)>& take);

}  // namespace groundlock::recording

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_RECORDING_SESSION_RECORDING_H_
