// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/session_start.h"

#include <chrono>
#include <utility>

#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

constexpr std::chrono::seconds kLookInterval{2};

using Done = std::function<void(absl::StatusOr<gl::Session>)>;

void Feed(Core& core,
          const std::string& token,
          const pb::StartSession& start,
          const Sources::Found& found,
          const gl::Session& session,
          const Done& done) {
  SourceRunSpec spec;
  spec.session_id = session.session_id();
  spec.source_id = found.source.source_id();
  spec.input = found.input;
  spec.token = token;
  spec.paused = start.paused();
  spec.loop = start.loop();
  for (const pb::MarkedTarget& target : start.targets()) {
    const gl::Box2& box = target.box();
    spec.targets.push_back({target.target_id(),
                            geometry::Box2::FromXywh(
                                box.x(), box.y(), box.width(), box.height())});
  }
  // A run that this one replaces is waited for.
  asio::post(core.work,
             [&core, spec = std::move(spec), session, done]() mutable {
               const absl::Status started = core.runs->Start(std::move(spec));
               if (!started.ok()) {
                 done(started);
                 return;
               }
               core.catalogue->Refresh();
               done(session);
             });
}

}  // namespace

void StartSession(Core& core,
                  const std::string& token,
                  const pb::StartSession& start,
                  bool use_existing,
                  Done done) {
  asio::post(core.work, [&core, token, start, use_existing, done] {
    const auto found = core.sources->Find(start.source_id());
    if (!found.ok()) {
      done(found.status());
      return;
    }
    gl::CreateSessionRequest request = start.session();
    if (!request.has_camera()) {
      if (!found->source.has_camera()) {
        done(absl::InvalidArgumentError(
            "session.camera: give the camera's intrinsics, or put a "
            "camera.json beside the video"));
        return;
      }
      *request.mutable_camera() = found->source.camera();
    }
    core.relay->Call(
        token,
        request,
        [&core, token, start, use_existing, found = *found, done](
            const absl::StatusOr<gl::CreateSessionResponse>& created) {
          if (created.ok()) {
            Feed(core, token, start, found, created->session(), done);
            return;
          }
          if (!use_existing || !absl::IsAlreadyExists(created.status())) {
            done(created.status());
            return;
          }
          gl::GetSessionRequest get;
          get.set_session_id(start.session().session_id());
          core.relay->Call(
              token,
              get,
              [&core, token, start, found, done](
                  const absl::StatusOr<gl::GetSessionResponse>& existing) {
                if (existing.ok()) {
                  Feed(core, token, start, found, existing->session(), done);
                } else {
                  done(existing.status());
                }
              });
        });
  });
}

Autostart::Autostart(Core* core,
                     std::string token,
                     std::vector<pb::StartSession> starts)
    : core_(core),
      token_(std::move(token)),
      starts_(std::move(starts)),
      strand_(asio::make_strand(core->io)),
      timer_(strand_),
      under_way_(starts_.size(), false) {}

void Autostart::Start() {
  if (starts_.empty()) return;
  asio::post(strand_, [self = shared_from_this()] { self->Look(); });
}

void Autostart::Stop() {
  asio::post(strand_, [self = shared_from_this()] {
    self->stopped_ = true;
    self->timer_.cancel();
  });
}

void Autostart::Look() {
  if (stopped_) return;
  const bool connected = core_->catalogue->server_state().state() ==
                         pb::ServerState::STATE_CONNECTED;
  for (std::size_t i = 0; connected && i < starts_.size(); ++i) {
    const std::string& id = starts_[i].session().session_id();
    const auto run = core_->runs->StateOf(id);
    const bool again =
        !run.has_value() || run->state() == pb::SourceRun::STATE_FAILED ||
        (run->state() == pb::SourceRun::STATE_ENDED && starts_[i].loop());
    if (under_way_[i] || !again) continue;
    under_way_[i] = true;
    StartSession(
        *core_,
        token_,
        starts_[i],
        /*use_existing=*/true,
        [self = shared_from_this(), i, id](
            const absl::StatusOr<gl::Session>& session) {
          asio::post(self->strand_, [self, i, id, status = session.status()] {
            self->under_way_[i] = false;
            if (status.ok()) {
              spdlog::info(
                  "session {}: fed from {}", id, self->starts_[i].source_id());
            } else {
              spdlog::warn("session {}: {}", id, std::string(status.message()));
            }
          });
        });
  }
  timer_.expires_after(kLookInterval);
  timer_.async_wait([self = shared_from_this()](error_code error) {
    if (!error) self->Look();
  });
}

}  // namespace groundlock::dashboard
