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

bool Outbox::AddReply(Buffer message) {
  if (replies_.size() >= static_cast<std::size_t>(max_replies_)) return false;
  replies_.push_back(std::move(message));
  return true;
}

void Outbox::AddFrame(const std::shared_ptr<const FrameBuffers>& frame,
                      bool with_image) {
  Result result{frame, 0};
  if (results_.size() >= static_cast<std::size_t>(max_results_)) {
    // The oldest goes; the next one of its session tells.
    const Result oldest = std::move(results_.front());
    results_.pop_front();
    ++results_left_out_;
    const auto heir =
        std::find_if(results_.begin(), results_.end(), [&](const Result& r) {
          return r.frame->session_id == oldest.frame->session_id;
        });
    const std::uint64_t left_out =
        oldest.left_out + 1 + oldest.frame->update->frame_update().skipped();
    if (heir != results_.end()) {
      heir->left_out += left_out;
    } else if (oldest.frame->session_id == frame->session_id) {
      result.left_out += left_out;
    }
  }
  results_.push_back(std::move(result));
  if (!with_image || frame->image_bytes == nullptr) return;
  Buffer& image = images_[frame->session_id];
  if (image != nullptr) ++images_left_out_;
  image = frame->image_bytes;
}

bool Outbox::AddParts(std::vector<Buffer> parts) {
  if (parts_.size() >= kMaxPartLists) return false;
  if (!parts.empty()) parts_.push_back(std::move(parts));
  return true;
}

void Outbox::Forget(const std::string& session_id) {
  images_.erase(session_id);
  std::erase_if(results_, [&](const Result& result) {
    return result.frame->session_id == session_id;
  });
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
    if (result.left_out == 0) return result.frame->update_bytes;
    pb::ServerMessage message = *result.frame->update;
    message.mutable_frame_update()->set_skipped(
        message.frame_update().skipped() + result.left_out);
    return Encode(message);
  }
  if (!images_.empty() && (part_was_last_ || parts_.empty())) {
    part_was_last_ = false;
    auto image = images_.upper_bound(last_image_session_);
    if (image == images_.end()) image = images_.begin();
    last_image_session_ = image->first;
    Buffer bytes = std::move(image->second);
    images_.erase(image);
    return bytes;
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
