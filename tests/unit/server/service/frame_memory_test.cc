// SPDX-License-Identifier: Apache-2.0
#include "server/service/frame_memory.h"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

namespace groundlock::service {
namespace {

TEST(FrameMemory, EachSessionHasItsShareWhateverOthersTake) {
  const auto memory = FrameMemory::Create(/*bytes=*/800, /*max_sessions=*/4);
  const auto greedy = memory->NewShare();
  std::vector<FrameMemory::Held> held;
  // Its own 100, and all that is common.
  for (int i = 0; i < 10; ++i) {
    held.push_back(greedy->Take(50));
    ASSERT_NE(held.back(), nullptr) << i;
  }
  EXPECT_EQ(greedy->Take(1), nullptr);
  EXPECT_TRUE(greedy->IsScarce());
  const auto modest = memory->NewShare();
  EXPECT_EQ(modest->Take(101), nullptr);
  const auto frame = modest->Take(100);
  EXPECT_NE(frame, nullptr);
  EXPECT_EQ(modest->Take(1), nullptr);
  // What is given back is there again.
  held.pop_back();
  EXPECT_NE(modest->Take(50), nullptr);
  held.clear();
  EXPECT_FALSE(greedy->IsScarce());
  EXPECT_NE(greedy->Take(400), nullptr);
}

TEST(FrameMemory, WhatIsHeldMayOutliveItsSessionAndTheServer) {
  auto memory = FrameMemory::Create(800, 4);
  auto share = memory->NewShare();
  auto own = share->Take(100);
  auto common = share->Take(100);
  share = nullptr;
  memory = nullptr;
  own = nullptr;
  common = nullptr;
}

TEST(FrameMemory, NoThreadTakesMoreThanThereIs) {
  const auto memory = FrameMemory::Create(2'000, 1'000);
  std::atomic<int> taken{0};
  std::atomic<int> most{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      for (int i = 0; i < 5'000; ++i) {
        const auto held = memory->TakeCommon(400);
        if (held == nullptr) continue;
        const int now = ++taken;
        for (int before = most; before < now;) {
          if (most.compare_exchange_weak(before, now)) break;
        }
        --taken;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_GE(most, 1);
  EXPECT_LE(most, 2);
  EXPECT_NE(memory->TakeCommon(1'000), nullptr) << "all has been given back";
}

}  // namespace
}  // namespace groundlock::service
