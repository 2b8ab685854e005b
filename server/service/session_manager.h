// SPDX-License-Identifier: Apache-2.0
// The sessions of a server.
#ifndef GROUNDLOCK_SERVER_SERVICE_SESSION_MANAGER_H_
#define GROUNDLOCK_SERVER_SERVICE_SESSION_MANAGER_H_

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "map_store/storage/store.h"
#include "server/service/account.h"
#include "server/service/metrics.h"
#include "server/service/options.h"
#include "server/service/principal.h"
#include "server/service/session.h"
#include "server/service/worker_pool.h"

namespace groundlock::service {

// Makes the object that tracks; tests put in their own.
using CoreFactory =
    std::function<absl::StatusOr<std::unique_ptr<tracking::TrackingSession>>(
        std::shared_ptr<const map::Map> map,
        const geometry::CameraModel& camera,
        const tracking::SessionOptions& options)>;

// What a caller wants of a session.
enum class Deed { kSee, kAct };

// Each session belongs to a tenant, and to the principal of it that has begun
// it. Thread-safe. Frames do not come by here: streams hold their session.
class SessionManager {
 public:
  // All pointers must outlive the manager. A thread looks for sessions that
  // have been idle for too long.
  SessionManager(const SessionLimits& limits,
                 CoreFactory factory,
                 WorkerPool* pool,
                 Metrics* metrics);
  ~SessionManager();
  SessionManager(const SessionManager&) = delete;
  SessionManager& operator=(const SessionManager&) = delete;

  // Opens the map, so it may take a while. kNotFound (map), kAlreadyExists
  // (id), kResourceExhausted, kUnavailable (stopping).
  //   spec  with its tenant and owner;  maps  those of the tenant
  //   account  whose room it takes; null = nobody's
  absl::StatusOr<std::shared_ptr<Session>> Create(
      SessionSpec spec,
      storage::Store& maps,
      const std::shared_ptr<Account>& account = nullptr);
  // A session that the principal may do that with. kNotFound also for one that
  // it may not see; kPermissionDenied: it may see it only.
  absl::StatusOr<std::shared_ptr<Session>> Find(const Principal& principal,
                                                const std::string& id,
                                                Deed deed) const;
  // Up to `limit` sessions with ids above `after` that the principal may see,
  // by id.
  std::vector<std::shared_ptr<Session>> List(const Principal& principal,
                                             const std::string& after,
                                             std::size_t limit) const;
  // Errors as Find.
  absl::Status Delete(const Principal& principal, const std::string& id);

  // No new sessions and frames; see Session::Drain.
  void Drain();
  // Ends all sessions.
  void Close();

 private:
  // Tenant and id.
  using Key = std::pair<std::string, std::string>;
  static Key KeyOf(const SessionSpec& spec) { return {spec.tenant, spec.id}; }

  absl::Status Reserve(SessionSpec& spec,
                       const std::shared_ptr<Account>& account);
  absl::StatusOr<std::shared_ptr<Session>> Make(SessionSpec spec,
                                                storage::Store& maps);
  bool Remove(const std::shared_ptr<Session>& session);
  void ExpireNow();
  void Expire();
  std::vector<std::shared_ptr<Session>> All() const;

  const SessionLimits limits_;
  const std::shared_ptr<FrameMemory> memory_;
  const CoreFactory factory_;
  WorkerPool* const pool_;
  Metrics* const metrics_;

  mutable base::Mutex mutex_;
  // Null while the session is being made.
  std::map<Key, std::shared_ptr<Session>> sessions_ ABSL_GUARDED_BY(mutex_);
  // What their owners' accounts have given.
  std::map<Key, std::shared_ptr<void>> places_ ABSL_GUARDED_BY(mutex_);
  bool stopping_ ABSL_GUARDED_BY(mutex_) = false;
  std::thread janitor_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SESSION_MANAGER_H_
