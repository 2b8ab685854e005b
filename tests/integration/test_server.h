// SPDX-License-Identifier: Apache-2.0
// A real server on a free port, what to send to it, and a tracker that tests
// hold in their hands.
#ifndef GROUNDLOCK_TESTS_INTEGRATION_TEST_SERVER_H_
#define GROUNDLOCK_TESTS_INTEGRATION_TEST_SERVER_H_

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "client/sdk/client.h"
#include "gtest/gtest.h"
#include "map_store/base/file.h"
#include "map_store/base/mutex.h"
#include "server/service/server.h"

namespace groundlock::test {

inline constexpr int kWidth = 160;
inline constexpr int kHeight = 120;

geometry::CameraModel TestCamera(int width_px = kWidth,
                                 int height_px = kHeight);

// A red square of 24 px on structured grey; PNG, so that nothing is lost.
// (x, y): its top-left corner.
sdk::Image SquareImage(int x,
                       int y,
                       int width_px = kWidth,
                       int height_px = kHeight);
sdk::Frame SquareFrame(std::uint64_t sequence, int x, int y);
// A frame that a fake core takes: of a few bytes.
sdk::Frame TinyFrame(std::uint64_t sequence);

// Lets through as many frames as it is told to.
class Gate {
 public:
  void Open(int frames);
  void OpenForGood() { Open(1 << 30); }
  void Pass();
  int waiting() const;

 private:
  mutable base::Mutex mutex_;
  int free_ = 0;
  int waiting_ = 0;
};

// Sessions whose frames wait at a gate and whose results echo the camera's size
// (as inliers), so that sessions can be told apart.
service::CoreFactory GatedCores(Gate* gate);

// A port of this machine that nobody else is given while it lives: a server may
// listen on it, stop, and listen again.
class ReservedPort {
 public:
  ReservedPort();
  ~ReservedPort();
  ReservedPort(const ReservedPort&) = delete;
  ReservedPort& operator=(const ReservedPort&) = delete;
  int number() const { return number_; }

 private:
  int socket_ = -1;
  int number_ = 0;
};

class TestServer {
 public:
  // What stands between the server and its store; null = nothing.
  using WrapStore = std::function<std::unique_ptr<storage::Store>(
      std::unique_ptr<storage::Store>)>;
  explicit TestServer(service::ServerOptions options = {},
                      service::CoreFactory factory = nullptr,
                      const WrapStore& wrap_store = nullptr);
  ~TestServer();

  std::string address() const;
  service::GroundlockServer& server() { return *server_; }
  service::Metrics& metrics() { return metrics_; }
  std::filesystem::path scratch() const;
  // Stops the server, and starts another on the same port and store.
  void Restart();
  void Stop(std::chrono::milliseconds grace);

  std::unique_ptr<sdk::Client> Connect() const;

 private:
  void Start();

  base::TemporaryDirectory directory_;
  ReservedPort port_;
  service::ServerOptions options_;
  service::CoreFactory factory_;
  service::Metrics metrics_;
  std::unique_ptr<storage::Store> store_;
  std::unique_ptr<service::GroundlockServer> server_;
};

// A 2D-only session.
sdk::SessionSpec Spec(const std::string& id,
                      sdk::FlowMode mode = sdk::FlowMode::kLossless);

// A client of the server at `target`, however busy the machine is: with the
// SDK's own patience a test would be about speed.
absl::StatusOr<std::unique_ptr<sdk::Client>> ConnectTo(
    const std::string& target, sdk::ClientOptions options = {});

// Waits up to two minutes (sanitizers are slow) for `condition`.
bool Eventually(const std::function<bool()>& condition);

}  // namespace groundlock::test

#endif  // GROUNDLOCK_TESTS_INTEGRATION_TEST_SERVER_H_
