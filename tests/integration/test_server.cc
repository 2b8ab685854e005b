// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/test_server.h"

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <thread>
#include <utility>

#include "absl/time/clock.h"

namespace groundlock::test {
namespace {

class GatedCore final : public tracking::TrackingSession {
 public:
  GatedCore(Gate* gate, const geometry::CameraModel& camera)
      : gate_(gate), camera_(camera) {}

  absl::Status SetTarget(const std::string& id,
                         const geometry::Box2& /*box_px*/,
                         std::optional<std::uint64_t> /*frame_sequence*/,
                         const tracking::TargetBody& /*body*/) override {
    ids_.push_back(id);
    return absl::OkStatus();
  }
  absl::Status MoveTarget(const std::string& /*id*/,
                          const geometry::Box2& /*box_px*/) override {
    return absl::NotFoundError("no target");
  }
  absl::Status DropTarget(const std::string& /*id*/) override {
    return absl::NotFoundError("no target");
  }
  std::vector<std::string> TargetIds() const override { return ids_; }
  void SetHurried(bool /*hurried*/) override {}

  absl::StatusOr<tracking::FrameResult> ProcessFrame(
      const image::Frame& frame,
      const std::optional<geometry::CameraModel>& /*camera*/,
      const tracking::SensorReadings& /*sensors*/,
      std::vector<absl::Status>* /*target_errors*/) override {
    gate_->Pass();
    // One frame at a time, in order: a strand's promise.
    EXPECT_TRUE(!last_.has_value() || *last_ < frame.sequence);
    last_ = frame.sequence;
    tracking::FrameResult result;
    result.camera.num_inliers = camera_.width_px();
    return result;
  }

 private:
  Gate* const gate_;
  const geometry::CameraModel camera_;
  std::vector<std::string> ids_;
  std::optional<std::uint64_t> last_;
};

}  // namespace

geometry::CameraModel TestCamera(int width_px, int height_px) {
  const double params[] = {150.0, 0.5 * width_px, 0.5 * height_px};
  return *geometry::CameraModel::Create(
      geometry::CameraModelId::kSimplePinhole, width_px, height_px, params);
}

sdk::Image SquareImage(int x, int y, int width_px, int height_px) {
  cv::Mat image(height_px, width_px, CV_8UC3);
  for (int row = 0; row < height_px; ++row) {
    for (int column = 0; column < width_px; ++column) {
      const auto gray =
          static_cast<std::uint8_t>(90 + 8 * ((row / 16 + column / 16) % 2));
      image.at<cv::Vec3b>(row, column) = {gray, gray, gray};
    }
  }
  cv::rectangle(image, {x, y, 24, 24}, {20, 20, 220}, cv::FILLED);
  cv::rectangle(image, {x + 6, y + 6, 8, 12}, {230, 200, 20}, cv::FILLED);
  std::vector<std::uint8_t> png;
  cv::imencode(".png", image, png);
  return {sdk::ImageEncoding::kPng, std::string(png.begin(), png.end()), 0, 0};
}

sdk::Frame SquareFrame(std::uint64_t sequence, int x, int y) {
  return {sequence,
          std::chrono::milliseconds(40) * sequence,
          SquareImage(x, y),
          std::nullopt,
          std::nullopt};
}

sdk::Frame TinyFrame(std::uint64_t sequence) {
  return {sequence,
          std::chrono::milliseconds(40) * sequence,
          {sdk::ImageEncoding::kRawGray8, "0123", 2, 2},
          std::nullopt,
          std::nullopt};
}

void Gate::Open(int frames) {
  base::MutexLock lock(&mutex_);
  free_ += frames;
}

void Gate::Pass() {
  base::MutexLock lock(&mutex_);
  ++waiting_;
  const auto open = [this] { return free_ > 0; };
  mutex_.Await(open);
  --waiting_;
  --free_;
}

int Gate::waiting() const {
  base::MutexLock lock(&mutex_);
  return waiting_;
}

service::CoreFactory GatedCores(Gate* gate) {
  return [gate](std::shared_ptr<const map::Map> /*map*/,
                const geometry::CameraModel& camera,
                const tracking::SessionOptions& /*options*/)
             -> absl::StatusOr<std::unique_ptr<tracking::TrackingSession>> {
    return std::make_unique<GatedCore>(gate, camera);
  };
}

// Bound and not listening: with SO_REUSEADDR, as gRPC has it, a server may
// listen on the same port, but the kernel gives it to nobody who asks for any.
ReservedPort::ReservedPort() : socket_(socket(AF_INET, SOCK_STREAM, 0)) {
  const int yes = 1;
  setsockopt(socket_, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  auto* const any = reinterpret_cast<sockaddr*>(&address);
  if (bind(socket_, any, size) != 0 || getsockname(socket_, any, &size) != 0) {
    ADD_FAILURE() << "no port: " << std::strerror(errno);
  }
  number_ = ntohs(address.sin_port);
}

ReservedPort::~ReservedPort() { close(socket_); }

TestServer::TestServer(service::ServerOptions options,
                       service::CoreFactory factory,
                       const WrapStore& wrap_store)
    : directory_(*base::TemporaryDirectory::Create(
          std::filesystem::temp_directory_path())),
      options_(std::move(options)),
      factory_(std::move(factory)) {
  options_.listen = "127.0.0.1:" + std::to_string(port_.number());
  options_.scratch_directory = scratch().string();
  store_ = *storage::OpenStore((directory_.path() / "store").string());
  if (wrap_store != nullptr) store_ = wrap_store(std::move(store_));
  Start();
}

TestServer::~TestServer() { server_ = nullptr; }

void TestServer::Start() {
  auto server = service::GroundlockServer::Start(
      options_, store_.get(), &metrics_, factory_);
  if (!server.ok()) ADD_FAILURE() << server.status();
  server_ = *std::move(server);
}

void TestServer::Restart() {
  server_ = nullptr;
  Start();
}

void TestServer::Stop(std::chrono::milliseconds grace) {
  server_->Shutdown(grace);
}

std::string TestServer::address() const {
  return "127.0.0.1:" + std::to_string(server_->port());
}

std::filesystem::path TestServer::scratch() const {
  return directory_.path() / "store" / "scratch";
}

std::unique_ptr<sdk::Client> TestServer::Connect() const {
  auto client = ConnectTo(address());
  if (!client.ok()) ADD_FAILURE() << client.status();
  return *std::move(client);
}

absl::StatusOr<std::unique_ptr<sdk::Client>> ConnectTo(
    const std::string& target, sdk::ClientOptions options) {
  options.connect_timeout = std::chrono::minutes(2);
  return sdk::Client::Connect(target, options);
}

sdk::SessionSpec Spec(const std::string& id, sdk::FlowMode mode) {
  sdk::SessionSpec spec;
  spec.session_id = id;
  spec.camera = TestCamera();
  spec.options.flow_mode = mode;
  return spec;
}

bool Eventually(const std::function<bool()>& condition) {
  const absl::Time end = absl::Now() + absl::Minutes(2);
  while (!condition()) {
    if (absl::Now() > end) return false;
    absl::SleepFor(absl::Milliseconds(2));
  }
  return true;
}

}  // namespace groundlock::test
