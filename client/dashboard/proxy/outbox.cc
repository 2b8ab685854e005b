// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/outbox.h"

#include <algorithm>
#include <utility>

namespace groundlock::dashboard {
namespace {

// Histories and point clouds that may wait at a time.
constexpr std::size_t kMaxPartLists = 16;

}  // namespace

Buffer Encode(const pb::ServerMessage& message) {
  return std::make_shared<const std::string>(message.SerializeAsString());
}

Buffer EndOfLogin(const std::string& why) {
  pb::ServerMessage message;
  pb::ServerState& state = *message.mutable_server_state();
  state.set_state(pb::ServerState::STATE_UNAUTHENTICATED);
  state.set_message(why);
  return Encode(message);
}

bool Outbox::AddReply(Buffer message) {
  if (replies_.size() >= static_cast<std::size_t>(max_replies_)) return false;
  replies_.push_back(std::move(message));
  return true;
}

void Outbox::AddFrame(const std::shared_ptr<const FrameBuffers>& frame,
                      bool with_image) {
  Result result{frame->session_id, frame->update, frame->update_bytes, 0};
  if (results_.size() >= static_cast<std::size_t>(max_results_)) {
    // The oldest goes; the next one of its session tells.
    const Result oldest = std::move(results_.front());
    results_.pop_front();
    ++results_left_out_;
    const auto heir =
        std::find_if(results_.begin(), results_.end(), [&](const Result& r) {
          return r.session_id == oldest.session_id;
        });
    const std::uint64_t left_out =
        oldest.left_out + 1 + oldest.update->frame_update().skipped();
    if (heir != results_.end()) {
      heir->left_out += left_out;
    } else if (oldest.session_id == frame->session_id) {
      result.left_out += left_out;
    }
  }
  results_.push_back(std::move(result));
  if (!with_image || frame->image_bytes == nullptr) return;
  Images& images = images_[frame->session_id];
  if (images.newest != nullptr) ++images_left_out_;
  images.newest = frame->image_bytes;
  images.sequence = frame->sequence;
}

bool Outbox::AddParts(std::vector<Buffer> parts) {
  if (parts_.size() >= kMaxPartLists) return false;
  if (!parts.empty()) parts_.push_back(std::move(parts));
  return true;
}

void Outbox::SetImageWindow(const std::string& session_id,
                            std::uint32_t images) {
  images_[session_id].window = images;
}

bool Outbox::ImageTaken(const std::string& session_id, std::uint64_t sequence) {
  const auto images = images_.find(session_id);
  if (images == images_.end()) return false;
  // Numbers may start anew: what counts is the order of sending.
  std::deque<std::uint64_t>& sent = images->second.in_flight;
  const auto taken = std::find(sent.begin(), sent.end(), sequence);
  if (taken == sent.end()) return false;
  sent.erase(sent.begin(), taken + 1);
  return true;
}

void Outbox::Forget(const std::string& session_id) {
  images_.erase(session_id);
  std::erase_if(results_, [&](const Result& result) {
    return result.session_id == session_id;
  });
}

Outbox::ImagesBySession::iterator Outbox::NextImages() {
  const auto ready = [](const auto& entry) { return entry.second.Ready(); };
  const auto after = images_.upper_bound(last_image_session_);
  const auto next = std::find_if(after, images_.end(), ready);
  if (next != images_.end()) return next;
  const auto again = std::find_if(images_.begin(), after, ready);
  return again == after ? images_.end() : again;
}

Buffer Outbox::Next() {
  if (!replies_.empty()) {
    Buffer reply = std::move(replies_.front());
    replies_.pop_front();
    return reply;
  }
  if (!results_.empty()) {
    const Result result = std::move(results_.front());
    results_.pop_front();
    if (result.left_out == 0) return result.update_bytes;
    pb::ServerMessage message = *result.update;
    message.mutable_frame_update()->set_skipped(
        message.frame_update().skipped() + result.left_out);
    return Encode(message);
  }
  const auto images = NextImages();
  if (images != images_.end() && (part_was_last_ || parts_.empty())) {
    part_was_last_ = false;
    last_image_session_ = images->first;
    Images& sent = images->second;
    if (sent.window > 0) sent.in_flight.push_back(sent.sequence);
    return std::exchange(sent.newest, nullptr);
  }
  if (!parts_.empty()) {
    part_was_last_ = true;
    Buffer part = std::move(parts_.front()[next_part_++]);
    if (next_part_ == parts_.front().size()) {
      parts_.pop_front();
      next_part_ = 0;
    }
    return part;
  }
  return nullptr;
}

}  // namespace groundlock::dashboard
