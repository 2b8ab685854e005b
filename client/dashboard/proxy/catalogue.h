// SPDX-License-Identifier: Apache-2.0
// What there is: the server's state, sessions and maps, asked for again and
// again, and the dashboard's own sources and recordings; pushed to all viewers
// whenever it changes.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_CATALOGUE_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_CATALOGUE_H_

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "client/dashboard/proxy/asio.h"
#include "client/dashboard/proxy/audience.h"
#include "client/dashboard/proxy/logins.h"
#include "client/sdk/relay.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

namespace gl = ::groundlock::v1;

// What the dashboard itself knows. Called from the work pool; they may read the
// disk.
struct LocalLists {
  // Fills in what is the dashboard's of a session: viewers, recording, source.
  std::function<void(pb::SessionEntry*)> complete;
  std::function<pb::SourceList()> sources;
  std::function<pb::RecordingList()> recordings;
};

// Thread-safe. Must be owned by a shared_ptr.
class Catalogue : public std::enable_shared_from_this<Catalogue> {
 public:
  // All must outlive it. own_token: the dashboard's; empty: it is known by its
  // certificate, or the server wants nothing.
  Catalogue(asio::io_context& io,
            asio::thread_pool& work,
            sdk::Relay* relay,
            Logins* logins,
            Audience* audience,
            LocalLists local,
            std::string own_token,
            std::chrono::milliseconds interval);

  void Start();
  void Stop();
  // Asks at once: something was done that changes the lists.
  void Refresh();
  // Sends everything to one that is new.
  void Welcome(const std::shared_ptr<Listener>& listener);

  // Whoever has logged in with this cookie has logged out.
  void DismissLogin(const std::string& cookie);

  // Whether the server wants tokens; nullopt before it has answered.
  std::optional<bool> login_required() const;
  pb::ServerState server_state() const;
  // What calls for all viewers are made with: the dashboard's own.
  const std::string& token() const { return own_token_; }
  // Who the dashboard is for the server; nullopt if that is not known, and then
  // nothing is shown.
  std::optional<gl::GetCallerResponse> self() const;
  std::optional<gl::MapInfo> FindMap(const std::string& name,
                                     std::uint64_t version) const;

 private:
  void Poll();
  void Probe();
  void OnProbed(const absl::StatusOr<gl::GetCallerResponse>& caller);
  void ListSessions(const std::string& page);
  void ListMaps(const std::string& page);
  // Whether those who have logged in still may look on.
  void CheckLogins();
  void LogOut(const std::string& token);
  void Dismiss(const std::string& why,
               const std::function<bool(const Login&)>& is_meant);
  void OnFailure(const absl::Status& status);
  void Done();
  void PublishLocal();
  void Publish(Buffer* last, const pb::ServerMessage& message);
  void SetState(pb::ServerState::State state, const std::string& message);

  const Strand strand_;
  asio::thread_pool& work_;
  sdk::Relay* const relay_;
  Logins* const logins_;
  Audience* const audience_;
  const LocalLists local_;
  const std::string own_token_;
  const std::chrono::milliseconds interval_;

  // Of the strand.
  asio::steady_timer timer_;
  bool polling_ = false;
  bool again_ = false;  // Refresh came while polling
  bool stopped_ = false;
  bool probed_ = false;  // since the server was last away
  std::chrono::steady_clock::time_point next_check_;  // of logins
  bool publishing_ = false;
  pb::SessionList new_sessions_;
  pb::MapList new_maps_;

  mutable base::Mutex mutex_;
  std::optional<bool> login_required_ ABSL_GUARDED_BY(mutex_);
  std::optional<gl::GetCallerResponse> self_ ABSL_GUARDED_BY(mutex_);
  pb::ServerState state_ ABSL_GUARDED_BY(mutex_);
  pb::SessionList sessions_ ABSL_GUARDED_BY(mutex_);
  pb::MapList maps_ ABSL_GUARDED_BY(mutex_);
  // As sent last; null = never.
  Buffer state_message_ ABSL_GUARDED_BY(mutex_);
  Buffer sessions_message_ ABSL_GUARDED_BY(mutex_);
  Buffer maps_message_ ABSL_GUARDED_BY(mutex_);
  Buffer sources_message_ ABSL_GUARDED_BY(mutex_);
  Buffer recordings_message_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_CATALOGUE_H_
