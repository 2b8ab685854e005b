// SPDX-License-Identifier: Apache-2.0
// What the images of all sessions may take together while they are here: on
// their way into a session, waiting in it, in work, or shown to watchers.
#ifndef GROUNDLOCK_SERVER_SERVICE_FRAME_MEMORY_H_
#define GROUNDLOCK_SERVER_SERVICE_FRAME_MEMORY_H_

#include <atomic>
#include <cstdint>
#include <memory>
#include <utility>

namespace groundlock::service {

// Half of the memory is divided among the sessions: each has its share whatever
// the others do. The other half is for those who need more than that, as long
// as there is some. Thread-safe; nobody waits.
class FrameMemory : public std::enable_shared_from_this<FrameMemory> {
 public:
  // Memory that is taken for as long as somebody has it; null = there was none.
  using Held = std::shared_ptr<void>;

  // Of one session.
  class Share : public std::enable_shared_from_this<Share> {
   public:
    explicit Share(std::shared_ptr<FrameMemory> memory)
        : memory_(std::move(memory)) {}
    Held Take(std::int64_t bytes);
    // Whether others need what this session does without: more than half of the
    // common memory is taken.
    bool IsScarce() const;

   private:
    const std::shared_ptr<FrameMemory> memory_;
    std::atomic<std::int64_t> taken_{0};
  };

  static std::shared_ptr<FrameMemory> Create(std::int64_t bytes,
                                             int max_sessions);
  std::shared_ptr<Share> NewShare();
  // Of the common half, for what is no session's.
  Held TakeCommon(std::int64_t bytes);

 private:
  FrameMemory(std::int64_t bytes, int max_sessions);

  const std::int64_t common_limit_;
  const std::int64_t share_limit_;
  std::atomic<std::int64_t> common_taken_{0};
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_FRAME_MEMORY_H_
