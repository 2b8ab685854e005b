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

#include <array>
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
  int port() const {
    sockaddr_in address{};
    socklen_t size = sizeof(address);
    getsockname(fd_, reinterpret_cast<sockaddr*>(&address), &size);
    return ntohs(address.sin_port);
  }
  void Send(std::size_t bytes) const {
    const std::string message(bytes, 'x');
    EXPECT_EQ(send(fd_, message.data(), bytes, MSG_NOSIGNAL),
              static_cast<ssize_t>(bytes));
  }
  void ReadAll() const {
    std::array<char, 4096> buffer{};
    while (recv(fd_, buffer.data(), buffer.size(), MSG_DONTWAIT) > 0) {
    }
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
                const std::string& address = "127.0.0.1:0",
                const PartialMessageLimit& partial = {})
      : listener_(Listener::Bind(
            address, limits, partial, {&open_, &refused_, &ended_})) {
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
  // Reads what has come on all that were taken in, as gRPC does at once.
  void ReadAll() {
    const std::lock_guard lock(mutex_);
    for (const Socket& socket : taken_) socket.ReadAll();
  }
  void CloseOne() {
    const std::lock_guard lock(mutex_);
    taken_.pop_front();
  }
  std::int64_t open() const { return open_; }
  std::uint64_t refused() const { return refused_; }
  std::uint64_t ended() const { return ended_; }

 private:
  std::atomic<std::int64_t> open_{0};
  std::atomic<std::uint64_t> refused_{0};
  std::atomic<std::uint64_t> ended_{0};
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
  EXPECT_TRUE(connections.Add(fd, "a", 1));
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

TEST(Listener, EndsThoseWhoSentHalfAndAreSilent) {
  WholeMessages whole;
  // Nothing is forgotten for its age.
  Door door(
      {100, 100}, "127.0.0.1:0", {&whole, 100'000, std::chrono::hours(1'000)});
  ASSERT_TRUE(door.status().ok()) << door.status();
  const std::vector<Socket> clients = Connected(door, 5);
  ASSERT_TRUE(Eventually([&] { return door.taken() == 5; }));
  const auto send = [&](int client, std::size_t bytes) {
    clients[static_cast<std::size_t>(client)].Send(bytes);
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    door.ReadAll();
  };
  // Silent for longest, but with less than an equal share of 20,000.
  send(0, 15'000);
  send(1, 45'000);
  send(2, 30'000);
  // Whole messages are nobody's burden, however much they are.
  for (int i = 0; i < 30; ++i) {
    send(3, 5'000);
    whole.Add("ipv4:127.0.0.1:" + std::to_string(clients[3].port()), 5'000);
  }
  std::this_thread::sleep_for(std::chrono::seconds(1));
  EXPECT_EQ(door.ended(), 0U);
  send(4, 25'000);
  // 115,000 are too much: without client 1 it is 70,000, without 2 it is
  // 40,000, which leaves half of all free.
  EXPECT_TRUE(Eventually([&] { return door.ended() == 2; })) << door.ended();
  EXPECT_TRUE(Eventually(
      [&] { return clients[1].IsClosed() && clients[2].IsClosed(); }));
  for (const std::size_t stays : {0U, 3U, 4U}) {
    EXPECT_FALSE(clients[stays].IsClosed()) << stays;
  }
  EXPECT_EQ(door.ended(), 2U);
}

TEST(Listener, ForgetsWhatWasSentHalfAndGivenUp) {
  WholeMessages whole;
  Door door({100, 100},
            "127.0.0.1:0",
            {&whole, 100'000, std::chrono::milliseconds(100)});
  ASSERT_TRUE(door.status().ok()) << door.status();
  const std::vector<Socket> clients = Connected(door, 1);
  ASSERT_TRUE(Eventually([&] { return door.taken() == 1; }));
  for (int i = 0; i < 3; ++i) {
    clients[0].Send(60'000);
    door.ReadAll();
    std::this_thread::sleep_for(std::chrono::seconds(1));
    door.ReadAll();
  }
  EXPECT_EQ(door.ended(), 0U);
  EXPECT_FALSE(clients[0].IsClosed());
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
