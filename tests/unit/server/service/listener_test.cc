// SPDX-License-Identifier: Apache-2.0
#include "server/service/listener.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <list>
#include <mutex>
#include <utility>

namespace groundlock::service {
namespace {

using ::testing::HasSubstr;

// What lasts until it holds is waited for, not timed.
bool Eventually(const std::function<bool()>& holds) {
  for (int i = 0; i < 2'400; ++i) {
    if (holds()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return false;
}

class Socket {
 public:
  Socket() : fd_(socket(AF_INET, SOCK_STREAM, 0)) {}
  explicit Socket(int fd) : fd_(fd) {}
  Socket(Socket&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Socket& operator=(Socket&&) = delete;
  ~Socket() {
    if (fd_ >= 0) close(fd_);
  }
  bool Connect(int port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return connect(fd_,
                   reinterpret_cast<const sockaddr*>(&address),
                   sizeof(address)) == 0;
  }
  // The other side has closed it.
  bool IsClosed() const {
    pollfd polled = {fd_, POLLIN, 0};
    char byte = 0;
    return poll(&polled, 1, 0) == 1 && recv(fd_, &byte, 1, 0) <= 0;
  }

 private:
  int fd_;
};

// A listener that keeps what it is given.
class Door {
 public:
  explicit Door(const ConnectionLimits& limits,
                const std::string& address = "127.0.0.1:0")
      : listener_(Listener::Bind(address, limits, &open_, &refused_)) {
    if (!listener_.ok()) return;
    (*listener_)->Start([this](int /*listener_fd*/, int fd) {
      const std::lock_guard lock(mutex_);
      taken_.emplace_back(fd);
    });
  }
  const absl::Status& status() const { return listener_.status(); }
  int port() const { return (*listener_)->port(); }
  std::size_t taken() {
    const std::lock_guard lock(mutex_);
    return taken_.size();
  }
  void CloseOne() {
    const std::lock_guard lock(mutex_);
    taken_.pop_front();
  }
  std::int64_t open() const { return open_; }
  std::uint64_t refused() const { return refused_; }

 private:
  std::atomic<std::int64_t> open_{0};
  std::atomic<std::uint64_t> refused_{0};
  std::mutex mutex_;
  std::list<Socket> taken_;
  absl::StatusOr<std::unique_ptr<Listener>> listener_;
};

std::vector<Socket> Connected(const Door& door, int count) {
  std::vector<Socket> clients(static_cast<std::size_t>(count));
  for (Socket& client : clients) EXPECT_TRUE(client.Connect(door.port()));
  return clients;
}

TEST(Listener, RefusesWhatIsTooMuchAndTakesInAgainWhenThereIsRoom) {
  for (const ConnectionLimits limits :
       {ConnectionLimits{3, 0}, {100, 3}, {3, 3}}) {
    Door door(limits);
    ASSERT_TRUE(door.status().ok()) << door.status();
    const std::vector<Socket> clients = Connected(door, 5);
    EXPECT_TRUE(Eventually([&] { return door.refused() == 2; }));
    EXPECT_EQ(door.taken(), 3U);
    EXPECT_TRUE(Eventually([&] { return door.open() == 3; }));
    EXPECT_TRUE(Eventually(
        [&] { return clients[3].IsClosed() && clients[4].IsClosed(); }));
    EXPECT_FALSE(clients[0].IsClosed());

    // gRPC closes a connection without a word to the listener.
    door.CloseOne();
    EXPECT_TRUE(Eventually([&] { return door.open() == 2; }));
    const std::vector<Socket> next = Connected(door, 1);
    EXPECT_TRUE(Eventually([&] { return door.taken() == 3; }));
    EXPECT_EQ(door.refused(), 2U);
  }
}

TEST(Listener, ADescriptorThatIsSomethingElseNowIsNoConnection) {
  OpenConnections connections({1, 1});
  const Socket first;
  const int fd = dup(STDIN_FILENO);
  ASSERT_EQ(dup2(socket(AF_INET, SOCK_STREAM, 0), fd), fd);
  EXPECT_TRUE(connections.Add(fd, "a"));
  EXPECT_EQ(connections.size(), 1U);
  const int other = socket(AF_INET, SOCK_STREAM, 0);
  ASSERT_EQ(dup2(other, fd), fd);
  connections.SweepIfOlderThan(std::chrono::nanoseconds(0));
  EXPECT_EQ(connections.size(), 0U);
  close(other);
  close(fd);
}

TEST(Listener, GoesOnAfterAllDescriptorsWereTaken) {
  Door door({100, 100});
  ASSERT_TRUE(door.status().ok()) << door.status();
  std::vector<Socket> clients(2);
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  rlimit few = before;
  few.rlim_cur = 64;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  std::vector<int> taken;
  for (int fd = dup(0); fd >= 0; fd = dup(0)) taken.push_back(fd);
  ASSERT_EQ(errno, EMFILE);
  // The system takes it in; accept() cannot.
  EXPECT_TRUE(clients[0].Connect(door.port()));
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_EQ(door.taken(), 0U);
  for (const int fd : taken) close(fd);
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_TRUE(Eventually([&] { return door.taken() == 1; }));
  EXPECT_TRUE(clients[1].Connect(door.port()));
  EXPECT_TRUE(Eventually([&] { return door.taken() == 2; }));
}

TEST(Listener, LeavesTheProcessAQuarterOfItsFiles) {
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  rlimit few = before;
  few.rlim_cur = 80;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  Door door({1'000, 1'000});
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  ASSERT_TRUE(door.status().ok()) << door.status();
  const std::vector<Socket> clients = Connected(door, 70);
  EXPECT_TRUE(Eventually([&] { return door.refused() == 10; }));
  EXPECT_EQ(door.taken(), 60U);
}

TEST(Listener, ListensAtEveryAddressOfAName) {
  for (const char* address : {"localhost:0", "0.0.0.0:0", "[::]:0", ":0"}) {
    Door door({10, 10}, address);
    if (!door.status().ok() && std::string(address) == "[::]:0") continue;
    ASSERT_TRUE(door.status().ok()) << door.status();
    const std::vector<Socket> clients = Connected(door, 1);
    EXPECT_TRUE(Eventually([&] { return door.taken() == 1; })) << address;
  }
}

TEST(Listener, SaysWhatItCannotBind) {
  Door door({10, 10});
  ASSERT_TRUE(door.status().ok()) << door.status();
  const std::string taken = "127.0.0.1:" + std::to_string(door.port());
  for (const auto& [address, reason] :
       {std::pair<std::string, std::string>{taken, "in use"},
        {"nowhere", "expected HOST:PORT"},
        {"127.0.0.1:", "expected HOST:PORT"},
        {"127.0.0.1:99999", "up to 65535"},
        {"0.0.0.0:" + std::to_string(door.port()), "in use"},
        {"no.such.host.invalid:1", "cannot bind no.such.host.invalid:1"},
        {"192.0.2.1:0", "cannot bind 192.0.2.1:0"}}) {
    const Door none({10, 10}, address);
    EXPECT_FALSE(none.status().ok()) << address;
    EXPECT_THAT(std::string(none.status().message()), HasSubstr(reason));
  }
}

}  // namespace
}  // namespace groundlock::service
