// SPDX-License-Identifier: Apache-2.0
// Sessions that the dashboard feeds with frames.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SOURCE_RUNS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SOURCE_RUNS_H_

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "client/dashboard/proxy/server_address.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"
#include "map_store/base/mutex.h"
#include "map_store/geometry/box.h"

namespace groundlock::dashboard {

namespace pb = ::groundlock::dashboard::v1;

struct SourceRunSpec {
  std::string session_id;
  std::string source_id;
  std::string input;  // for media::OpenVideoSource
  std::string token;  // of whoever starts it; empty = none
  bool paused = false;
  bool loop = false;
  struct Target {
    std::string id;  // empty = made up
    geometry::Box2 box_px;
  };
  std::vector<Target> targets;  // in the first frame
};

// A thread per run, that sends frames at the source's own pace. Thread-safe.
class SourceRuns {
 public:
  SourceRuns(ServerAddress server, int max_runs);
  ~SourceRuns();  // stops them all

  // kResourceExhausted: too many. What goes wrong later shows in StateOf.
  absl::Status Start(SourceRunSpec spec);
  // kNotFound: the dashboard does not feed the session.
  absl::Status Control(const std::string& session_id,
                       pb::ControlSource::Action action);
  std::optional<pb::SourceRun> StateOf(const std::string& session_id) const;
  std::size_t num_working() const;

 private:
  std::size_t Working() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  class Run;
  const ServerAddress server_;
  const std::size_t max_runs_;
  mutable base::Mutex mutex_;
  std::map<std::string, std::shared_ptr<Run>> runs_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SOURCE_RUNS_H_
