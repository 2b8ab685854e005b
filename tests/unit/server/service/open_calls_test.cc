// SPDX-License-Identifier: Apache-2.0
#include "server/service/open_calls.h"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

namespace groundlock::service {
namespace {

TEST(OpenCalls, TwiceWhatAClientIsToldAndNoMore) {
  std::vector<std::string> ended;
  const OpenCalls calls(
      2, [&](const std::string& peer) { ended.push_back(peer); });
  std::vector<OpenCalls::Call> open;
  for (int i = 0; i < 4; ++i) open.push_back(calls.Enter("ipv4:a:1").value());
  EXPECT_EQ(calls.Enter("ipv4:a:1").status().code(),
            absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(ended, std::vector<std::string>{"ipv4:a:1"});
  EXPECT_TRUE(calls.Enter("ipv4:a:2").ok()) << "another connection";
  open.pop_back();
  EXPECT_TRUE(calls.Enter("ipv4:a:1").ok());
  EXPECT_TRUE(calls.Enter("ipv4:a:1").ok()) << "the last one is over";
  for (int i = 0; i < 100; ++i) {
    open.push_back(calls.Enter("unix:").value());
  }
}

TEST(OpenCalls, CountsRightFromManyThreadsAndOutlivesNobody) {
  std::atomic<int> ended{0};
  std::vector<OpenCalls::Call> left(4);
  {
    const OpenCalls calls(1, [&](const std::string&) { ++ended; });
    std::vector<std::thread> threads;
    for (std::size_t i = 0; i < 4; ++i) {
      threads.emplace_back([&, i] {
        for (int round = 0; round < 500; ++round) {
          auto call = calls.Enter(i % 2 == 0 ? "ipv4:a:1" : "ipv4:a:2");
          ASSERT_TRUE(call.ok());
          left[i] = *std::move(call);
          left[i] = nullptr;
        }
        left[i] = calls.Enter("ipv4:b:1").value_or(nullptr);
      });
    }
    for (std::thread& thread : threads) thread.join();
  }
  EXPECT_EQ(ended, 2) << "of four at one connection";
}

}  // namespace
}  // namespace groundlock::service
