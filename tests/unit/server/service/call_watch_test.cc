// SPDX-License-Identifier: Apache-2.0
#include "server/service/call_watch.h"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <thread>
#include <vector>

namespace groundlock::service {
namespace {

using namespace std::chrono_literals;  // NOLINT(google-build-using-namespace)
using Clock = std::chrono::steady_clock;

TEST(ReadDeadline, ASilentClientIsGivenItsTimeAndNoMore) {
  ReadDeadline read(60s);
  EXPECT_FALSE(read.Expire(Clock::now() + 1h)) << "nothing is being read";
  read.Begin();
  EXPECT_FALSE(read.Expire(Clock::now() + 59s));
  EXPECT_TRUE(read.Expire(Clock::now() + 61s));
  EXPECT_FALSE(read.Expire(Clock::now() + 62s)) << "once";
  EXPECT_FALSE(read.End(100)) << "what comes later finds the call over";
}

TEST(ReadDeadline, AClientThatSendsABitNowAndThenRunsOutOfTime) {
  // Sends a hundred bytes every 50 ms, which is half the rate that counts.
  ReadDeadline trickle(200ms);
  bool expired = false;
  for (int i = 0; i < 100 && !expired; ++i) {
    trickle.Begin();
    std::this_thread::sleep_for(50ms);
    expired = trickle.Expire(Clock::now());
    if (!expired) trickle.End(100);
  }
  EXPECT_TRUE(expired);
  // One that sends well above it does not, however long it takes.
  ReadDeadline steady(200ms);
  for (int i = 0; i < 20; ++i) {
    steady.Begin();
    std::this_thread::sleep_for(20ms);
    ASSERT_TRUE(steady.End(100'000)) << i;
  }
  const auto before = Clock::now();
  steady.Begin();
  EXPECT_FALSE(steady.Expire(before + 150ms));
}

// Reads that end while they expire: one of the two has the call.
TEST(ReadDeadline, AClientThatSendsSteadilyHasItsTimeAndNoMore) {
  using std::chrono::hours;
  ReadDeadline deadline(hours(1), hours(12));
  deadline.Begin();
  const auto begin = std::chrono::steady_clock::now();
  EXPECT_FALSE(deadline.Expire(begin + std::chrono::minutes(30)));
  ASSERT_TRUE(deadline.End(1 << 20));
  EXPECT_FALSE(deadline.Expire(begin + hours(13))) << "nothing is being read";
  EXPECT_FALSE(deadline.IsOver(begin + hours(11)));
  EXPECT_TRUE(deadline.IsOver(begin + hours(13)));
  deadline.Begin();
  EXPECT_TRUE(deadline.Expire(begin + hours(13)));
  EXPECT_FALSE(deadline.End(1 << 20));
}

TEST(ReadDeadline, EitherTheReadOrTheDeadlineEndsACall) {
  for (int i = 0; i < 2'000; ++i) {
    ReadDeadline read(0ns);
    read.Begin();
    std::atomic<int> owners{0};
    std::thread watch([&] {
      if (read.Expire(Clock::now() + 1s)) ++owners;
    });
    if (read.End(0)) ++owners;
    watch.join();
    ASSERT_EQ(owners, 1);
  }
}

class Call final : public WatchedCall {
 public:
  void OnTick(Clock::time_point /*now*/) override {
    ++ticks;
    seen = true;
  }
  int ticks = 0;  // the watch's alone, until it is removed
  std::atomic<bool> seen{false};
};

TEST(CallWatch, ACallThatIsRemovedIsNotLookedAtAnyMore) {
  CallWatch watch(1us);
  std::vector<std::thread> clients;
  for (int c = 0; c < 2; ++c) {
    clients.emplace_back([&watch] {
      for (int i = 0; i < 200; ++i) {
        const auto call = std::make_unique<Call>();
        watch.Add(call.get());
        while (!call->seen) std::this_thread::yield();
        watch.Remove(call.get());
        EXPECT_GE(call->ticks, 1);
      }
    });
  }
  for (std::thread& client : clients) client.join();
}

}  // namespace
}  // namespace groundlock::service
