// SPDX-License-Identifier: Apache-2.0
// One browser on the WebSocket.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_VIEWER_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_VIEWER_H_

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/dashboard/proxy/address_places.h"
#include "client/dashboard/proxy/asio.h"
#include "client/dashboard/proxy/audience.h"
#include "client/dashboard/proxy/core.h"
#include "client/dashboard/proxy/outbox.h"
#include "client/dashboard/proxy/request_rules.h"
#include "client/dashboard/proxy/session_feed.h"

namespace groundlock::dashboard {

// Reads requests and hands them on; writes what its outbox says, one message at
// a time. Everything runs on the connection's strand; the public methods may be
// called from anywhere.
class Viewer final : public Listener,
                     public FeedSink,
                     public std::enable_shared_from_this<Viewer> {
 public:
  using Stream = websocket::stream<beast::tcp_stream>;

  // login: the viewer's own, or kNobodysToken.
  // place: held until the connection is closed.
  Viewer(Core* core,
         beast::tcp_stream&& stream,
         Login login,
         AddressPlaces::Place place);
  // Answers the upgrade and goes on until either side has closed.
  void Run(const http::request<http::empty_body>& upgrade);

  // To the request with this id.
  void Reply(std::uint64_t request_id, pb::ServerMessage message);
  void ReplyDone(std::uint64_t request_id, const absl::Status& status);
  void SendParts(std::vector<Buffer> parts);
  // Replies by itself.
  void Subscribe(std::uint64_t request_id,
                 const pb::Subscribe& request,
                 const gl::Session& session);
  void Unsubscribe(const std::string& session_id);
  // Flags of requests that may be cancelled.
  void AddCancel(std::uint64_t request_id, const CancelFlag& flag);
  void RemoveCancel(std::uint64_t request_id);
  bool Cancel(std::uint64_t request_id);

  // Listener.
  void Send(Buffer message) override;
  void Dismiss(Buffer last_words) override;
  const Login& login() const override { return login_; }
  const std::string& token() const { return login_.token; }
  const gl::GetCallerResponse& caller() const { return login_.caller; }

  // FeedSink.
  void OnHistory(const std::string& session_id,
                 const Results& results) override;
  void OnFrame(
      const std::shared_ptr<const FrameBuffers>& frame,
      const std::shared_ptr<const gl::WatchSessionResponse>& update) override;
  void OnFeedState(const pb::SubscriptionState& state) override;

 private:
  struct Subscription {
    bool include_images = false;
    bool skip_history = false;
    std::chrono::nanoseconds image_interval{0};
    std::chrono::steady_clock::time_point next_image{};
    std::shared_ptr<SessionFeed> feed;
  };

  template <typename Work>
  void Post(Work work);
  void OnAccepted(error_code error);
  void ReadNext();
  void OnRead(error_code error, std::size_t bytes);
  void WriteNext();
  void OnWritten(error_code error);
  void StartStallTimer();
  void Close(websocket::close_code code, const std::string& reason);
  void End();

  Core* const core_;
  const AddressPlaces::Place place_;
  Stream stream_;
  const Login login_;
  beast::flat_buffer buffer_;
  RateLimit rate_;
  int refused_in_a_row_ = 0;
  Outbox outbox_;
  Buffer writing_;  // null = no write is under way
  asio::steady_timer stall_;
  std::uint64_t writes_ = 0;
  bool open_ = false;
  bool closing_ = false;
  bool close_when_empty_ = false;
  std::map<std::string, Subscription> subscriptions_;
  std::map<std::uint64_t, CancelFlag> cancels_;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_VIEWER_H_
