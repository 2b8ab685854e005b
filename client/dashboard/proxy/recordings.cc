// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/recordings.h"

#include <google/protobuf/util/time_util.h>

#include <atomic>
#include <chrono>
#include <future>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "client/dashboard/proxy/http_rules.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

namespace fs = std::filesystem;
using google::protobuf::util::TimeUtil;

constexpr std::string_view kExtension = ".mcap";
constexpr std::chrono::seconds kRemoveTimeout{1};
constexpr std::size_t kMaxRecordings = 10'000;

}  // namespace

// Between a feed and a file.
class Recordings::Sink final : public FeedSink {
 public:
  explicit Sink(std::unique_ptr<recording::SessionRecording> file)
      : file_(std::move(file)) {}
  void OnHistory(const std::string& /*session_id*/,
                 const Results& /*results*/) override {}
  void OnFrame(
      const std::shared_ptr<const FrameBuffers>& /*frame*/,
      const std::shared_ptr<const gl::WatchSessionResponse>& update) override {
    file_->Add(update);
  }
  void OnFeedState(const pb::SubscriptionState& state) override {
    if (state.state() == pb::SubscriptionState::STATE_ENDED) ended_ = true;
  }
  recording::SessionRecording& file() { return *file_; }
  bool ended() const { return ended_; }

 private:
  const std::unique_ptr<recording::SessionRecording> file_;
  std::atomic<bool> ended_{false};
};

absl::StatusOr<std::unique_ptr<Recordings>> Recordings::Open(
    const fs::path& root, std::uint64_t max_file_bytes, Feeds* feeds) {
  std::error_code error;
  fs::create_directories(root, error);
  if (error) {
    return absl::FailedPreconditionError(
        absl::StrCat(root.string(), ": ", error.message()));
  }
  for (fs::directory_iterator it(root, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() != kExtension) continue;
    if (const absl::Status repaired = recording::RepairMcap(it->path());
        !repaired.ok()) {
      spdlog::warn("recording {}: {}",
                   it->path().filename().string(),
                   std::string(repaired.message()));
    }
  }
  return std::unique_ptr<Recordings>(
      new Recordings(root, max_file_bytes, feeds));
}

Recordings::~Recordings() {
  base::MutexLock lock(&mutex_);
  for (auto& [session, active] : active_) {
    active.sink->file().Finish().IgnoreError();
  }
}

void Recordings::Update(Active& active) {
  const recording::SessionRecordingState state = active.sink->file().state();
  active.info.set_size_bytes(state.file_bytes);
  active.info.set_frames(state.frames);
  active.info.set_duration_s(state.duration.count());
  if (!state.status.ok()) {
    active.info.set_state(pb::RecordingInfo::STATE_FAILED);
    active.info.set_message(std::string(state.status.message()));
  } else if (state.left_out > 0) {
    active.info.set_message(absl::StrCat(
        "the disk is slow: ", state.left_out, " images were left out"));
  }
}

absl::StatusOr<pb::RecordingInfo> Recordings::Start(
    const gl::Session& session,
    const std::optional<gl::MapInfo>& map,
    std::string name) {
  FinishEnded();
  if (name.empty()) {
    // Sessions' names may be as long as recordings'.
    name = absl::StrCat(
        session.session_id().substr(0, 40),
        absl::FormatTime("-%Y%m%d-%H%M%S", absl::Now(), absl::LocalTimeZone()));
  }
  RETURN_IF_ERROR(ValidateName(name, "name"));
  base::MutexLock lock(&mutex_);
  if (active_.contains(session.session_id())) {
    return absl::AlreadyExistsError(absl::StrCat(
        "session_id: ", session.session_id(), " is being recorded"));
  }
  recording::SessionRecordingOptions options;
  options.mcap.max_file_bytes = max_file_bytes_;
  auto file = recording::SessionRecording::Create(
      root_ / absl::StrCat(name, base::Abseil(kExtension)),
      session,
      map,
      options);
  if (absl::IsAlreadyExists(file.status())) {
    return absl::AlreadyExistsError(
        absl::StrCat("name: there is a recording ", name));
  }
  if (!file.ok()) return file.status();
  Active active;
  active.name = name;
  active.session = session;
  active.sink = std::make_shared<Sink>(*std::move(file));
  active.info.set_name(name);
  active.info.set_state(pb::RecordingInfo::STATE_RECORDING);
  active.info.set_session_id(session.session_id());
  active.info.set_map_name(session.map_name());
  *active.info.mutable_start_time() = TimeUtil::GetCurrentTime();
  Update(active);
  feeds_->Get(session.session_id())
      ->Add(active.sink, {.images = true, .width_px = 0}, session);
  const pb::RecordingInfo info = active.info;
  active_[session.session_id()] = std::move(active);
  failures_.erase(name);
  spdlog::info(
      "recording {}: begins, of session {}", name, session.session_id());
  return info;
}

void Recordings::AddPoints(
    const std::string& session_id,
    std::shared_ptr<const gl::GetPointCloudResponse> block) {
  base::MutexLock lock(&mutex_);
  const auto found = active_.find(session_id);
  if (found != active_.end()) {
    found->second.sink->file().AddPoints(std::move(block));
  }
}

absl::StatusOr<pb::RecordingInfo> Recordings::Stop(
    const std::string& session_id) {
  Active active;
  {
    base::MutexLock lock(&mutex_);
    const auto found = active_.find(session_id);
    if (found == active_.end()) {
      return absl::NotFoundError(
          absl::StrCat("session_id: ", session_id, " is not being recorded"));
    }
    active = std::move(found->second);
    active_.erase(found);
  }
  if (const auto feed = feeds_->Find(session_id)) {
    // A frame that viewers have seen is in the recording too. Not for ever:
    // while the dashboard stops, nobody answers.
    const auto removed = std::make_shared<std::promise<void>>();
    feed->Remove(active.sink, [removed] { removed->set_value(); });
    removed->get_future().wait_for(kRemoveTimeout);
  }
  const absl::Status finished = active.sink->file().Finish();
  Update(active);
  if (finished.ok()) {
    active.info.set_state(pb::RecordingInfo::STATE_COMPLETE);
  } else {
    base::MutexLock lock(&mutex_);
    failures_[active.name] = std::string(finished.message());
  }
  spdlog::info("recording {}: {} frames", active.name, active.info.frames());
  return active.info;
}

// Those whose session is over or that cannot go on.
void Recordings::FinishEnded() {
  std::vector<std::string> ended;
  {
    base::MutexLock lock(&mutex_);
    for (auto& [session, active] : active_) {
      if (active.sink->ended() || !active.sink->file().state().status.ok()) {
        ended.push_back(session);
      }
    }
  }
  for (const std::string& session : ended) Stop(session).IgnoreError();
}

absl::Status Recordings::Delete(const std::string& name) {
  ASSIGN_OR_RETURN(const fs::path path, PathOf(name));
  base::MutexLock lock(&mutex_);
  for (const auto& [session, active] : active_) {
    if (active.name == name) {
      return absl::FailedPreconditionError("it is being made: stop it first");
    }
  }
  std::error_code error;
  fs::remove(path, error);
  known_.erase(name);
  failures_.erase(name);
  if (!error) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(name, ": ", error.message()));
}

pb::RecordingList Recordings::List() {
  FinishEnded();
  pb::RecordingList list;
  std::error_code error;
  const fs::space_info space = fs::space(root_, error);
  // In steps, so that the list does not change with every byte written.
  if (!error) list.set_free_bytes(space.available >> 28 << 28);
  std::map<std::string, fs::path> files;
  for (fs::directory_iterator it(root_, error), end;
       !error && it != end && files.size() < kMaxRecordings;
       it.increment(error)) {
    if (it->path().extension() != kExtension) continue;
    files[it->path().stem().string()] = it->path();
  }
  base::MutexLock lock(&mutex_);
  for (auto& [session, active] : active_) {
    Update(active);
    *list.add_recordings() = active.info;
    files.erase(active.name);
  }
  for (const auto& [name, path] : files) {
    const std::uintmax_t size = fs::file_size(path, error);
    const auto time = fs::last_write_time(path, error);
    Known& known = known_[name];
    if (known.info.name().empty() || known.size != size || known.time != time) {
      known = {size, time, {}};
      known.info.set_name(name);
      known.info.set_size_bytes(size);
      const auto description = recording::DescribeRecording(path);
      if (description.ok()) {
        known.info.set_state(description->complete
                                 ? pb::RecordingInfo::STATE_COMPLETE
                                 : pb::RecordingInfo::STATE_INTERRUPTED);
        known.info.set_session_id(description->session.session_id());
        known.info.set_map_name(description->session.map_name());
        *known.info.mutable_start_time() = TimeUtil::NanosecondsToTimestamp(
            std::chrono::duration_cast<std::chrono::nanoseconds>(
                description->start_time.time_since_epoch())
                .count());
        known.info.set_duration_s(description->duration.count());
        known.info.set_frames(description->frames);
      } else {
        known.info.set_state(pb::RecordingInfo::STATE_FAILED);
        known.info.set_message(std::string(description.status().message()));
      }
    }
    pb::RecordingInfo* info = list.add_recordings();
    *info = known.info;
    if (const auto failure = failures_.find(name); failure != failures_.end()) {
      info->set_message(failure->second);
    }
  }
  std::erase_if(
      known_, [&](const auto& entry) { return !files.contains(entry.first); });
  return list;
}

std::string Recordings::NameOf(const std::string& session_id) const {
  base::MutexLock lock(&mutex_);
  const auto found = active_.find(session_id);
  return found == active_.end() ? "" : found->second.name;
}

absl::StatusOr<fs::path> Recordings::PathOf(const std::string& name) const {
  RETURN_IF_ERROR(ValidateName(name, "name"));
  fs::path path = root_ / absl::StrCat(name, base::Abseil(kExtension));
  std::error_code error;
  if (!fs::is_regular_file(path, error)) {
    return absl::NotFoundError(absl::StrCat("there is no recording ", name));
  }
  return path;
}

}  // namespace groundlock::dashboard
