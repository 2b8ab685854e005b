// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/viewer.h"

#include <algorithm>
#include <utility>

#include "client/dashboard/proxy/requests.h"
#include "map_store/base/version.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

using std::chrono::steady_clock;

// Results in a part of a history.
constexpr std::size_t kHistoryPart = 256;
// Requests refused for their rate, after which the viewer is sent away.
constexpr int kMaxRefused = 200;
// A viewer that says nothing is asked whether it is there.
constexpr std::chrono::milliseconds kMinIdleTimeout{30'000};
// What the kernel may hold for a viewer: little, so that images are fresh.
constexpr int kSendBufferBytes = 512 << 10;

std::vector<Buffer> EncodeHistory(const std::string& session_id,
                                  const Results& results) {
  std::vector<Buffer> parts;
  for (std::size_t begin = 0; begin == 0 || begin < results.size();
       begin += kHistoryPart) {
    pb::ServerMessage message;
    pb::History* history = message.mutable_history();
    history->set_session_id(session_id);
    const std::size_t end = std::min(begin + kHistoryPart, results.size());
    for (std::size_t i = begin; i < end; ++i) {
      *history->add_results() = *results[i];
    }
    history->set_last(end == results.size());
    parts.push_back(Encode(message));
  }
  return parts;
}

Buffer Hello(const Core& core) {
  const DashboardOptions& options = core.options;
  pb::ServerMessage message;
  pb::Hello* hello = message.mutable_hello();
  hello->set_version(base::Version());
  hello->set_server_address(options.server.target);
  hello->set_recordings_enabled(core.recordings != nullptr);
  hello->set_uploads_enabled(core.uploads != nullptr);
  pb::Limits* limits = hello->mutable_limits();
  limits->set_max_message_bytes(options.viewers.max_message_bytes);
  limits->set_max_video_bytes(options.uploads_limits.max_video_bytes);
  limits->set_max_map_bytes(options.uploads_limits.max_map_bytes);
  limits->set_max_map_files(options.uploads_limits.max_map_files);
  limits->set_max_points(options.max_points);
  limits->set_max_recording_bytes(options.max_recording_bytes);
  limits->set_max_requests_per_s(
      static_cast<std::uint32_t>(options.viewers.max_requests_per_s));
  limits->set_max_subscriptions(
      static_cast<std::uint32_t>(options.viewers.max_subscriptions));
  return Encode(message);
}

}  // namespace

template <typename Work>
void Viewer::Post(Work work) {
  asio::post(stream_.get_executor(),
             [self = shared_from_this(), work = std::move(work)]() mutable {
               work(*self);
             });
}

Viewer::Viewer(Core* core,
               beast::tcp_stream&& stream,
               Login login,
               AddressPlaces::Place place)
    : core_(core),
      place_(std::move(place)),
      stream_(std::move(stream)),
      login_(std::move(login)),
      rate_(core->options.viewers.max_requests_per_s),
      outbox_(core->options.viewers.max_waiting_replies,
              core->options.viewers.max_waiting_results),
      stall_(stream_.get_executor()) {}

void Viewer::Run(const http::request<http::empty_body>& upgrade) {
  beast::get_lowest_layer(stream_).expires_never();
  error_code ignored;
  auto& socket = beast::get_lowest_layer(stream_).socket();
  socket.set_option(Tcp::no_delay(true), ignored);
  socket.set_option(asio::socket_base::send_buffer_size(kSendBufferBytes),
                    ignored);
  auto timeout =
      websocket::stream_base::timeout::suggested(beast::role_type::server);
  timeout.idle_timeout =
      std::max(kMinIdleTimeout, 2 * core_->options.viewers.stall_timeout);
  timeout.keep_alive_pings = true;
  stream_.set_option(timeout);
  stream_.read_message_max(core_->options.viewers.max_message_bytes);
  stream_.binary(true);
  // Images are compressed, and results small.
  stream_.auto_fragment(false);
  stream_.async_accept(upgrade, [self = shared_from_this()](error_code error) {
    self->OnAccepted(error);
  });
}

void Viewer::OnAccepted(error_code error) {
  if (error) return;
  open_ = true;
  if (!core_->audience.Add(shared_from_this())) {
    Close(websocket::close_code::try_again_later, "too many viewers");
    return;
  }
  // Whoever logged out while this connection was made has not found it.
  if (!login_.cookie.empty() && !core_->logins.Find(login_.cookie)) {
    Dismiss(EndOfLogin("logged out"));
    return;
  }
  outbox_.AddReply(Hello(*core_));
  core_->catalogue->Welcome(shared_from_this());
  core_->catalogue->Refresh();
  WriteNext();
  ReadNext();
}

void Viewer::ReadNext() {
  stream_.async_read(
      buffer_,
      [self = shared_from_this()](error_code error, std::size_t bytes) {
        self->OnRead(error, bytes);
      });
}

void Viewer::OnRead(error_code error, std::size_t /*bytes*/) {
  if (error) {
    End();
    return;
  }
  if (!stream_.got_binary()) {
    Close(websocket::close_code::bad_payload, "expected binary messages");
    return;
  }
  const auto data = buffer_.cdata();
  auto request =
      ParseRequest({static_cast<const char*>(data.data()), data.size()});
  if (request.ok() && request->has_image_taken()) {
    const pb::ImageTaken& taken = request->image_taken();
    // Has no reply, and no more can come than images were sent.
    if (outbox_.ImageTaken(taken.session_id(), taken.sequence()) ||
        rate_.Take(steady_clock::now())) {
      buffer_.consume(buffer_.size());
      WriteNext();
      ReadNext();
      return;
    }
    Close(websocket::close_code::policy_error, "too many requests");
    return;
  }
  if (!rate_.Take(steady_clock::now())) {
    if (++refused_in_a_row_ > kMaxRefused) {
      Close(websocket::close_code::policy_error, "too many requests");
      return;
    }
    request = absl::ResourceExhaustedError("too many requests: slow down");
  } else {
    refused_in_a_row_ = 0;
  }
  // An id in a message that is otherwise wrong still finds its reply.
  std::uint64_t request_id = 0;
  if (!request.ok()) {
    pb::ClientMessage partial;
    partial.ParsePartialFromArray(data.data(), static_cast<int>(data.size()));
    request_id = partial.request_id();
  }
  buffer_.consume(buffer_.size());
  if (request.ok()) {
    HandleRequest(*core_, shared_from_this(), *std::move(request));
  } else {
    ReplyDone(request_id, request.status());
  }
  ReadNext();
}

void Viewer::WriteNext() {
  if (writing_ != nullptr || !open_ || closing_) return;
  writing_ = outbox_.Next();
  if (writing_ == nullptr) {
    if (close_when_empty_) {
      Close(websocket::close_code::policy_error, "dismissed");
    }
    return;
  }
  StartStallTimer();
  ++core_->counters.messages_sent;
  core_->counters.bytes_sent += writing_->size();
  stream_.async_write(
      asio::buffer(*writing_),
      [self = shared_from_this()](error_code error, std::size_t /*bytes*/) {
        self->OnWritten(error);
      });
}

void Viewer::OnWritten(error_code error) {
  ++writes_;
  stall_.cancel();
  writing_ = nullptr;
  if (error) {
    End();
    return;
  }
  WriteNext();
}

void Viewer::StartStallTimer() {
  stall_.expires_after(core_->options.viewers.stall_timeout);
  stall_.async_wait(
      [weak = weak_from_this(), write = writes_](error_code error) {
        const auto self = weak.lock();
        if (error || self == nullptr || self->writes_ != write ||
            self->writing_ == nullptr) {
          return;
        }
        spdlog::info("a viewer takes nothing: it is disconnected");
        ++self->core_->counters.viewers_stalled;
        // Not by a message, which could not be sent either.
        self->End();
      });
}

void Viewer::Close(websocket::close_code code, const std::string& reason) {
  if (closing_ || !open_) return;
  closing_ = true;
  stream_.async_close(websocket::close_reason(code, reason),
                      [self = shared_from_this()](error_code) { self->End(); });
}

void Viewer::End() {
  if (!open_) return;
  open_ = false;
  stall_.cancel();
  core_->audience.Remove(this);
  for (const auto& [session, subscription] : subscriptions_) {
    subscription.feed->Remove(shared_from_this());
  }
  subscriptions_.clear();
  for (const auto& [id, flag] : cancels_) *flag = true;
  cancels_.clear();
  beast::get_lowest_layer(stream_).close();
}

void Viewer::Send(Buffer message) {
  Post([message = std::move(message)](Viewer& self) mutable {
    if (!self.open_) return;
    if (!self.outbox_.AddReply(std::move(message))) {
      self.Close(websocket::close_code::policy_error, "too slow");
      return;
    }
    self.WriteNext();
  });
}

void Viewer::Dismiss(Buffer last_words) {
  Post([last_words = std::move(last_words)](Viewer& self) mutable {
    if (last_words != nullptr) self.outbox_.AddReply(std::move(last_words));
    self.close_when_empty_ = true;
    self.WriteNext();
  });
}

void Viewer::Reply(std::uint64_t request_id, pb::ServerMessage message) {
  message.set_request_id(request_id);
  Send(Encode(message));
}

void Viewer::ReplyDone(std::uint64_t request_id, const absl::Status& status) {
  pb::ServerMessage message;
  if (status.ok()) {
    message.mutable_done();
  } else {
    message.mutable_error()->set_code(static_cast<int>(status.code()));
    message.mutable_error()->set_message(std::string(status.message()));
  }
  Reply(request_id, std::move(message));
}

void Viewer::SendParts(std::vector<Buffer> parts) {
  Post([parts = std::move(parts)](Viewer& self) mutable {
    if (!self.open_) return;
    if (!self.outbox_.AddParts(std::move(parts))) {
      self.Close(websocket::close_code::policy_error, "too slow");
      return;
    }
    self.WriteNext();
  });
}

void Viewer::Subscribe(std::uint64_t request_id,
                       const pb::Subscribe& request,
                       const gl::Session& session) {
  Post([request_id, request, session](Viewer& self) {
    if (!self.open_) return;
    const auto max =
        static_cast<std::size_t>(self.core_->options.viewers.max_subscriptions);
    if (!self.subscriptions_.contains(request.session_id()) &&
        self.subscriptions_.size() >= max) {
      self.ReplyDone(request_id,
                     absl::ResourceExhaustedError(
                         "too many sessions are followed: leave one"));
      return;
    }
    pb::ServerMessage reply;
    *reply.mutable_subscribed()->mutable_session() = session;
    self.Reply(request_id, std::move(reply));
    Subscription& subscription = self.subscriptions_[request.session_id()];
    subscription.include_images = request.include_images();
    subscription.skip_history = request.skip_history();
    subscription.image_interval =
        request.max_images_per_s() > 0.0
            ? std::chrono::nanoseconds(static_cast<std::int64_t>(
                  1e9 / std::max(request.max_images_per_s(), 0.01)))
            : std::chrono::nanoseconds(0);
    self.outbox_.SetImageWindow(request.session_id(),
                                request.max_images_in_flight());
    subscription.feed = self.core_->feeds->Get(request.session_id());
    subscription.feed->Add(self.shared_from_this(),
                           {.images = request.include_images(),
                            .width_px = request.image_width_px()},
                           session);
  });
}

void Viewer::Unsubscribe(const std::string& session_id) {
  Post([session_id](Viewer& self) {
    const auto found = self.subscriptions_.find(session_id);
    if (found == self.subscriptions_.end()) return;
    found->second.feed->Remove(self.shared_from_this());
    self.subscriptions_.erase(found);
    self.outbox_.Forget(session_id);
  });
}

void Viewer::AddCancel(std::uint64_t request_id, const CancelFlag& flag) {
  cancels_[request_id] = flag;
}

void Viewer::RemoveCancel(std::uint64_t request_id) {
  Post([request_id](Viewer& self) { self.cancels_.erase(request_id); });
}

bool Viewer::Cancel(std::uint64_t request_id) {
  const auto found = cancels_.find(request_id);
  if (found == cancels_.end()) return false;
  *found->second = true;
  return true;
}

void Viewer::OnHistory(const std::string& session_id, const Results& results) {
  Post([session_id, results](Viewer& self) {
    const auto found = self.subscriptions_.find(session_id);
    if (found == self.subscriptions_.end() || found->second.skip_history) {
      return;
    }
    self.SendParts(EncodeHistory(session_id, results));
  });
}

void Viewer::OnFrame(
    const std::shared_ptr<const FrameBuffers>& frame,
    const std::shared_ptr<const gl::WatchSessionResponse>& /*update*/) {
  Post([frame](Viewer& self) {
    const auto found = self.subscriptions_.find(frame->session_id);
    if (found == self.subscriptions_.end()) return;
    Subscription& subscription = found->second;
    const auto now = steady_clock::now();
    const bool with_image =
        subscription.include_images && now >= subscription.next_image;
    if (with_image) subscription.next_image = now + subscription.image_interval;
    const std::uint64_t results = self.outbox_.results_left_out();
    const std::uint64_t images = self.outbox_.images_left_out();
    self.outbox_.AddFrame(frame, with_image);
    DashboardCounters& counters = self.core_->counters;
    counters.results_left_out += self.outbox_.results_left_out() - results;
    counters.images_left_out += self.outbox_.images_left_out() - images;
    self.WriteNext();
  });
}

void Viewer::OnFeedState(const pb::SubscriptionState& state) {
  pb::ServerMessage message;
  *message.mutable_subscription_state() = state;
  Send(Encode(message));
  if (state.state() != pb::SubscriptionState::STATE_ENDED) return;
  Post([session_id = state.session_id()](Viewer& self) {
    self.subscriptions_.erase(session_id);
    self.outbox_.Forget(session_id);
  });
}

}  // namespace groundlock::dashboard
