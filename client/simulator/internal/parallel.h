// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_PARALLEL_H_
#define GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_PARALLEL_H_

#include <atomic>
#include <thread>
#include <vector>

namespace groundlock::simulator {

// Calls work(i) once for every i in [0, count), on `threads` threads. Work
// items must be independent: then the result does not depend on the threads.
template <typename Work>
void ParallelFor(int count, int threads, const Work& work) {
  std::atomic<int> next{0};
  const auto run = [&] {
    for (int i = next++; i < count; i = next++) work(i);
  };
  std::vector<std::jthread> helpers;
  for (int i = 1; i < threads && i < count; ++i) helpers.emplace_back(run);
  run();
}

}  // namespace groundlock::simulator

#endif  // GROUNDLOCK_CLIENT_SIMULATOR_INTERNAL_PARALLEL_H_
