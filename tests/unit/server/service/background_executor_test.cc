// SPDX-License-Identifier: Apache-2.0
#include "server/service/background_executor.h"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <new>
#include <stdexcept>
#include <thread>

namespace groundlock::service {
namespace {

// An anchor that finds no memory ends alone: neither the program nor the thread
// goes with it, and whoever waits for what it held is released.
TEST(BackgroundExecutor, ATaskThatThrowsHarmsNoOther) {
  auto held = std::make_shared<int>(1);
  const std::weak_ptr<int> left = held;
  std::atomic<int> done{0};
  {
    BackgroundExecutor executor("gl-test", 1, 8);
    executor.Post([held = std::move(held)]() { throw std::bad_alloc(); });
    executor.Post([] { throw 1; });
    executor.Post([] { throw std::runtime_error("from a library"); });
    executor.Post([&done, &left] {
      EXPECT_TRUE(left.expired());
      ++done;
    });
    while (executor.progress().done < 4) std::this_thread::yield();
    EXPECT_EQ(executor.progress().waiting, 0U);
  }
  EXPECT_EQ(done, 1);
}

TEST(BackgroundExecutor, NewWorkIsRefusedWhenTooMuchWaits) {
  std::atomic<bool> go{false};
  BackgroundExecutor executor("gl-test", 1, 2);
  executor.Post([&go] {
    while (!go) std::this_thread::yield();
  });
  while (executor.progress().waiting > 0) std::this_thread::yield();
  EXPECT_TRUE(executor.TryPost([] {}).ok());
  EXPECT_TRUE(executor.TryPost([] {}).ok());
  EXPECT_TRUE(absl::IsResourceExhausted(executor.TryPost([] {})));
  EXPECT_EQ(executor.progress().waiting, 2U);
  executor.Post([] {});
  go = true;
}

}  // namespace
}  // namespace groundlock::service
