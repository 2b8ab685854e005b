// SPDX-License-Identifier: Apache-2.0
#include "server/service/frame_memory.h"

#include <algorithm>

namespace groundlock::service {
namespace {

bool TakeFrom(std::atomic<std::int64_t>& taken,
              std::int64_t limit,
              std::int64_t bytes) {
  if (taken.fetch_add(bytes) + bytes <= limit) return true;
  taken -= bytes;
  return false;
}

}  // namespace

FrameMemory::FrameMemory(std::int64_t bytes, int max_sessions)
    : common_limit_(bytes / 2),
      share_limit_(bytes / 2 / std::max(1, max_sessions)) {}

std::shared_ptr<FrameMemory> FrameMemory::Create(std::int64_t bytes,
                                                 int max_sessions) {
  return std::shared_ptr<FrameMemory>(new FrameMemory(bytes, max_sessions));
}

std::shared_ptr<FrameMemory::Share> FrameMemory::NewShare() {
  return std::make_shared<Share>(shared_from_this());
}

FrameMemory::Held FrameMemory::TakeCommon(std::int64_t bytes) {
  if (!TakeFrom(common_taken_, common_limit_, bytes)) return nullptr;
  return Held(this, [self = shared_from_this(), bytes](void* /*memory*/) {
    self->common_taken_ -= bytes;
  });
}

FrameMemory::Held FrameMemory::Share::Take(std::int64_t bytes) {
  if (!TakeFrom(taken_, memory_->share_limit_, bytes)) {
    return memory_->TakeCommon(bytes);
  }
  return Held(this, [self = shared_from_this(), bytes](void* /*share*/) {
    self->taken_ -= bytes;
  });
}

bool FrameMemory::Share::IsScarce() const {
  return memory_->common_taken_ > memory_->common_limit_ / 2;
}

}  // namespace groundlock::service
