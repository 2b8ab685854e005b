// SPDX-License-Identifier: Apache-2.0
#include "server/service/listener.h"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <functional>
#include <list>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "map_store/base/file.h"
#include "tests/integration/raw_connection.h"

namespace groundlock::service {
namespace {

using test::RawConnection;
using ::testing::HasSubstr;

// A sanitizer, or a busy machine, is given a minute.
bool Eventually(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(1);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

// What is given the connections, and ends them as gRPC does.
class Taker {
 public:
  ~Taker() {
    while (EndOne()) {
    }
  }
  Listener::Take take() {
    return [this](int fd, int /*listening_fd*/) {
      const std::lock_guard lock(mutex_);
      fds_.push_back(fd);
    };
  }
  bool EndOne() {
    const std::lock_guard lock(mutex_);
    if (fds_.empty()) return false;
    shutdown(fds_.front(), SHUT_RDWR);
    close(fds_.front());
    fds_.pop_front();
    return true;
  }
  std::size_t size() const {
    const std::lock_guard lock(mutex_);
    return fds_.size();
  }

 private:
  mutable std::mutex mutex_;
  std::list<int> fds_;
};

ConnectionLimits Limits(int total, int per_address) {
  ConnectionLimits limits;
  limits.max_connections = total;
  limits.max_per_address = per_address;
  return limits;
}

TEST(Listener, TakesNoMoreOfAnAddressThanItMay) {
  Metrics metrics;
  Taker taker;
  const auto listener =
      Listener::Open("127.0.0.1:0", Limits(100, 2), &metrics).value();
  listener->Start(taker.take());
  const RawConnection first(listener->port());
  RawConnection second(listener->port());
  ASSERT_TRUE(Eventually([&] { return metrics.connections == 2; }));
  const RawConnection third(listener->port());
  EXPECT_TRUE(third.IsEnded());
  EXPECT_EQ(metrics.connections_refused_address, 1U);
  EXPECT_EQ(metrics.connections, 2);
  // Of another address.
  const RawConnection elsewhere(listener->port(), "127.0.0.2");
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 3; }));
  // One that its client breaks off makes room, once whoever has it noticed.
  second.Reset();
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 2; }));
  const RawConnection fourth(listener->port());
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 3; }));
  // One that the server ends.
  ASSERT_TRUE(taker.EndOne());
  EXPECT_TRUE(first.IsEnded());
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 2; }));
  EXPECT_EQ(metrics.connections_taken, 4U);
  EXPECT_EQ(metrics.connections_refused_address, 1U);
  EXPECT_EQ(metrics.connections_refused_total, 0U);
}

TEST(Listener, TakesNoMoreThanItMayAtAll) {
  Metrics metrics;
  Taker taker;
  auto listener = Listener::Open("127.0.0.1:0", Limits(3, 0), &metrics).value();
  listener->Start(taker.take());
  std::list<RawConnection> clients;
  for (int i = 0; i < 3; ++i) clients.emplace_back(listener->port());
  ASSERT_TRUE(Eventually([&] { return metrics.connections == 3; }));
  EXPECT_TRUE(RawConnection(listener->port(), "127.0.0.2").IsEnded());
  EXPECT_TRUE(RawConnection(listener->port(), "127.0.0.3").IsEnded());
  EXPECT_EQ(metrics.connections_refused_total, 2U);
  ASSERT_TRUE(taker.EndOne());
  ASSERT_TRUE(Eventually([&] { return metrics.connections == 2; }));
  const RawConnection next(listener->port(), "127.0.0.2");
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 3; }));
  listener = nullptr;
  EXPECT_EQ(metrics.connections, 0) << "those that were still open";
}

TEST(Listener, TakesNothingAfterStop) {
  Metrics metrics;
  Taker taker;
  const auto listener =
      Listener::Open("127.0.0.1:0", Limits(9, 0), &metrics).value();
  listener->Start(taker.take());
  const RawConnection first(listener->port());
  ASSERT_TRUE(Eventually([&] { return metrics.connections == 1; }));
  listener->Stop();
  listener->Stop();
  EXPECT_FALSE(RawConnection(listener->port()).is_connected());
  EXPECT_EQ(metrics.connections, 1) << "it is open, and counted";
  ASSERT_TRUE(taker.EndOne());
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 0; }));
}

TEST(Listener, CountsRightWhileManyComeAndGo) {
  Metrics metrics;
  Taker taker;
  auto listener = Listener::Open("127.0.0.1:0", Limits(8, 6), &metrics).value();
  listener->Start(taker.take());
  std::atomic<bool> done{false};
  std::atomic<bool> too_many{false};
  std::thread ends([&] {
    while (!done) {
      taker.EndOne();
      if (metrics.connections > 8) too_many = true;
    }
  });
  std::vector<std::thread> clients;
  for (int i = 0; i < 4; ++i) {
    clients.emplace_back([&, i] {
      const std::string from = "127.0.0." + std::to_string(1 + i % 2);
      for (int round = 0; round < 200; ++round) {
        RawConnection client(listener->port(), from.c_str());
        if (round % 3 == 0) client.Reset();
      }
    });
  }
  for (std::thread& thread : clients) thread.join();
  EXPECT_TRUE(Eventually([&] {
    return metrics.connections_taken + metrics.connections_refused_total +
               metrics.connections_refused_address ==
           800;
  }));
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 0; }));
  done = true;
  ends.join();
  EXPECT_FALSE(too_many);
  std::thread stops([&] { listener->Stop(); });
  listener->Stop();
  stops.join();
}

// No descriptor is left for a while: what comes waits, or is refused, and those
// that come later are taken.
TEST(Listener, ComesBackWhenThereAreFilesAgain) {
  Metrics metrics;
  Taker taker;
  const auto listener =
      Listener::Open("127.0.0.1:0", Limits(100, 0), &metrics).value();
  listener->Start(taker.take());
  const RawConnection first(listener->port());
  ASSERT_TRUE(Eventually([&] { return metrics.connections == 1; }));
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const RawConnection waits(listener->port(), "127.0.0.1", [&] {
    // Its own descriptor is there; no more are to be.
    rlimit none = before;
    none.rlim_cur = 3;
    EXPECT_EQ(setrlimit(RLIMIT_NOFILE, &none), 0);
  });
  EXPECT_TRUE(
      Eventually([&] { return metrics.connections_refused_files > 0; }));
  EXPECT_EQ(metrics.connections, 1);
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  const RawConnection last(listener->port());
  EXPECT_TRUE(Eventually([&] { return metrics.connections >= 2; }));
}

TEST(Listener, ListensAtWhatItIsTold) {
  Metrics metrics;
  const auto open = [&](const std::string& address) {
    return Listener::Open(address, Limits(9, 0), &metrics);
  };
  for (const char* address : {"localhost:0", "127.0.0.1:0", "0.0.0.0:0"}) {
    const auto listener = open(address);
    ASSERT_TRUE(listener.ok()) << listener.status();
    EXPECT_TRUE(RawConnection((*listener)->port()).is_connected()) << address;
    const auto second =
        open("127.0.0.1:" + std::to_string((*listener)->port()));
    EXPECT_EQ(second.status().code(), absl::StatusCode::kUnavailable);
    EXPECT_THAT(second.status().ToString(), HasSubstr("in use"));
  }
  for (const char* address : {"",
                              "here",
                              "127.0.0.1",
                              "127.0.0.1:",
                              "127.0.0.1:x",
                              "127.0.0.1:70000",
                              "127.0.0.1:-1",
                              "::1:50551",
                              ":50551",
                              "unix:",
                              "no-such-host.invalid:1"}) {
    EXPECT_EQ(open(address).status().code(), absl::StatusCode::kInvalidArgument)
        << address << ": " << open(address).status();
  }
  EXPECT_EQ(open("192.0.2.1:0").status().code(), absl::StatusCode::kUnavailable)
      << "an address of nobody's";
}

TEST(Listener, ListensAtAUnixSocket) {
  const auto folder =
      base::TemporaryDirectory::Create(std::filesystem::temp_directory_path())
          .value();
  const std::string path = (folder.path() / "s").string();
  Metrics metrics;
  Taker taker;
  for (int round = 0; round < 2; ++round) {
    const auto listener =
        Listener::Open("unix:" + path, Limits(1, 1), &metrics).value();
    listener->Start(taker.take());
    EXPECT_EQ(listener->port(), 0);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    path.copy(address.sun_path, sizeof(address.sun_path) - 1);
    const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    EXPECT_EQ(
        connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof(address)), 0);
    EXPECT_TRUE(Eventually([&] { return metrics.connections == 1; }));
    EXPECT_TRUE(Eventually([&] { return taker.size() == 1; }));
    taker.EndOne();
    EXPECT_TRUE(Eventually([&] { return metrics.connections == 0; }));
    close(fd);
    listener->Stop();
    EXPECT_FALSE(std::filesystem::exists(path));
  }
  // What is no socket is nobody's to remove.
  ASSERT_TRUE(base::WriteFileAtomically(path, "mine").ok());
  EXPECT_FALSE(Listener::Open("unix:" + path, Limits(1, 1), &metrics).ok());
  EXPECT_TRUE(std::filesystem::exists(path));
}

TEST(Listener, EndsAConnection) {
  Metrics metrics;
  Taker taker;
  const auto listener =
      Listener::Open("127.0.0.1:0", Limits(9, 0), &metrics).value();
  listener->Start(taker.take());
  const RawConnection first(listener->port());
  const RawConnection second(listener->port());
  ASSERT_TRUE(Eventually([&] { return metrics.connections == 2; }));
  listener->Disconnect("ipv4:127.0.0.1:1");  // nobody's
  listener->Disconnect("ipv4:127.0.0.1:" + std::to_string(second.port()));
  EXPECT_TRUE(second.IsEnded());
  EXPECT_TRUE(Eventually([&] { return metrics.connections == 1; }));
  EXPECT_FALSE(first.EndsWithin(0));
}

TEST(ClientAddress, IsWhatGrpcTells) {
  EXPECT_EQ(ClientAddress("ipv4:192.0.2.1:40000"), "192.0.2.1:40000");
  EXPECT_EQ(ClientAddress("ipv6:%5B2001:db8::1%5D:40000"),
            "[2001:db8::1]:40000");
  EXPECT_EQ(ClientAddress("ipv6:%5Bfe80::1%25eth0%5D:7"), "[fe80::1]:7");
  EXPECT_EQ(ClientAddress("unix:"), "");
  sockaddr_storage peer{};
  peer.ss_family = AF_INET6;
  auto& v6 = reinterpret_cast<sockaddr_in6&>(peer);
  inet_pton(AF_INET6, "2001:db8::1", &v6.sin6_addr);
  v6.sin6_port = htons(40'000);
  EXPECT_EQ(ClientAddress(peer), "[2001:db8::1]:40000");
}

TEST(ClientNetwork, IsAnAddressOrWhatACustomerHas) {
  const auto network = [](int family, const char* address) {
    sockaddr_storage peer{};
    peer.ss_family = static_cast<sa_family_t>(family);
    void* bytes =
        family == AF_INET
            ? static_cast<void*>(&reinterpret_cast<sockaddr_in&>(peer).sin_addr)
            : &reinterpret_cast<sockaddr_in6&>(peer).sin6_addr;
    if (family != AF_UNIX) inet_pton(family, address, bytes);
    return ClientNetwork(peer);
  };
  EXPECT_EQ(network(AF_INET, "192.0.2.7"), "192.0.2.7");
  EXPECT_EQ(network(AF_INET6, "::ffff:192.0.2.7"), "192.0.2.7");
  EXPECT_EQ(network(AF_INET6, "2001:db8:1:2:3:4:5:6"), "2001:db8:1:2::/64");
  EXPECT_EQ(network(AF_INET6, "2001:db8:1:2::9"), "2001:db8:1:2::/64");
  EXPECT_NE(network(AF_INET6, "2001:db8:1:3::9"), "2001:db8:1:2::/64");
  EXPECT_EQ(network(AF_UNIX, ""), "");
}

}  // namespace
}  // namespace groundlock::service
