// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/catalogue.h"

#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/rights.h"

namespace groundlock::dashboard {
namespace {

// Most sessions and maps that are listed.
constexpr int kMaxListed = 10'000;
// How often the server is asked when nobody looks, in intervals.
constexpr int kIdleFactor = 5;
// How often it is asked about those who have logged in, likewise.
constexpr int kCheckFactor = 5;

}  // namespace

Catalogue::Catalogue(asio::io_context& io,
                     asio::thread_pool& work,
                     sdk::Relay* relay,
                     Logins* logins,
                     Audience* audience,
                     LocalLists local,
                     std::string own_token,
                     std::chrono::milliseconds interval)
    : strand_(asio::make_strand(io)),
      work_(work),
      relay_(relay),
      logins_(logins),
      audience_(audience),
      local_(std::move(local)),
      own_token_(std::move(own_token)),
      interval_(interval),
      timer_(strand_) {}

void Catalogue::Start() { Refresh(); }

void Catalogue::Stop() {
  asio::post(strand_, [self = shared_from_this()] {
    self->stopped_ = true;
    self->timer_.cancel();
  });
}

void Catalogue::Refresh() {
  asio::post(strand_, [self = shared_from_this()] {
    if (self->polling_) {
      self->again_ = true;
    } else {
      self->timer_.cancel();
      self->Poll();
    }
  });
}

void Catalogue::Welcome(const std::shared_ptr<Listener>& listener) {
  base::MutexLock lock(&mutex_);
  for (const Buffer& message : {state_message_,
                                maps_message_,
                                sessions_message_,
                                sources_message_,
                                recordings_message_}) {
    if (message != nullptr) listener->Send(message);
  }
}

std::optional<bool> Catalogue::login_required() const {
  base::MutexLock lock(&mutex_);
  return login_required_;
}

pb::ServerState Catalogue::server_state() const {
  base::MutexLock lock(&mutex_);
  return state_;
}

std::optional<gl::GetCallerResponse> Catalogue::self() const {
  base::MutexLock lock(&mutex_);
  return self_;
}

std::optional<gl::MapInfo> Catalogue::FindMap(const std::string& name,
                                              std::uint64_t version) const {
  base::MutexLock lock(&mutex_);
  for (const gl::MapInfo& map : maps_.maps()) {
    if (map.name() == name && (version == 0 || map.version() == version)) {
      return map;
    }
  }
  return std::nullopt;
}

void Catalogue::Poll() {
  if (stopped_) return;
  polling_ = true;
  again_ = false;
  new_sessions_.Clear();
  new_maps_.Clear();
  if (probed_) {
    ListSessions("");
  } else {
    Probe();
  }
}

// Who are we, and does the server want to know that of anybody?
void Catalogue::Probe() {
  relay_->Call(own_token_,
               gl::GetCallerRequest(),
               [self = shared_from_this()](
                   const absl::StatusOr<gl::GetCallerResponse>& caller) {
                 asio::post(self->strand_,
                            [self, caller] { self->OnProbed(caller); });
               });
}

void Catalogue::OnProbed(const absl::StatusOr<gl::GetCallerResponse>& caller) {
  if (!caller.ok() && !absl::IsUnauthenticated(caller.status())) {
    OnFailure(caller.status());
    return;
  }
  absl::Status may_show = caller.status();
  if (caller.ok()) may_show = MayLookOn(*caller, *caller);
  const bool login_required = !caller.ok() || !caller->open_to_all();
  {
    base::MutexLock lock(&mutex_);
    login_required_ = login_required;
    self_.reset();
    if (may_show.ok()) self_ = *caller;
  }
  if (login_required) {
    // Those who came while it was open to all.
    audience_->ForEach([](Listener& listener) {
      if (listener.login().token == kNobodysToken) listener.Dismiss(nullptr);
    });
  }
  if (!may_show.ok()) {
    SetState(pb::ServerState::STATE_UNREACHABLE,
             absl::StrCat("the server does not let this dashboard look on: ",
                          may_show.message(),
                          " (its own --token-file, or --cert and --key)"));
    Done();
    return;
  }
  probed_ = true;
  SetState(pb::ServerState::STATE_CONNECTED, "");
  ListSessions("");
}

void Catalogue::ListSessions(const std::string& page) {
  gl::ListSessionsRequest request;
  request.set_page_size(1'000);
  request.set_page_token(page);
  relay_->Call(
      own_token_,
      request,
      [self = shared_from_this()](
          absl::StatusOr<gl::ListSessionsResponse> response) {
        asio::post(self->strand_, [self, response = std::move(response)] {
          if (!response.ok()) {
            self->OnFailure(response.status());
            return;
          }
          for (const gl::Session& session : response->sessions()) {
            *self->new_sessions_.add_sessions()->mutable_session() = session;
          }
          if (!response->next_page_token().empty() &&
              self->new_sessions_.sessions_size() < kMaxListed) {
            self->ListSessions(response->next_page_token());
          } else {
            self->ListMaps("");
          }
        });
      });
}

void Catalogue::ListMaps(const std::string& page) {
  gl::ListMapsRequest request;
  request.set_page_size(1'000);
  request.set_page_token(page);
  relay_->Call(
      own_token_,
      request,
      [self =
           shared_from_this()](absl::StatusOr<gl::ListMapsResponse> response) {
        asio::post(self->strand_, [self, response = std::move(response)] {
          if (!response.ok()) {
            self->OnFailure(response.status());
            return;
          }
          self->new_maps_.mutable_maps()->MergeFrom(response->maps());
          if (!response->next_page_token().empty() &&
              self->new_maps_.maps_size() < kMaxListed) {
            self->ListMaps(response->next_page_token());
            return;
          }
          {
            base::MutexLock lock(&self->mutex_);
            self->sessions_ = self->new_sessions_;
            self->maps_ = self->new_maps_;
          }
          self->SetState(pb::ServerState::STATE_CONNECTED, "");
          self->CheckLogins();
          self->Done();
        });
      });
}

void Catalogue::CheckLogins() {
  const auto now = std::chrono::steady_clock::now();
  const auto us = self();
  if (!us || us->open_to_all() || now < next_check_) return;
  next_check_ = now + kCheckFactor * interval_;
  // Those who look on whatever has become of their log-in, too.
  std::map<std::string, Login> by_token;
  for (Login& login : logins_->All()) {
    by_token.emplace(login.token, std::move(login));
  }
  audience_->ForEach([&by_token](const Listener& listener) {
    if (listener.login().token == kNobodysToken) return;
    by_token.emplace(listener.login().token, listener.login());
  });
  for (const auto& [token, login] : by_token) {
    relay_->Call(
        login.token,
        gl::GetCallerRequest(),
        [self = shared_from_this(),
         login = login](const absl::StatusOr<gl::GetCallerResponse>& caller) {
          // Whoever may do other things by now logs in anew.
          if (caller.ok() ? caller->SerializeAsString() ==
                                login.caller.SerializeAsString()
                          : !absl::IsUnauthenticated(caller.status())) {
            return;
          }
          asio::post(self->strand_,
                     [self, token = login.token] { self->LogOut(token); });
        });
  }
}

void Catalogue::LogOut(const std::string& token) {
  logins_->Revoke(token);
  Dismiss("the server no longer accepts the token: log in again",
          [&](const Login& login) { return login.token == token; });
}

void Catalogue::DismissLogin(const std::string& cookie) {
  Dismiss("logged out",
          [&](const Login& login) { return login.cookie == cookie; });
}

void Catalogue::Dismiss(const std::string& why,
                        const std::function<bool(const Login&)>& is_meant) {
  const Buffer last_words = EndOfLogin(why);
  audience_->ForEach([&](Listener& listener) {
    if (is_meant(listener.login())) listener.Dismiss(last_words);
  });
}

void Catalogue::OnFailure(const absl::Status& status) {
  probed_ = false;  // ask again what it wants
  SetState(pb::ServerState::STATE_UNREACHABLE, std::string(status.message()));
  Done();
}

void Catalogue::Done() {
  polling_ = false;
  if (stopped_) return;
  if (!publishing_) {
    publishing_ = true;
    asio::post(work_, [self = shared_from_this()] {
      self->PublishLocal();
      asio::post(self->strand_, [self] { self->publishing_ = false; });
    });
  }
  if (again_) {
    Poll();
    return;
  }
  timer_.expires_after(audience_->size() > 0 ? interval_
                                             : interval_ * kIdleFactor);
  timer_.async_wait([self = shared_from_this()](error_code error) {
    if (!error && !self->polling_) self->Poll();
  });
}

void Catalogue::PublishLocal() {
  pb::ServerMessage sessions;
  pb::ServerMessage maps;
  bool connected = false;
  {
    base::MutexLock lock(&mutex_);
    *sessions.mutable_sessions() = sessions_;
    *maps.mutable_maps() = maps_;
    connected = state_.state() == pb::ServerState::STATE_CONNECTED;
  }
  if (connected) {
    for (pb::SessionEntry& entry :
         *sessions.mutable_sessions()->mutable_sessions()) {
      local_.complete(&entry);
    }
    Publish(&maps_message_, maps);
    Publish(&sessions_message_, sessions);
  }
  pb::ServerMessage sources;
  *sources.mutable_sources() = local_.sources();
  Publish(&sources_message_, sources);
  pb::ServerMessage recordings;
  *recordings.mutable_recordings() = local_.recordings();
  Publish(&recordings_message_, recordings);
}

void Catalogue::Publish(Buffer* last, const pb::ServerMessage& message) {
  const Buffer bytes = Encode(message);
  {
    base::MutexLock lock(&mutex_);
    if (*last != nullptr && **last == *bytes) return;
    *last = bytes;
  }
  audience_->ForEach([&bytes](Listener& listener) { listener.Send(bytes); });
}

void Catalogue::SetState(pb::ServerState::State state,
                         const std::string& message) {
  pb::ServerMessage out;
  out.mutable_server_state()->set_state(state);
  out.mutable_server_state()->set_message(message);
  {
    base::MutexLock lock(&mutex_);
    state_ = out.server_state();
  }
  Publish(&state_message_, out);
}

}  // namespace groundlock::dashboard
