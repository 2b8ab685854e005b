// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/catalogue.h"

#include <utility>

namespace groundlock::dashboard {
namespace {

// Most sessions and maps that are listed.
constexpr int kMaxListed = 10'000;
// How often the server is asked when nobody looks, in intervals.
constexpr int kIdleFactor = 5;

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

std::string Catalogue::token() const {
  return own_token_.empty() ? logins_->AnyToken().value_or("") : own_token_;
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
  if (!probed_) {
    Probe();
    return;
  }
  const std::string known = token();
  if (login_required().value_or(false) && known.empty()) {
    // Nobody is logged in: a probe tells whether the server is there.
    Probe();
    return;
  }
  ListSessions(known, "");
}

// A call without a token: does the server want one?
void Catalogue::Probe() {
  gl::ListSessionsRequest request;
  request.set_page_size(1);
  relay_->Call("",
               request,
               [self = shared_from_this()](
                   const absl::StatusOr<gl::ListSessionsResponse>& response) {
                 asio::post(self->strand_, [self, status = response.status()] {
                   if (!status.ok() && !absl::IsUnauthenticated(status)) {
                     self->OnFailure("", status);
                     return;
                   }
                   self->probed_ = true;
                   {
                     base::MutexLock lock(&self->mutex_);
                     self->login_required_ = !status.ok();
                   }
                   if (!status.ok()) {
                     // Those who came while it was open to all.
                     self->audience_->ForEach([](Listener& listener) {
                       if (listener.token().empty()) listener.Dismiss(nullptr);
                     });
                   }
                   self->SetState(pb::ServerState::STATE_CONNECTED, "");
                   const std::string known = self->token();
                   if (!status.ok() && known.empty()) {
                     self->Done();
                   } else {
                     self->ListSessions(known, "");
                   }
                 });
               });
}

void Catalogue::ListSessions(const std::string& token,
                             const std::string& page) {
  gl::ListSessionsRequest request;
  request.set_page_size(1'000);
  request.set_page_token(page);
  relay_->Call(
      token,
      request,
      [self = shared_from_this(),
       token](absl::StatusOr<gl::ListSessionsResponse> response) {
        asio::post(self->strand_,
                   [self, token, response = std::move(response)] {
                     if (!response.ok()) {
                       self->OnFailure(token, response.status());
                       return;
                     }
                     for (const gl::Session& session : response->sessions()) {
                       *self->new_sessions_.add_sessions()->mutable_session() =
                           session;
                     }
                     if (!response->next_page_token().empty() &&
                         self->new_sessions_.sessions_size() < kMaxListed) {
                       self->ListSessions(token, response->next_page_token());
                     } else {
                       self->ListMaps(token, "");
                     }
                   });
      });
}

void Catalogue::ListMaps(const std::string& token, const std::string& page) {
  gl::ListMapsRequest request;
  request.set_page_size(1'000);
  request.set_page_token(page);
  relay_->Call(
      token,
      request,
      [self = shared_from_this(),
       token](absl::StatusOr<gl::ListMapsResponse> response) {
        asio::post(
            self->strand_, [self, token, response = std::move(response)] {
              if (!response.ok()) {
                self->OnFailure(token, response.status());
                return;
              }
              self->new_maps_.mutable_maps()->MergeFrom(response->maps());
              if (!response->next_page_token().empty() &&
                  self->new_maps_.maps_size() < kMaxListed) {
                self->ListMaps(token, response->next_page_token());
                return;
              }
              {
                base::MutexLock lock(&self->mutex_);
                self->sessions_ = self->new_sessions_;
                self->maps_ = self->new_maps_;
              }
              self->SetState(pb::ServerState::STATE_CONNECTED, "");
              self->Done();
            });
      });
}

void Catalogue::OnFailure(const std::string& token,
                          const absl::Status& status) {
  if (absl::IsUnauthenticated(status)) {
    probed_ = false;  // ask again what it wants
    if (!token.empty()) {
      logins_->Revoke(token);
      pb::ServerMessage message;
      message.mutable_server_state()->set_state(
          pb::ServerState::STATE_UNAUTHENTICATED);
      message.mutable_server_state()->set_message(
          "the server no longer accepts the token: log in again");
      const Buffer last_words = Encode(message);
      audience_->ForEach([&](Listener& listener) {
        if (listener.token() == token) listener.Dismiss(last_words);
      });
    }
  } else {
    probed_ = false;
    SetState(pb::ServerState::STATE_UNREACHABLE, std::string(status.message()));
  }
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
