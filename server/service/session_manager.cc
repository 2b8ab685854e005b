// SPDX-License-Identifier: Apache-2.0
#include "server/service/session_manager.h"

#include <algorithm>
#include <random>
#include <utility>

#include "absl/strings/str_format.h"
#include "absl/time/time.h"
#include "map_store/base/logging.h"
#include "map_store/base/status.h"
#include "server/service/session_lens.h"
#include "server/service/tenant_store.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {
namespace {

absl::Status NoSession(const std::string& id) {
  return absl::NotFoundError(absl::StrCat("no session '", id, "'"));
}

// Ids need to be unlike each other, not reproducible.
std::string RandomId() {
  std::random_device device;
  return absl::StrFormat("session-%08x%08x", device(), device());
}

bool MaySee(const Principal& principal, const SessionSpec& spec) {
  return spec.tenant == principal.tenant &&
         (spec.owner == principal.name || principal.May(Scope::kSessionsWatch));
}

bool MayAct(const Principal& principal, const SessionSpec& spec) {
  return spec.tenant == principal.tenant &&
         (spec.owner == principal.name || principal.May(Scope::kSessionsAll));
}

// As the log names a session.
std::string LogName(const SessionSpec& spec) {
  return NameOfTenant(spec.tenant, spec.id);
}

}  // namespace

SessionManager::SessionManager(const SessionLimits& limits,
                               CoreFactory factory,
                               WorkerPool* pool,
                               Metrics* metrics)
    : limits_(limits),
      memory_(
          FrameMemory::Create(limits.frame_memory_bytes, limits.max_sessions)),
      factory_(std::move(factory)),
      pool_(pool),
      metrics_(metrics),
      janitor_([this] { Expire(); }) {}

SessionManager::~SessionManager() {
  Close();
  janitor_.join();
}

// Takes a place, and gives the session an id if it has none.
absl::Status SessionManager::Reserve(SessionSpec& spec,
                                     const std::shared_ptr<Account>& account) {
  base::MutexLock lock(&mutex_);
  if (stopping_) return absl::UnavailableError("the server is stopping");
  if (static_cast<int>(sessions_.size()) >= limits_.max_sessions) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the server has ",
                     sessions_.size(),
                     " sessions, the most that are allowed"));
  }
  std::shared_ptr<void> place;
  if (account != nullptr) {
    ASSIGN_OR_RETURN(place, account->TakeSession());
  }
  if (spec.id.empty()) spec.id = RandomId();
  if (!sessions_.emplace(KeyOf(spec), nullptr).second) {
    return absl::AlreadyExistsError(
        absl::StrCat("session_id: session '", spec.id, "' exists"));
  }
  places_[KeyOf(spec)] = std::move(place);
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Make(
    SessionSpec spec, storage::Store& maps) {
  std::shared_ptr<const map::Map> map;
  if (!spec.map_name.empty()) {
    ASSIGN_OR_RETURN(const storage::MapVersion version,
                     maps.Get(spec.map_name, spec.map_version));
    spec.map_version = version.version;
    ASSIGN_OR_RETURN(map, maps.Open(spec.map_name, spec.map_version));
  } else if (spec.map_version != 0) {
    return absl::InvalidArgumentError("map_version: given without a map_name");
  }
  if (map != nullptr && !spec.camera) {
    ASSIGN_OR_RETURN(spec.camera, LensOfMap(*map, spec.map_name));
    spec.takes_lens_of_map = true;
  }
  ASSIGN_OR_RETURN(
      auto core,
      factory_(
          map, spec.camera.value_or(geometry::CameraModel()), spec.options));
  return Session::Create(std::move(spec),
                         std::move(map),
                         std::move(core),
                         limits_,
                         pool_,
                         metrics_,
                         memory_->NewShare());
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Create(
    SessionSpec spec,
    storage::Store& maps,
    const std::shared_ptr<Account>& account) {
  RETURN_IF_ERROR(Reserve(spec, account));
  const Key key = KeyOf(spec);
  absl::StatusOr<std::shared_ptr<Session>> session;
  try {
    session = Make(std::move(spec), maps);
  } catch (const std::exception& error) {
    session = absl::InternalError(error.what());
  }
  base::MutexLock lock(&mutex_);
  if (session.ok() && stopping_) {
    session = absl::UnavailableError("the server is stopping");
  }
  if (!session.ok()) {
    sessions_.erase(key);
    places_.erase(key);
    return session.status();
  }
  sessions_[key] = *session;
  ++metrics_->sessions_created;
  ++metrics_->sessions;
  const base::LogFields fields({{"session", (*session)->spec().id}});
  spdlog::info("session {}: created{}",
               LogName((*session)->spec()),
               (*session)->spec().map_name.empty()
                   ? std::string(" without a map")
                   : " on map " + (*session)->spec().map_name);
  return session;
}

absl::StatusOr<std::shared_ptr<Session>> SessionManager::Find(
    const Principal& principal, const std::string& id, Deed deed) const {
  base::MutexLock lock(&mutex_);
  const auto found = sessions_.find({principal.tenant, id});
  if (found == sessions_.end() || found->second == nullptr ||
      !MaySee(principal, found->second->spec())) {
    return NoSession(id);
  }
  if (deed == Deed::kAct && !MayAct(principal, found->second->spec())) {
    return absl::PermissionDeniedError(absl::StrCat("session '",
                                                    id,
                                                    "' is another's: ",
                                                    principal.name,
                                                    " may watch it only"));
  }
  return found->second;
}

std::vector<std::shared_ptr<Session>> SessionManager::List(
    const Principal& principal,
    const std::string& after,
    std::size_t limit) const {
  std::vector<std::shared_ptr<Session>> sessions;
  base::MutexLock lock(&mutex_);
  for (auto it = sessions_.upper_bound({principal.tenant, after});
       it != sessions_.end() && it->first.first == principal.tenant &&
       sessions.size() < limit;
       ++it) {
    if (it->second != nullptr && MaySee(principal, it->second->spec())) {
      sessions.push_back(it->second);
    }
  }
  return sessions;
}

std::vector<std::shared_ptr<Session>> SessionManager::All() const {
  std::vector<std::shared_ptr<Session>> sessions;
  base::MutexLock lock(&mutex_);
  for (const auto& [key, session] : sessions_) {
    if (session != nullptr) sessions.push_back(session);
  }
  return sessions;
}

// False if it is not the server's any more.
bool SessionManager::Remove(const std::shared_ptr<Session>& session) {
  base::MutexLock lock(&mutex_);
  const auto found = sessions_.find(KeyOf(session->spec()));
  if (found == sessions_.end() || found->second != session) return false;
  places_.erase(found->first);
  sessions_.erase(found);
  --metrics_->sessions;
  return true;
}

absl::Status SessionManager::Delete(const Principal& principal,
                                    const std::string& id) {
  ASSIGN_OR_RETURN(const auto session, Find(principal, id, Deed::kAct));
  if (!Remove(session)) return NoSession(id);
  session->Close(
      absl::NotFoundError(absl::StrCat("session '", id, "' was deleted")));
  const base::LogFields fields({{"session", id}});
  spdlog::info("session {}: deleted", LogName(session->spec()));
  return absl::OkStatus();
}

void SessionManager::Drain() {
  {
    base::MutexLock lock(&mutex_);
    stopping_ = true;
  }
  for (const auto& session : All()) session->Drain();
}

void SessionManager::Close() {
  std::vector<std::shared_ptr<Session>> sessions;
  {
    base::MutexLock lock(&mutex_);
    stopping_ = true;
    for (auto& [key, session] : sessions_) {
      if (session != nullptr) sessions.push_back(std::move(session));
    }
    sessions_.clear();
    metrics_->sessions -= static_cast<std::int64_t>(sessions.size());
  }
  for (const auto& session : sessions) {
    session->Close(absl::UnavailableError("the server is stopping"));
  }
}

void SessionManager::ExpireNow() {
  for (const auto& session : All()) {
    if (!session->Expired()) continue;
    if (!Remove(session)) continue;
    ++metrics_->sessions_expired;
    session->Close(absl::NotFoundError(
        absl::StrCat("session '",
                     session->spec().id,
                     "' expired: it was idle for too long")));
    const base::LogFields fields({{"session", session->spec().id},
                                  {"principal", session->spec().owner},
                                  {"tenant", session->spec().tenant}});
    spdlog::info("session {}: expired", LogName(session->spec()));
  }
}

void SessionManager::Expire() {
  // Often enough that a session outlives its time by a quarter at most.
  const absl::Duration interval =
      std::clamp(absl::FromChrono(std::min(limits_.idle_timeout,
                                           limits_.stream_idle_timeout)) /
                     4,
                 absl::Milliseconds(10),
                 absl::Seconds(10));
  for (;;) {
    {
      base::MutexLock lock(&mutex_);
      mutex_.AwaitFor(absl::ToChronoNanoseconds(interval),
                      [this]()
                          ABSL_NO_THREAD_SAFETY_ANALYSIS { return stopping_; });
      if (stopping_) return;
    }
    ExpireNow();
  }
}

}  // namespace groundlock::service
