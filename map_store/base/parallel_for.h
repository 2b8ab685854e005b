// SPDX-License-Identifier: Apache-2.0
// Independent pieces of one computation on all cores.
#ifndef GROUNDLOCK_MAP_STORE_BASE_PARALLEL_FOR_H_
#define GROUNDLOCK_MAP_STORE_BASE_PARALLEL_FOR_H_

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace groundlock::base {

// Calls work(begin, end) for ranges that together are [0, count), on as many
// threads as there are cores, the caller's among them; returns when all are
// done. Which thread does which range is left open: `work` must not care. It
// must not throw.
template <typename Work>
void ParallelFor(std::size_t count, std::size_t range, const Work& work) {
  std::atomic<std::size_t> next = 0;
  const auto run = [&] {
    for (;;) {
      const std::size_t begin = next.fetch_add(range);
      if (begin >= count) return;
      work(begin, std::min(count, begin + range));
    }
  };
  const std::size_t ranges = (count + range - 1) / range;
  const std::size_t threads = std::min<std::size_t>(
      ranges, std::max(1U, std::thread::hardware_concurrency()));
  std::vector<std::jthread> helpers;
  for (std::size_t i = 1; i < threads; ++i) helpers.emplace_back(run);
  run();
}

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_PARALLEL_FOR_H_
