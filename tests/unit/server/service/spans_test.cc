// SPDX-License-Identifier: Apache-2.0
#include "server/service/spans.h"

#include <gmock/gmock.h>

#include <set>
#include <string>
#include <thread>
#include <vector>

namespace groundlock::service {
namespace {

using namespace std::chrono_literals;

Span Named(const std::string& name) {
  Span span;
  span.name = name;
  span.context = SpanQueue::NewContext();
  return span;
}

TEST(TraceParent, IsReadAsW3cHasItAndNotOtherwise) {
  const std::string good =
      "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";
  const auto context = ParseTraceParent(good);
  ASSERT_TRUE(context.has_value());
  EXPECT_EQ(context->trace_high, 0x0af7651916cd43ddU);
  EXPECT_EQ(context->trace_low, 0x8448eb211c80319cU);
  EXPECT_EQ(context->span, 0xb7ad6b7169203331U);
  // One digit, dash or sign at a time that is not as it must be.
  for (std::size_t i = 0; i < good.size(); ++i) {
    std::string bad = good;
    bad[i] = 'X';
    EXPECT_FALSE(ParseTraceParent(bad).has_value()) << bad;
  }
  EXPECT_FALSE(ParseTraceParent("").has_value());
  EXPECT_FALSE(ParseTraceParent(good + "-").has_value());
  EXPECT_FALSE(ParseTraceParent(good.substr(1)).has_value());
  EXPECT_FALSE(ParseTraceParent("00-00000000000000000000000000000000-"
                                "b7ad6b7169203331-01")
                   .has_value());
  EXPECT_FALSE(ParseTraceParent("00-0af7651916cd43dd8448eb211c80319c-"
                                "0000000000000000-01")
                   .has_value());
}

TEST(SpanQueue, TakesAsManyFramesAsItIsTold) {
  const SpanContext session = SpanQueue::NewContext();
  constexpr int kFrames = 10'000;
  const auto share = [&](double asked) {
    const SpanQueue queue(asked, 1);
    int wanted = 0;
    for (std::uint64_t i = 0; i < kFrames; ++i) {
      const bool wants = queue.WantsFrame(session, i);
      EXPECT_EQ(wants, queue.WantsFrame(session, i));
      wanted += wants ? 1 : 0;
    }
    return static_cast<double>(wanted) / kFrames;
  };
  EXPECT_EQ(share(0.0), 0.0);
  EXPECT_EQ(share(1.0), 1.0);
  // Five standard deviations of a binomial: 0.022.
  EXPECT_NEAR(share(0.25), 0.25, 0.022);
}

TEST(SpanQueue, DropsAndCountsBeyondItsBoundAndNeverWaits) {
  SpanQueue queue(1.0, 4);
  for (int i = 0; i < 10; ++i) queue.Add(Named(std::to_string(i)));
  EXPECT_EQ(queue.num_dropped(), 6U);
  const std::vector<Span> taken = queue.Take(3, 60s);
  ASSERT_EQ(taken.size(), 3U);
  EXPECT_EQ(taken.front().name, "0");
  queue.Add(Named("again"));
  EXPECT_EQ(queue.num_dropped(), 6U);
  queue.Close();
  queue.Add(Named("late"));
  EXPECT_EQ(queue.num_dropped(), 7U);
  EXPECT_EQ(queue.Take(10, 60s).size(), 2U) << "what waits is not lost";
  EXPECT_TRUE(queue.Take(10, 60s).empty());
}

TEST(SpanQueue, LosesNothingUncountedBetweenThreads) {
  constexpr std::size_t kThreads = 4;
  constexpr std::size_t kEach = 2'000;
  SpanQueue queue(1.0, 64);
  std::set<std::uint64_t> ids;
  std::thread taker([&] {
    for (;;) {
      const bool last = queue.closed();
      const auto spans = queue.Take(16, 1s);
      for (const Span& span : spans) ids.insert(span.context.span);
      if (spans.empty() && last) return;
    }
  });
  std::vector<std::thread> threads;
  for (std::size_t t = 0; t < kThreads; ++t) {
    threads.emplace_back([&queue] {
      for (std::size_t i = 0; i < kEach; ++i) queue.Add(Named("frame"));
    });
  }
  for (std::thread& thread : threads) thread.join();
  queue.Close();
  taker.join();
  EXPECT_EQ(ids.size() + queue.num_dropped(), kThreads * kEach);
  EXPECT_GE(ids.size(), 64U);
}

TEST(CallSpan, EndsOnceAndWithoutAnAnswerAsCancelled) {
  SpanQueue queue(0.0, 8);
  const SpanContext parent{1, 2, 3};
  {
    CallSpan span(&queue, "GetMap", parent);
    span.End(absl::NotFoundError("none"),
             {{"kept", std::string("x")}, {"empty", std::string()}});
    span.End(absl::OkStatus(), {});
  }
  { const CallSpan gone(&queue, "Track", {}); }
  { const CallSpan unwanted(nullptr, "Track", {}); }
  const auto spans = queue.Take(2, 60s);
  ASSERT_EQ(spans.size(), 2U);
  EXPECT_EQ(spans[0].context.trace_high, 1U);
  EXPECT_EQ(spans[0].context.trace_low, 2U);
  EXPECT_EQ(spans[0].parent, 3U);
  EXPECT_TRUE(absl::IsNotFound(spans[0].status));
  EXPECT_EQ(spans[0].attributes.size(), 1U);
  EXPECT_GE(spans[0].end, spans[0].start);
  EXPECT_TRUE(absl::IsCancelled(spans[1].status));
  EXPECT_EQ(spans[1].parent, 0U);
  EXPECT_TRUE(spans[1].context.valid());
  queue.Close();
  EXPECT_TRUE(queue.Take(1, 60s).empty());
}

}  // namespace
}  // namespace groundlock::service
