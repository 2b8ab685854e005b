// SPDX-License-Identifier: Apache-2.0
// Two hundred clients that break off in the middle of the largest request: what
// the server holds meanwhile, and that others are served all the same.
#include <arpa/inet.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "groundlock/v1/tracking.pb.h"
#include "tests/integration/program.h"

namespace groundlock::test {
namespace {

constexpr int kClients = 200;
constexpr std::size_t kRequestBytes = std::size_t{63} << 20;
constexpr std::int64_t kHalf = std::int64_t{32} << 20;

sockaddr_in Loopback(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

// Passes bytes on between clients and the server; of each client's no more than
// kHalf, and then it stays connected and says nothing.
class HalfwayRelay {
 public:
  explicit HalfwayRelay(int server_port) : server_port_(server_port) {
    listener_ = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address = Loopback(0);
    socklen_t size = sizeof(address);
    EXPECT_EQ(bind(listener_, reinterpret_cast<sockaddr*>(&address), size), 0);
    EXPECT_EQ(listen(listener_, kClients), 0);
    getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &size);
    port_ = ntohs(address.sin_port);
    thread_ = std::thread([this] { Work(); });
  }
  ~HalfwayRelay() {
    stopping_ = true;
    thread_.join();
    for (const auto& [fd, way] : ways_) close(fd);
    close(listener_);
  }
  int port() const { return port_; }
  // Clients of which the server was sent what it is to get.
  int num_halfway() const { return num_halfway_; }
  std::int64_t bytes() const { return bytes_; }

 private:
  struct Way {
    int to = -1;
    std::int64_t left = 0;  // bytes that may pass
    bool is_clients = false;
  };

  void Work() {
    std::vector<char> buffer(1 << 18);
    while (!stopping_) {
      std::vector<pollfd> polled = {{listener_, POLLIN, 0}};
      for (const auto& [fd, way] : ways_) {
        if (way.left > 0) polled.push_back({fd, POLLIN, 0});
      }
      if (poll(polled.data(), polled.size(), 20) <= 0) continue;
      if (polled[0].revents != 0) Accept();
      for (std::size_t i = 1; i < polled.size(); ++i) {
        if (polled[i].revents != 0) Pass(polled[i].fd, buffer);
      }
    }
  }
  void Accept() {
    const int client = accept(listener_, nullptr, nullptr);
    const int server = socket(AF_INET, SOCK_STREAM, 0);
    const sockaddr_in address = Loopback(server_port_);
    if (connect(server,
                reinterpret_cast<const sockaddr*>(&address),
                sizeof(address)) != 0) {
      ADD_FAILURE() << "the server does not answer";
    }
    ways_[client] = {server, kHalf, true};
    ways_[server] = {client, std::int64_t{1} << 40, false};
  }
  // Leaves the bytes where they are if the other side takes none now.
  void Pass(int fd, std::vector<char>& buffer) {
    Way& way = ways_[fd];
    const auto want = std::min<std::int64_t>(
        way.left, static_cast<std::int64_t>(buffer.size()));
    const ssize_t seen =
        recv(fd, buffer.data(), static_cast<std::size_t>(want), MSG_PEEK);
    if (seen <= 0) {
      way.left = 0;
      return;
    }
    const ssize_t sent = send(way.to,
                              buffer.data(),
                              static_cast<std::size_t>(seen),
                              MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
    if (sent <= 0) {
      way.left = 0;
      return;
    }
    recv(fd, buffer.data(), static_cast<std::size_t>(sent), 0);
    way.left -= sent;
    if (!way.is_clients) return;
    bytes_ += sent;
    if (way.left == 0) ++num_halfway_;
  }

  const int server_port_;
  int listener_ = -1;
  int port_ = 0;
  std::map<int, Way> ways_;  // the thread's, until it ends
  std::atomic<bool> stopping_{false};
  std::atomic<int> num_halfway_{0};
  std::atomic<std::int64_t> bytes_{0};
  std::thread thread_;
};

// Of /proc/PID/status, bytes.
std::int64_t MostMemory(pid_t pid) {
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  std::string line;
  while (std::getline(status, line)) {
    if (line.starts_with("VmHWM:")) return std::stoll(line.substr(6)) << 10;
  }
  return -1;
}

TEST(HalfSent, RequestsNeitherFillTheMemoryNorStopOthers) {
  Program server({"--listen",
                  "127.0.0.1:0",
                  "--store",
                  "@TMP@/store",
                  "--client-timeout",
                  "20"});
  const int port = server.PortAfter("listening on 127.0.0.1:");
  ASSERT_GT(port, 0) << server.Log();
  auto relay = std::make_unique<HalfwayRelay>(port);
  v1::LocalizeRequest request;
  request.set_map_name("nowhere");
  request.mutable_image()->set_data(std::string(kRequestBytes, 'x'));
  const grpc::Slice slice(request.SerializeAsString());
  const grpc::ByteBuffer bytes(&slice, 1);  // shared by all clients
  struct Call {
    grpc::CompletionQueue queue;
    std::unique_ptr<grpc::GenericStub> stub;
    grpc::ClientContext context;
    std::unique_ptr<grpc::GenericClientAsyncReaderWriter> stream;
  };
  std::vector<std::unique_ptr<Call>> calls;
  for (int i = 0; i < kClients; ++i) {
    auto call = std::make_unique<Call>();
    grpc::ChannelArguments arguments;
    arguments.SetMaxSendMessageSize(-1);
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    call->stub = std::make_unique<grpc::GenericStub>(
        grpc::CreateCustomChannel("127.0.0.1:" + std::to_string(relay->port()),
                                  grpc::InsecureChannelCredentials(),
                                  arguments));
    call->stream =
        call->stub->PrepareCall(&call->context,
                                "/groundlock.v1.TrackingService/Localize",
                                &call->queue);
    call->stream->StartCall(nullptr);
    void* tag = nullptr;
    bool ok = false;
    ASSERT_TRUE(call->queue.Next(&tag, &ok));
    call->stream->Write(bytes, nullptr);  // is not awaited
    calls.push_back(std::move(call));
  }
  // Until nothing more comes through: the server has what it takes. A busy
  // machine may pause before that, and is given two minutes.
  constexpr std::int64_t kAttackBytes = std::int64_t{200} << 20;
  std::int64_t before = -1;
  int checks = 0;
  double longest_s = 0.0;
  for (int quiet = 0;
       quiet < 4 || (relay->bytes() <= kAttackBytes && checks < 240);
       ++checks) {
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
    quiet = relay->bytes() == before ? quiet + 1 : 0;
    before = relay->bytes();
    const auto asked = std::chrono::steady_clock::now();
    const auto client = ConnectTo("127.0.0.1:" + std::to_string(port));
    ASSERT_TRUE(client.ok()) << "others get in: " << client.status();
    const absl::Status status = (*client)->ListMaps().status();
    EXPECT_TRUE(status.ok()) << "others are served: " << status;
    longest_s = std::max(
        longest_s,
        std::chrono::duration<double>(std::chrono::steady_clock::now() - asked)
            .count());
  }
  const std::int64_t most = MostMemory(server.pid());
  std::cout << kClients << " clients sent " << (relay->bytes() >> 20)
            << " MiB, " << relay->num_halfway()
            << " of them half a request; the server held at most "
            << (most >> 20) << " MiB, others waited for " << longest_s
            << " s at most" << std::endl;
  EXPECT_GT(relay->bytes(), kAttackBytes) << "an attack that is none";
  EXPECT_GT(most, 0);
  EXPECT_LT(most, std::int64_t{2} << 30);
  relay = nullptr;  // else what a client has begun to write would never end
  for (const auto& call : calls) {
    call->context.TryCancel();
    call->queue.Shutdown();
    void* tag = nullptr;
    bool ok = false;
    while (call->queue.Next(&tag, &ok)) {
    }
  }
  server.Signal(SIGTERM);
  EXPECT_EQ(server.Wait(), 0) << server.Log();
}

}  // namespace
}  // namespace groundlock::test
