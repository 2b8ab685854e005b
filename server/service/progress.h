// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_SERVER_SERVICE_PROGRESS_H_
#define GROUNDLOCK_SERVER_SERVICE_PROGRESS_H_

#include <cstddef>
#include <cstdint>

namespace groundlock::service {

// How far threads with a queue have come.
struct Progress {
  std::uint64_t done = 0;   // pieces of work finished since the start
  std::size_t waiting = 0;  // pieces that no thread has begun
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_PROGRESS_H_
