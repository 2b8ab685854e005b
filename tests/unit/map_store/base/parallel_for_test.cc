// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/parallel_for.h"

#include <gtest/gtest.h>

#include <atomic>
#include <vector>

namespace groundlock::base {
namespace {

TEST(ParallelFor, DoesEverythingOnce) {
  for (const std::size_t count : {0U, 1U, 7U, 64U, 1'000U}) {
    for (const std::size_t range : {1U, 8U, 5'000U}) {
      std::vector<std::atomic<int>> done(count);
      ParallelFor(count, range, [&](std::size_t begin, std::size_t end) {
        EXPECT_LT(begin, end);
        EXPECT_LE(end - begin, range);
        for (std::size_t i = begin; i < end; ++i) ++done[i];
      });
      for (const std::atomic<int>& times : done) EXPECT_EQ(times, 1);
    }
  }
}

}  // namespace
}  // namespace groundlock::base
