// SPDX-License-Identifier: Apache-2.0
#include "server/service/open_calls.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace groundlock::service {
namespace {

struct Counted {
  std::atomic<std::int64_t> open{0};
  std::atomic<std::uint64_t> refused{0};
};

TEST(OpenCalls, AnAddressHasItsLimitThroughAllItsConnections) {
  Counted counted;
  const OpenCalls calls({.max_calls = 100, .max_calls_per_address = 3},
                        &counted.open,
                        &counted.refused);
  std::vector<OpenCalls::Call> open;
  for (const char* peer : {"ipv4:192.0.2.1:1", "ipv4:192.0.2.1:2"}) {
    open.push_back(calls.Enter(peer).value());
  }
  open.push_back(calls.Enter("ipv4:192.0.2.1:1").value());
  EXPECT_EQ(calls.Enter("ipv4:192.0.2.1:3").status().code(),
            absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(counted.open, 3);
  EXPECT_EQ(counted.refused, 1U);
  EXPECT_TRUE(calls.Enter("ipv4:192.0.2.10:1").ok()) << "another address";
  open.pop_back();
  EXPECT_EQ(counted.open, 2);
  {
    const auto shared = calls.Enter("ipv4:192.0.2.1:4");
    ASSERT_TRUE(shared.ok());
    const OpenCalls::Call copy = *shared;
    EXPECT_EQ(counted.open, 3) << "counted once, however many have it";
    EXPECT_FALSE(calls.Enter("ipv4:192.0.2.1:4").ok());
  }
  EXPECT_TRUE(calls.Enter("ipv4:192.0.2.1:4").ok());
  open.clear();
  EXPECT_EQ(counted.open, 0);
}

TEST(OpenCalls, StrangersOfManyAddressesLeaveRoomToThoseWhoAreKnown) {
  Counted counted;
  const OpenCalls calls({.max_calls = 40, .max_calls_per_address = 3},
                        &counted.open,
                        &counted.refused);
  std::vector<OpenCalls::Call> open;
  for (const char* peer : {"ipv4:192.0.2.1:1",
                           "ipv4:192.0.2.1:1",
                           "ipv4:192.0.2.1:1",
                           "ipv4:192.0.2.2:1",
                           "ipv4:192.0.2.3:1"}) {
    open.push_back(calls.EnterUnknown(peer).value());
  }
  EXPECT_FALSE(calls.EnterUnknown("ipv4:192.0.2.4:1").ok());
  EXPECT_TRUE(calls.Enter("ipv4:192.0.2.4:1").ok());
  EXPECT_FALSE(calls.Enter("ipv4:192.0.2.1:1").ok()) << "of all kinds";
  open.pop_back();
  EXPECT_TRUE(calls.EnterUnknown("ipv4:192.0.2.4:1").ok());
}

TEST(OpenCalls, AllHaveALimitAndThoseNotToldApartOnlyThat) {
  Counted counted;
  const OpenCalls calls({.max_calls = 4, .max_calls_per_address = 1},
                        &counted.open,
                        &counted.refused);
  std::vector<OpenCalls::Call> open;
  for (const char* peer :
       {"unix:", "unix:", "ipv4:192.0.2.1:1", "ipv6:%5B2001:db8::1%5D:1"}) {
    open.push_back(calls.Enter(peer).value());
  }
  EXPECT_FALSE(calls.Enter("ipv4:192.0.2.2:1").ok());
  EXPECT_FALSE(calls.Enter("unix:").ok());
  open.erase(open.begin());
  EXPECT_TRUE(calls.Enter("ipv4:192.0.2.2:1").ok());
}

TEST(OpenCalls, WithoutALimitOfAnAddressThereIsTheTotal) {
  Counted counted;
  const OpenCalls calls({.max_calls = 50, .max_calls_per_address = 0},
                        &counted.open,
                        &counted.refused);
  std::vector<OpenCalls::Call> open;
  for (int i = 0; i < 50; ++i) {
    open.push_back(calls.Enter("ipv4:192.0.2.1:1").value());
  }
  EXPECT_FALSE(calls.Enter("ipv4:192.0.2.1:1").ok());
}

TEST(OpenCalls, NetworksAreAddressesOrThose64BitsWide) {
  EXPECT_EQ(NetworkOf("ipv4:192.0.2.1:40000"), "ipv4:192.0.2.1");
  const std::string one = NetworkOf("ipv6:%5B2001:db8:0:1::1%5D:40000");
  EXPECT_EQ(one, "ipv6:20010db800000001");
  EXPECT_EQ(NetworkOf("ipv6:[2001:db8:0:1:ffff::2]:1"), one);
  EXPECT_EQ(NetworkOf("ipv6:%5bfe80::1%25eth0%5d:1"), "ipv6:fe80000000000000");
  EXPECT_NE(NetworkOf("ipv6:%5B2001:db8:0:2::1%5D:40000"), one);
  EXPECT_EQ(NetworkOf("unix:/run/groundlock"), "");
  EXPECT_EQ(NetworkOf(""), "");
  // Not as gRPC writes them, and told apart all the same.
  EXPECT_EQ(NetworkOf("ipv6:nonsense:1"), "ipv6:nonsense");
}

TEST(OpenCalls, AConnectionIsToldOfHalfOfWhatItsAddressMayHave) {
  const auto told = [](int total, int per_address) {
    return CallLimits{total, per_address}.StreamsPerConnection();
  };
  EXPECT_EQ(CallLimits().StreamsPerConnection(), 1'000);
  EXPECT_EQ(told(8'000, 100), 50);
  EXPECT_EQ(told(10, 100), 5);
  EXPECT_EQ(told(10, 0), 5);
  EXPECT_EQ(told(1, 1), 1);
  EXPECT_EQ(told(1'000'000, 0), 1'000);
}

TEST(OpenCalls, CountsRightFromManyThreadsAndCallsMayOutliveIt) {
  Counted counted;
  std::vector<OpenCalls::Call> left(4);
  {
    const OpenCalls calls({.max_calls = 100, .max_calls_per_address = 1},
                          &counted.open,
                          &counted.refused);
    std::vector<std::thread> threads;
    for (std::size_t i = 0; i < left.size(); ++i) {
      threads.emplace_back([&, i] {
        const std::string own = "ipv4:192.0.2." + std::to_string(i) + ":1";
        for (int round = 0; round < 500; ++round) {
          EXPECT_TRUE(calls.Enter(own).ok());
        }
        left[i] = calls.Enter("ipv4:198.51.100.1:1").value_or(nullptr);
      });
    }
    for (std::thread& thread : threads) thread.join();
  }
  EXPECT_EQ(counted.refused, 3U) << "of four from one address";
  EXPECT_EQ(counted.open, 1);
  left.clear();
  EXPECT_EQ(counted.open, 0);
}

}  // namespace
}  // namespace groundlock::service
