// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/session_feed.h"

#include <algorithm>
#include <utility>

namespace groundlock::dashboard {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// Feeds that are kept with their history.
constexpr std::size_t kMaxFeeds = 32;
// A page that is loaded anew finds its history without a gap.
constexpr std::chrono::seconds kLinger{10};
constexpr milliseconds kFirstRetry{200};
constexpr milliseconds kLastRetry{3'000};

std::int64_t NowNs() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             steady_clock::now().time_since_epoch())
      .count();
}

std::shared_ptr<const FrameBuffers> MakeBuffers(
    const std::string& session_id, const gl::WatchSessionResponse& message) {
  auto frame = std::make_shared<FrameBuffers>();
  frame->session_id = session_id;
  frame->sequence = message.result().sequence();
  const bool has_image = !message.image().data().empty();
  auto update = std::make_shared<pb::ServerMessage>();
  pb::FrameUpdate* out = update->mutable_frame_update();
  out->set_session_id(session_id);
  *out->mutable_result() = message.result();
  out->set_skipped(message.skipped());
  out->set_received_time_ns(NowNs());
  out->set_has_image(has_image);
  frame->update_bytes = Encode(*update);
  frame->update = std::move(update);
  if (has_image) {
    pb::ServerMessage image;
    image.mutable_frame_image()->set_session_id(session_id);
    image.mutable_frame_image()->set_sequence(message.result().sequence());
    image.mutable_frame_image()->set_capture_time_ns(
        message.result().capture_time_ns());
    *image.mutable_frame_image()->mutable_image() = message.image();
    frame->image_bytes = Encode(image);
  }
  return frame;
}

}  // namespace

ImageWish ImageWish::With(const ImageWish& other) const {
  if (!images || !other.images) return images ? *this : other;
  const bool full = width_px == 0 || other.width_px == 0;
  return {true, full ? 0 : std::max(width_px, other.width_px)};
}

SessionFeed::SessionFeed(asio::io_context& io,
                         sdk::Relay* relay,
                         std::string session_id,
                         int max_history,
                         std::function<std::string()> token)
    : strand_(asio::make_strand(io)),
      relay_(relay),
      session_id_(std::move(session_id)),
      max_history_(static_cast<std::size_t>(max_history)),
      token_(std::move(token)),
      retry_(strand_),
      linger_(strand_),
      last_use_(steady_clock::now()) {
  state_.set_session_id(session_id_);
}

void SessionFeed::Add(const std::shared_ptr<FeedSink>& sink,
                      const ImageWish& wish,
                      const gl::Session& session) {
  asio::post(
      strand_,
      [self = shared_from_this(),
       sink,
       wish,
       creation = session.create_time().SerializeAsString()] {
        Results kept;
        {
          base::MutexLock lock(&self->mutex_);
          if (self->creation_ != creation) {
            self->history_.clear();
            self->creation_ = creation;
          }
          kept.assign(self->history_.begin(), self->history_.end());
        }
        const bool is_new = self->sinks_.insert_or_assign(sink, wish).second;
        {
          base::MutexLock lock(&self->mutex_);
          self->num_sinks_ = static_cast<int>(self->sinks_.size());
          self->last_use_ = steady_clock::now();
        }
        if (is_new) sink->OnHistory(self->session_id_, kept);
        if (self->state_.state() == pb::SubscriptionState::STATE_LIVE ||
            self->state_.state() == pb::SubscriptionState::STATE_RECONNECTING) {
          sink->OnFeedState(self->state_);
        }
        self->Update();
      });
}

void SessionFeed::Remove(const std::shared_ptr<FeedSink>& sink,
                         std::function<void()> done) {
  asio::post(strand_, [self = shared_from_this(), sink, done] {
    const bool was_there = self->sinks_.erase(sink) > 0;
    if (done) done();
    if (!was_there) return;
    {
      base::MutexLock lock(&self->mutex_);
      self->num_sinks_ = static_cast<int>(self->sinks_.size());
      self->last_use_ = steady_clock::now();
    }
    self->Update();
  });
}

void SessionFeed::Stop() {
  asio::post(strand_, [self = shared_from_this()] {
    self->stopped_ = true;
    self->sinks_.clear();
    self->retry_.cancel();
    self->linger_.cancel();
    self->EndWatches();
  });
}

Results SessionFeed::history() const {
  base::MutexLock lock(&mutex_);
  return {history_.begin(), history_.end()};
}

int SessionFeed::num_sinks() const {
  base::MutexLock lock(&mutex_);
  return num_sinks_;
}

steady_clock::time_point SessionFeed::last_use() const {
  base::MutexLock lock(&mutex_);
  return last_use_;
}

void SessionFeed::Update() {
  if (stopped_) return;
  linger_.cancel();
  if (sinks_.empty()) {
    linger_.expires_after(kLinger);
    linger_.async_wait([self = shared_from_this()](error_code error) {
      if (error || !self->sinks_.empty() || self->stopped_) return;
      self->retry_.cancel();
      self->EndWatches();
      self->state_.set_state(pb::SubscriptionState::STATE_UNSPECIFIED);
    });
    return;
  }
  ImageWish wish;
  for (const auto& [sink, wanted] : sinks_) wish = wish.With(wanted);
  if (watch_ == nullptr) {
    if (!waiting_to_retry_) StartWatch(wish);
  } else if (wish != watched_ && old_watch_ == nullptr) {
    // Else when the change under way is done.
    old_watch_ = std::exchange(watch_, nullptr);
    StartWatch(wish);
  }
}

void SessionFeed::EndWatches() {
  for (const auto* watch : {&watch_, &old_watch_}) {
    if (*watch != nullptr) (*watch)->Cancel();
  }
  watch_ = nullptr;
  old_watch_ = nullptr;
  ++generation_;
}

void SessionFeed::StartWatch(const ImageWish& wish) {
  const std::uint64_t generation = ++generation_;
  watched_ = wish;
  gl::WatchSessionRequest request;
  request.set_session_id(session_id_);
  request.set_include_images(wish.images);
  request.set_image_width_px(wish.width_px);
  const auto self = shared_from_this();
  watch_ = relay_->Watch(
      token_(),
      request,
      [self, generation] {
        asio::post(self->strand_, [self, generation] {
          if (generation != self->generation_) return;
          self->failures_ = 0;
          self->SetState(pb::SubscriptionState::STATE_LIVE, "");
        });
      },
      [self, generation](gl::WatchSessionResponse message) {
        asio::post(self->strand_,
                   [self, generation, message = std::move(message)]() mutable {
                     self->OnMessage(generation, std::move(message));
                   });
      },
      [self, generation](const absl::Status& status) {
        asio::post(self->strand_, [self, generation, status] {
          self->OnEnd(generation, status);
        });
      });
}

void SessionFeed::OnMessage(std::uint64_t generation,
                            gl::WatchSessionResponse message) {
  if (watch_ == nullptr) return;
  const bool of_old = generation + 1 == generation_ && old_watch_ != nullptr;
  if (generation != generation_ && !of_old) return;
  const bool first_of_new = !of_old && old_watch_ != nullptr;
  if (first_of_new && message.result().sequence() <= last_sequence_) {
    watch_->Continue();
    return;
  }
  last_sequence_ = message.result().sequence();
  const auto update =
      std::make_shared<const gl::WatchSessionResponse>(std::move(message));
  const auto frame = MakeBuffers(session_id_, *update);
  Keep(update->result());
  for (const auto& [sink, wish] : sinks_) sink->OnFrame(frame, update);
  (of_old ? old_watch_ : watch_)->Continue();
  if (!first_of_new) return;
  std::exchange(old_watch_, nullptr)->Cancel();
  Update();  // wishes may have changed meanwhile
}

void SessionFeed::Keep(const gl::FrameResult& result) {
  auto kept = std::make_shared<gl::FrameResult>(result);
  kept->mutable_camera()->clear_match_xy_px();
  kept->mutable_camera()->clear_match_xyz_m();
  base::MutexLock lock(&mutex_);
  history_.push_back(std::move(kept));
  if (history_.size() > max_history_) history_.pop_front();
}

void SessionFeed::OnEnd(std::uint64_t generation, const absl::Status& status) {
  if (generation + 1 == generation_ && old_watch_ != nullptr) {
    old_watch_ = nullptr;
    Update();  // wishes may have changed meanwhile
  }
  if (generation != generation_) return;
  EndWatches();
  if (stopped_ || sinks_.empty()) return;
  if (status.ok() || absl::IsNotFound(status)) {
    SetState(pb::SubscriptionState::STATE_ENDED, "the session has ended");
    sinks_.clear();
    base::MutexLock lock(&mutex_);
    num_sinks_ = 0;
    return;
  }
  const bool transient = absl::IsUnavailable(status) ||
                         absl::IsCancelled(status) || absl::IsUnknown(status) ||
                         absl::IsInternal(status) ||
                         absl::IsDeadlineExceeded(status);
  SetState(transient ? pb::SubscriptionState::STATE_RECONNECTING
                     : pb::SubscriptionState::STATE_FAILED,
           std::string(status.message()));
  const milliseconds wait =
      transient
          ? std::min(kFirstRetry * (1 << std::min(failures_, 8)), kLastRetry)
          : kLastRetry;
  ++failures_;
  waiting_to_retry_ = true;
  retry_.expires_after(wait);
  retry_.async_wait([self = shared_from_this()](error_code error) {
    self->waiting_to_retry_ = false;
    if (!error) self->Update();
  });
}

void SessionFeed::SetState(pb::SubscriptionState::State state,
                           const std::string& message) {
  if (state_.state() == state && state_.message() == message) return;
  state_.set_state(state);
  state_.set_message(message);
  for (const auto& [sink, wish] : sinks_) sink->OnFeedState(state_);
}

std::shared_ptr<SessionFeed> Feeds::Get(const std::string& session_id) {
  base::MutexLock lock(&mutex_);
  std::shared_ptr<SessionFeed>& feed = feeds_[session_id];
  if (feed != nullptr) return feed;
  feed = std::make_shared<SessionFeed>(
      io_, relay_, session_id, max_history_, token_);
  const std::shared_ptr<SessionFeed> made = feed;
  while (feeds_.size() > kMaxFeeds) {
    auto oldest = feeds_.end();
    for (auto it = feeds_.begin(); it != feeds_.end(); ++it) {
      if (it->second == made || it->second->num_sinks() > 0) continue;
      if (oldest == feeds_.end() ||
          it->second->last_use() < oldest->second->last_use()) {
        oldest = it;
      }
    }
    if (oldest == feeds_.end()) break;
    oldest->second->Stop();
    feeds_.erase(oldest);
  }
  return made;
}

std::shared_ptr<SessionFeed> Feeds::Find(const std::string& session_id) const {
  base::MutexLock lock(&mutex_);
  const auto found = feeds_.find(session_id);
  return found == feeds_.end() ? nullptr : found->second;
}

void Feeds::StopAll() {
  base::MutexLock lock(&mutex_);
  for (const auto& [id, feed] : feeds_) feed->Stop();
}

}  // namespace groundlock::dashboard
