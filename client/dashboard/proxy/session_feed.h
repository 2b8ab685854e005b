// SPDX-License-Identifier: Apache-2.0
// One watch of a session at the server, for all who look on.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SESSION_FEED_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SESSION_FEED_H_

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "client/dashboard/proxy/asio.h"
#include "client/dashboard/proxy/outbox.h"
#include "client/sdk/relay.h"
#include "groundlock/v1/tracking.pb.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

namespace gl = ::groundlock::v1;

using Results = std::vector<std::shared_ptr<const gl::FrameResult>>;

// Called from the feed's strand: must not wait.
class FeedSink {
 public:
  virtual ~FeedSink() = default;
  // First: what the feed has kept, oldest first, without matches.
  virtual void OnHistory(const std::string& session_id,
                         const Results& results) = 0;
  virtual void OnFrame(
      const std::shared_ptr<const FrameBuffers>& frame,
      const std::shared_ptr<const gl::WatchSessionResponse>& update) = 0;
  // Also at once after OnHistory.
  virtual void OnFeedState(const pb::SubscriptionState& state) = 0;
};

// What is wanted of a session's images.
struct ImageWish {
  bool images = false;
  std::uint32_t width_px = 0;  // at which they are shown; 0 = as they are

  // What serves both.
  ImageWish With(const ImageWish& other) const;
  bool operator==(const ImageWish&) const = default;
};

// Watches as long as somebody looks on and a little longer; connects again
// while the server is away. Encodes a frame once, whoever gets it. Thread-safe.
class SessionFeed : public std::enable_shared_from_this<SessionFeed> {
 public:
  // relay: outlives the feed's use. token: what to watch with, asked for each
  // attempt.
  SessionFeed(asio::io_context& io,
              sdk::Relay* relay,
              std::string session_id,
              int max_history,
              std::function<std::string()> token);

  // Adds the sink, or changes its wish. The session's creation tells a session
  // from an earlier one of the same name, whose history goes.
  void Add(const std::shared_ptr<FeedSink>& sink,
           const ImageWish& wish,
           const gl::Session& session);
  // done: called when the sink has got its last frame.
  void Remove(const std::shared_ptr<FeedSink>& sink,
              std::function<void()> done = nullptr);
  // Ends the watch for good.
  void Stop();

  Results history() const;
  int num_sinks() const;
  std::chrono::steady_clock::time_point last_use() const;

 private:
  void Update();  // starts, changes or ends the watch
  void StartWatch(const ImageWish& wish);
  void EndWatches();
  void OnMessage(std::uint64_t generation, gl::WatchSessionResponse message);
  void OnEnd(std::uint64_t generation, const absl::Status& status);
  void SetState(pb::SubscriptionState::State state, const std::string& message);
  void Keep(const gl::FrameResult& result);

  const Strand strand_;
  sdk::Relay* const relay_;
  const std::string session_id_;
  const std::size_t max_history_;
  const std::function<std::string()> token_;

  // Of the strand.
  std::map<std::shared_ptr<FeedSink>, ImageWish> sinks_;
  std::shared_ptr<sdk::RelayedWatch> watch_;
  std::uint64_t generation_ = 0;  // of watch_; older ones no longer count
  ImageWish watched_;             // by watch_
  // The one before goes on until the new one's first frame.
  std::shared_ptr<sdk::RelayedWatch> old_watch_;
  std::uint64_t last_sequence_ = 0;
  bool stopped_ = false;
  int failures_ = 0;  // in a row
  asio::steady_timer retry_;
  asio::steady_timer linger_;
  bool waiting_to_retry_ = false;
  pb::SubscriptionState state_;

  mutable base::Mutex mutex_;
  std::deque<std::shared_ptr<const gl::FrameResult>> history_
      ABSL_GUARDED_BY(mutex_);
  std::string creation_ ABSL_GUARDED_BY(mutex_);
  int num_sinks_ ABSL_GUARDED_BY(mutex_) = 0;
  std::chrono::steady_clock::time_point last_use_ ABSL_GUARDED_BY(mutex_);
};

// The feeds by session. Thread-safe.
class Feeds {
 public:
  Feeds(asio::io_context& io,
        sdk::Relay* relay,
        int max_history,
        std::function<std::string()> token)
      : io_(io),
        relay_(relay),
        max_history_(max_history),
        token_(std::move(token)) {}

  // Made if there is none. The longest unused ones make room.
  std::shared_ptr<SessionFeed> Get(const std::string& session_id);
  // Null if there is none.
  std::shared_ptr<SessionFeed> Find(const std::string& session_id) const;
  std::size_t size() const {
    base::MutexLock lock(&mutex_);
    return feeds_.size();
  }
  void StopAll();

 private:
  asio::io_context& io_;
  sdk::Relay* const relay_;
  const int max_history_;
  const std::function<std::string()> token_;
  mutable base::Mutex mutex_;
  std::map<std::string, std::shared_ptr<SessionFeed>> feeds_
      ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SESSION_FEED_H_
