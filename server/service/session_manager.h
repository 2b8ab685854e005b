// SPDX-License-Identifier: Apache-2.0
// The sessions of a server.
#ifndef GROUNDLOCK_SERVER_SERVICE_SESSION_MANAGER_H_
#define GROUNDLOCK_SERVER_SERVICE_SESSION_MANAGER_H_

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "map_store/storage/store.h"
#include "server/service/metrics.h"
#include "server/service/options.h"
#include "server/service/session.h"
#include "server/service/worker_pool.h"

namespace groundlock::service {

// Makes the object that tracks; tests put in their own.
using CoreFactory =
    std::function<absl::StatusOr<std::unique_ptr<tracking::TrackingSession>>(
        std::shared_ptr<const map::Map> map,
        const geometry::CameraModel& camera,
        const tracking::SessionOptions& options)>;

// Thread-safe. Frames do not come by here: streams hold their session.
class SessionManager {
 public:
  // All pointers must outlive the manager. A thread looks for sessions that
  // have been idle for too long.
  SessionManager(const SessionLimits& limits,
                 CoreFactory factory,
                 storage::Store* store,
                 WorkerPool* pool,
                 Metrics* metrics);
  ~SessionManager();
  SessionManager(const SessionManager&) = delete;
  SessionManager& operator=(const SessionManager&) = delete;

  // Opens the map, so it may take a while. kNotFound (map), kAlreadyExists
  // (id), kResourceExhausted, kUnavailable (stopping).
  absl::StatusOr<std::shared_ptr<Session>> Create(SessionSpec spec);
  absl::StatusOr<std::shared_ptr<Session>> Find(const std::string& id) const;
  // Up to `limit` sessions with ids above `after`, by id.
  std::vector<std::shared_ptr<Session>> List(const std::string& after,
                                             std::size_t limit) const;
  absl::Status Delete(const std::string& id);

  // No new sessions and frames; see Session::Drain.
  void Drain();
  // Ends all sessions.
  void Close();

 private:
  absl::StatusOr<std::string> Reserve(const std::string& wanted_id);
  absl::StatusOr<std::shared_ptr<Session>> Make(SessionSpec spec);
  void ExpireNow();
  void Expire();
  std::vector<std::shared_ptr<Session>> All() const;

  const SessionLimits limits_;
  const CoreFactory factory_;
  storage::Store* const store_;
  WorkerPool* const pool_;
  Metrics* const metrics_;

  mutable base::Mutex mutex_;
  // Null while the session is being made.
  std::map<std::string, std::shared_ptr<Session>> sessions_
      ABSL_GUARDED_BY(mutex_);
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread janitor_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SESSION_MANAGER_H_
