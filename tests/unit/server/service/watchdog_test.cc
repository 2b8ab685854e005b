// SPDX-License-Identifier: Apache-2.0
#include "server/service/watchdog.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <string>
#include <thread>

#include "map_store/base/mutex.h"
#include "server/service/background_executor.h"

namespace groundlock::service {
namespace {

using namespace std::chrono_literals;  // NOLINT(google-build-using-namespace)
using ::testing::HasSubstr;
using ::testing::Not;

// The reports, as they come.
class Reports {
 public:
  void Add(const std::string& standing) {
    base::MutexLock lock(&mutex_);
    reports_.push_back(standing);
  }
  std::string Await(std::size_t number) {
    base::MutexLock lock(&mutex_);
    mutex_.AwaitFor(60s, [&] { return reports_.size() >= number; });
    return reports_.size() >= number ? reports_[number - 1] : "no report";
  }
  std::size_t size() {
    base::MutexLock lock(&mutex_);
    return reports_.size();
  }

 private:
  base::Mutex mutex_;
  std::vector<std::string> reports_;
};

TEST(Watchdog, SaysWhatStandsStillAndWhenItGoesOn) {
  Reports reports;
  std::atomic<bool> go{false};
  std::atomic<bool> begun{false};
  BackgroundExecutor stuck("gl-stuck", 1, 8);
  BackgroundExecutor idle("gl-idle", 1, 8);
  stuck.Post([&] {
    begun = true;
    while (!go) std::this_thread::sleep_for(1ms);
  });
  while (!begun) std::this_thread::sleep_for(1ms);
  const Watchdog watchdog(
      {{"stuck", [&] { return stuck.progress(); }, 50ms},
       {"idle", [&] { return idle.progress(); }, 50ms}},
      [&](const std::string& standing) { reports.Add(standing); });
  // Long work alone is no standstill: nothing waits for it.
  std::this_thread::sleep_for(300ms);
  EXPECT_EQ(reports.size(), 0U);
  stuck.Post([] {});
  EXPECT_THAT(reports.Await(1), HasSubstr("stuck: nothing finished"));
  EXPECT_THAT(reports.Await(1), Not(HasSubstr("idle")));
  go = true;
  EXPECT_EQ(reports.Await(2), "");
}

TEST(Watchdog, SlowProgressIsProgress) {
  Reports reports;
  BackgroundExecutor slow("gl-slow", 1, 100);
  const Watchdog watchdog(
      {{"slow", [&] { return slow.progress(); }, 2s}},
      [&](const std::string& standing) { reports.Add(standing); });
  for (int i = 0; i < 60; ++i) {
    slow.Post([] { std::this_thread::sleep_for(50ms); });
  }
  while (slow.progress().waiting > 0) std::this_thread::sleep_for(10ms);
  EXPECT_EQ(reports.size(), 0U);
}

}  // namespace
}  // namespace groundlock::service
