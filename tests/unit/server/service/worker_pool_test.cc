// SPDX-License-Identifier: Apache-2.0
#include "server/service/worker_pool.h"

#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <set>
#include <thread>
#include <utility>
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
    WorkerPool pool(3);
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
  WorkerPool pool(2);
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
    WorkerPool pool(1);
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

// Sessions that come and go while all workers are in long frames: what they
// leave behind must neither fill the queue nor keep the workers from the rest.
TEST(WorkerPool, StrandsThatRetireLeaveTheQueueAtOnce) {
  constexpr int kShortLived = 10'000;
  absl::Notification release;
  absl::BlockingCounter busy(2);
  std::atomic<int> stray_steps{0};
  absl::Notification last_ran;
  WorkerPool pool(2);
  std::vector<std::shared_ptr<Strand>> blocked;
  for (int i = 0; i < 2; ++i) {
    blocked.push_back(
        Strand::Create(&pool, [&release, &busy, first = true]() mutable {
          if (std::exchange(first, false)) busy.DecrementCount();
          release.WaitForNotification();
          return false;
        }));
    blocked.back()->Wake();
  }
  busy.Wait();
  std::vector<std::thread> clients;
  for (int c = 0; c < 2; ++c) {
    clients.emplace_back([&] {
      for (int i = 0; i < kShortLived; ++i) {
        const auto strand = Strand::Create(&pool, [&stray_steps] {
          ++stray_steps;
          return false;
        });
        strand->Wake();
        const std::weak_ptr<Strand> left = strand;
        strand->Retire();
        strand->Wake();  // has no effect any more
        EXPECT_EQ(left.use_count(), 1) << "the queue still holds it";
      }
    });
  }
  for (std::thread& client : clients) client.join();
  EXPECT_EQ(pool.progress().waiting, 0U);
  const auto last = Strand::Create(&pool, [&last_ran] {
    last_ran.Notify();
    return false;
  });
  last->Wake();
  EXPECT_EQ(pool.progress().waiting, 1U);
  release.Notify();
  EXPECT_TRUE(last_ran.WaitForNotificationWithTimeout(absl::Seconds(60)));
  EXPECT_EQ(stray_steps, 0);
}

TEST(WorkerPool, AStrandRetiredInItsStepIsNotRunAgain) {
  std::atomic<int> steps{0};
  absl::Notification retired;
  absl::Notification started;
  {
    WorkerPool pool(1);
    const auto strand = Strand::Create(&pool, [&] {
      if (++steps == 1) started.Notify();
      retired.WaitForNotification();
      return true;
    });
    strand->Wake();
    started.WaitForNotification();
    strand->Wake();
    strand->Retire();
    retired.Notify();
  }
  EXPECT_EQ(steps, 1);
}

// Retiring against waking against running: no step begins after Retire has
// returned unless one was running already, and nothing is lost or freed twice.
TEST(WorkerPool, StrandsRetireWhileTheyAreWokenAndRun) {
  WorkerPool pool(2);
  for (int round = 0; round < 300; ++round) {
    std::atomic<bool> retired{false};
    std::atomic<int> late{0};
    const auto strand = Strand::Create(&pool, [&retired, &late] {
      if (retired) ++late;
      return true;
    });
    std::thread waker([&strand] {
      for (int i = 0; i < 5; ++i) strand->Wake();
    });
    strand->Wake();
    strand->Retire();
    retired = true;
    waker.join();
    // A step that was running ends before these variables go.
    while (strand.use_count() > 1) std::this_thread::yield();
    EXPECT_LE(late, 1);
  }
}

}  // namespace
}  // namespace groundlock::service
