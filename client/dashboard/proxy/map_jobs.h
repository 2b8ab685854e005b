// SPDX-License-Identifier: Apache-2.0
// Maps from uploads, imported or built by the server: long work, away from the
// network's threads.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_MAP_JOBS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_MAP_JOBS_H_

#include <atomic>
#include <functional>
#include <list>
#include <memory>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/dashboard/proxy/server_address.h"
#include "client/dashboard/proxy/uploads.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

namespace pb = ::groundlock::dashboard::v1;

// Called from the job's thread: must not wait for it.
struct MapJobCallbacks {
  std::function<void(const pb::Progress&)> progress;
  std::function<void(absl::StatusOr<pb::MapImported>)> done;  // once, last
};

// Set to end the job, which then is kCancelled.
using CancelFlag = std::shared_ptr<std::atomic<bool>>;

// Thread-safe.
class MapJobs {
 public:
  MapJobs(ServerAddress server, int max_jobs)
      : server_(std::move(server)), max_jobs_(max_jobs) {}
  ~MapJobs();  // cancels and waits

  // kResourceExhausted: too many at a time; `done` is not called then.
  absl::Status Import(const pb::ImportMap& request,
                      const Upload& upload,
                      const std::string& token,
                      const CancelFlag& cancel,
                      MapJobCallbacks callbacks);
  // From one video, or from photos. As above.
  absl::Status Build(const pb::BuildMap& request,
                     const Upload& upload,
                     const std::string& token,
                     const CancelFlag& cancel,
                     MapJobCallbacks callbacks);
  std::size_t num_working() const;

 private:
  struct Job {
    CancelFlag cancel;
    std::atomic<bool> over{false};
    std::thread thread;
  };
  using Work = std::function<absl::StatusOr<pb::MapImported>(
      const std::function<bool(const pb::Progress&)>& go_on)>;
  absl::Status Start(Work work,
                     const CancelFlag& cancel,
                     MapJobCallbacks callbacks);

  const ServerAddress server_;
  const int max_jobs_;
  mutable base::Mutex mutex_;
  std::list<Job> jobs_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_MAP_JOBS_H_
