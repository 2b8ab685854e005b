// SPDX-License-Identifier: Apache-2.0
// Recordings: those under way and those on disk.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_RECORDINGS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_RECORDINGS_H_

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/dashboard/proxy/session_feed.h"
#include "client/dashboard/recording/session_recording.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

// ROOT/NAME.mcap. Methods read the disk: not for the network's threads.
// Thread-safe.
class Recordings {
 public:
  // Repairs what an earlier run left behind. feeds: outlives this.
  static absl::StatusOr<std::unique_ptr<Recordings>> Open(
      const std::filesystem::path& root,
      std::uint64_t max_file_bytes,
      Feeds* feeds);
  ~Recordings();  // finishes what is under way

  // name: empty = session and time. kAlreadyExists: the session is being
  // recorded, or the name is taken.
  absl::StatusOr<pb::RecordingInfo> Start(const gl::Session& session,
                                          const std::optional<gl::MapInfo>& map,
                                          std::string name);
  // A sample of the map's points for the recording of a session.
  void AddPoints(const std::string& session_id,
                 std::shared_ptr<const gl::GetPointCloudResponse> block);
  absl::StatusOr<pb::RecordingInfo> Stop(const std::string& session_id);
  // kFailedPrecondition while it is being made.
  absl::Status Delete(const std::string& name);
  pb::RecordingList List();
  // The name of the recording of a session; empty = none.
  std::string NameOf(const std::string& session_id) const;
  // kNotFound.
  absl::StatusOr<std::filesystem::path> PathOf(const std::string& name) const;

 private:
  class Sink;
  struct Active {
    std::string name;
    gl::Session session;
    std::shared_ptr<Sink> sink;
    pb::RecordingInfo info;
  };
  Recordings(std::filesystem::path root,
             std::uint64_t max_file_bytes,
             Feeds* feeds)
      : root_(std::move(root)),
        max_file_bytes_(max_file_bytes),
        feeds_(feeds) {}
  static void Update(Active& active);
  void FinishEnded();

  const std::filesystem::path root_;
  const std::uint64_t max_file_bytes_;
  Feeds* const feeds_;
  mutable base::Mutex mutex_;
  std::map<std::string, Active> active_ ABSL_GUARDED_BY(mutex_);  // by session
  // What was read of files, by path, size and time of change.
  struct Known {
    std::uintmax_t size = 0;
    std::filesystem::file_time_type time;
    pb::RecordingInfo info;
  };
  std::map<std::string, Known> known_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, std::string> failures_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_RECORDINGS_H_
