// SPDX-License-Identifier: Apache-2.0
#include "client/cli/interrupt.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <future>

namespace groundlock::cli {
namespace {

// Generous: only a broken implementation waits this long.
constexpr auto kPatience = std::chrono::seconds(60);

TEST(Interrupt, TurnsASignalIntoAFlagAndACall) {
  Interrupt interrupt;
  EXPECT_FALSE(interrupt.interrupted());
  std::promise<void> called;
  interrupt.OnInterrupt([&] { called.set_value(); });
  kill(getpid(), SIGINT);
  ASSERT_EQ(called.get_future().wait_for(kPatience), std::future_status::ready);
  EXPECT_TRUE(interrupt.interrupted());
  // Whoever registers late learns of it at once.
  bool late = false;
  interrupt.OnInterrupt([&] { late = true; });
  EXPECT_TRUE(late);
}

TEST(InterruptDeathTest, ASecondSignalEndsTheProgram) {
  ::testing::FLAGS_gtest_death_test_style = "threadsafe";
  EXPECT_EXIT(
      {
        Interrupt interrupt;
        kill(getpid(), SIGINT);
        while (!interrupt.interrupted()) usleep(1000);
        kill(getpid(), SIGINT);
        sleep(60);
      },
      ::testing::ExitedWithCode(130),
      "");
}

}  // namespace
}  // namespace groundlock::cli
