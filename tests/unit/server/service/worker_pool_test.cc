// SPDX-License-Identifier: Apache-2.0
#include "server/service/worker_pool.h"

#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <set>
#include <thread>
#include <vector>

#include "absl/synchronization/blocking_counter.h"
#include "absl/synchronization/notification.h"

namespace groundlock::service {
namespace {

// Many threads wake many strands; each strand counts without a lock of its own,
// so that a race, a lost wake-up or two steps at once would show.
TEST(WorkerPool, StepsOfAStrandRunOneAtATimeAndNoneIsLost) {
  constexpr int kStrands = 20;
  constexpr int kWakers = 4;
  constexpr int kWakesPerWaker = 500;
  struct Work {
    std::atomic<int> asked{0};
    int done = 0;  // by the strand alone
    std::atomic<bool> inside{false};
    std::shared_ptr<Strand> strand;
  };
  std::vector<Work> work(kStrands);
  {
    WorkerPool pool(3, kStrands);
    for (Work& w : work) {
      w.strand = Strand::Create(&pool, [&w] {
        EXPECT_FALSE(w.inside.exchange(true));
        ++w.done;
        w.inside = false;
        return w.done < w.asked.load();
      });
    }
    std::vector<std::thread> wakers;
    for (int i = 0; i < kWakers; ++i) {
      wakers.emplace_back([&work] {
        for (int k = 0; k < kWakesPerWaker; ++k) {
          for (Work& w : work) {
            ++w.asked;
            w.strand->Wake();
          }
        }
      });
    }
    for (std::thread& waker : wakers) waker.join();
  }  // the pool finishes what is scheduled
  for (const Work& w : work) {
    EXPECT_GE(w.done, kWakers * kWakesPerWaker);
  }
}

TEST(WorkerPool, ABlockedStrandDoesNotHoldUpOthers) {
  absl::Notification release;
  absl::Notification other_ran;
  WorkerPool pool(2, 2);
  const auto blocked = Strand::Create(&pool, [&release] {
    release.WaitForNotification();
    return false;
  });
  const auto other = Strand::Create(&pool, [&other_ran] {
    other_ran.Notify();
    return false;
  });
  blocked->Wake();
  other->Wake();
  EXPECT_TRUE(other_ran.WaitForNotificationWithTimeout(absl::Seconds(60)));
  release.Notify();
}

TEST(WorkerPool, StrandsTakeTurns) {
  // One worker, two strands with a hundred steps each: neither waits for all of
  // the other's.
  std::vector<int> order;
  absl::BlockingCounter over(2);
  absl::Notification start;
  {
    WorkerPool pool(1, 3);
    const auto gate = Strand::Create(&pool, [&start] {
      start.WaitForNotification();
      return false;
    });
    gate->Wake();  // until both are queued
    std::vector<std::shared_ptr<Strand>> strands;
    for (int i = 0; i < 2; ++i) {
      strands.push_back(Strand::Create(
          &pool, [&order, &over, i, steps = std::make_shared<int>(0)] {
            order.push_back(i);
            if (++*steps < 100) return true;
            over.DecrementCount();
            return false;
          }));
      strands.back()->Wake();
    }
    start.Notify();
    over.Wait();
  }
  ASSERT_EQ(order.size(), 200U);
  for (std::size_t k = 2; k < order.size(); ++k) {
    EXPECT_NE(order[k], order[k - 1]) << "step " << k;
  }
}

}  // namespace
}  // namespace groundlock::service
