// SPDX-License-Identifier: Apache-2.0
// Sessions that the dashboard makes and feeds: on request, and from its start.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SESSION_START_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SESSION_START_H_

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/dashboard/proxy/core.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"

namespace groundlock::dashboard {

// Makes the session and begins to feed it; `done` is called once, from any
// thread. use_existing: a session of that name that is there already is fed.
void StartSession(Core& core,
                  const std::string& token,
                  const pb::StartSession& start,
                  bool use_existing,
                  std::function<void(absl::StatusOr<gl::Session>)> done);

// Keeps sessions running: starts each when the server is there, and again when
// its source has failed or the server has lost it (and, if it loops, when it
// has ended). Must be owned by a shared_ptr.
class Autostart : public std::enable_shared_from_this<Autostart> {
 public:
  // core: outlives it. starts: with a session_id each.
  Autostart(Core* core,
            std::string token,
            std::vector<pb::StartSession> starts);
  void Start();
  void Stop();

 private:
  void Look();

  Core* const core_;
  const std::string token_;
  const std::vector<pb::StartSession> starts_;
  const Strand strand_;
  asio::steady_timer timer_;
  std::vector<bool> under_way_;
  bool stopped_ = false;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SESSION_START_H_
