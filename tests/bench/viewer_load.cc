// SPDX-License-Identifier: Apache-2.0
// What those who look on cost: one live session at a camera's rate through the
// programs themselves, watched by no viewer, by one, by many, and by many of
// whom one stalls. Processor time of the server and of the dashboard, images
// that each viewer got, and the dashboard's memory.
//   viewer_load [--viewers N] [--seconds S] [--stalled-minutes M]
#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <memory>
#include <opencv2/core/utility.hpp>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/asio.h"
#include "client/sdk/client.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"
#include "tests/bench/child_program.h"
#include "tests/support/recorded_data.h"

namespace groundlock::bench {
namespace {

namespace asio = dashboard::asio;
namespace beast = dashboard::beast;
namespace fs = std::filesystem;
namespace pb = ::groundlock::dashboard::v1;
namespace websocket = dashboard::websocket;
using dashboard::error_code;
using dashboard::Tcp;
using std::chrono::steady_clock;

constexpr char kSession[] = "load";

struct Arguments {
  std::string sequence = "occlusion";
  int viewers = 20;
  double frames_per_second = 24.0;
  double seconds = 20.0;
  double stalled_minutes = 0.0;
};

// A page that takes what comes, or takes nothing at all.
class Viewer {
 public:
  Viewer(asio::io_context& io, const std::string& port, bool stalls)
      : stream_(asio::make_strand(io)), stalls_(stalls) {
    Tcp::socket& socket = beast::get_lowest_layer(stream_).socket();
    socket.open(Tcp::v4());
    if (stalls) {
      socket.set_option(asio::socket_base::receive_buffer_size(4'096));
    }
    socket.connect({asio::ip::address_v4::loopback(),
                    static_cast<std::uint16_t>(std::stoi(port))});
    stream_.handshake(absl::StrCat("127.0.0.1:", port), "/ws");
    stream_.binary(true);
    stream_.read_message_max(64 << 20);
    pb::ClientMessage message;
    message.set_request_id(1);
    message.mutable_subscribe()->set_session_id(kSession);
    message.mutable_subscribe()->set_include_images(true);
    stream_.write(asio::buffer(message.SerializeAsString()));
    if (!stalls_) Read();
  }
  // Only when its context runs no more, or it stalls.
  ~Viewer() { beast::get_lowest_layer(stream_).close(); }
  Viewer(const Viewer&) = delete;
  Viewer& operator=(const Viewer&) = delete;

  int images() const { return images_; }

 private:
  void Read() {
    stream_.async_read(buffer_, [this](error_code error, std::size_t) {
      if (error) return;
      const auto data = buffer_.cdata();
      pb::ServerMessage message;
      if (message.ParseFromArray(data.data(), static_cast<int>(data.size()))) {
        images_ += message.has_frame_image();
      }
      buffer_.consume(buffer_.size());
      Read();
    });
  }

  websocket::stream<beast::tcp_stream> stream_;
  const bool stalls_;
  beast::flat_buffer buffer_;
  std::atomic<int> images_ = 0;
};

// Those who look on, on a thread of their own.
class Crowd {
 public:
  Crowd(const std::string& port, int viewers) {
    for (int i = 0; i < viewers; ++i) {
      viewers_.push_back(std::make_unique<Viewer>(io_, port, false));
    }
    thread_ = std::jthread([this] { io_.run(); });
  }
  ~Crowd() {
    io_.stop();
    thread_ = {};
    viewers_.clear();
  }
  Crowd(const Crowd&) = delete;
  Crowd& operator=(const Crowd&) = delete;

  std::vector<int> Images() const {
    std::vector<int> images;
    for (const auto& viewer : viewers_) images.push_back(viewer->images());
    return images;
  }

 private:
  asio::io_context io_;
  std::vector<std::unique_ptr<Viewer>> viewers_;
  std::jthread thread_;
};

// A camera: frames of the sequence forwards and backwards, until it is stopped.
absl::Status Stream(sdk::TrackingStream& stream,
                    const std::vector<std::string>& jpegs,
                    double frames_per_second,
                    const std::atomic<bool>& stop) {
  const auto begin = steady_clock::now();
  const int last = static_cast<int>(jpegs.size()) - 1;
  for (int i = 0; !stop; ++i) {
    const auto due = std::chrono::duration_cast<steady_clock::duration>(
        std::chrono::duration<double>(i / frames_per_second));
    std::this_thread::sleep_until(begin + due);
    const int phase = i % (2 * last);
    sdk::Frame frame;
    frame.sequence = static_cast<std::uint64_t>(i) + 1;
    frame.capture_time = due;
    frame.image.encoding = sdk::ImageEncoding::kJpeg;
    frame.image.bytes = jpegs[phase <= last ? phase : 2 * last - phase];
    RETURN_IF_ERROR(stream.Send(std::move(frame)));
  }
  return stream.Finish();
}

struct Programs {
  ChildProgram* server;
  ChildProgram* dashboard;
  std::string dashboard_port;
};

struct Cost {
  double server_percent;  // of a core
  double dashboard_percent;
};

Cost Measure(const Programs& programs,
             const char* what,
             int viewers,
             bool one_stalls,
             double seconds) {
  const Crowd crowd(programs.dashboard_port, viewers);
  asio::io_context idle;
  std::unique_ptr<Viewer> stalled;
  if (one_stalls) {
    stalled = std::make_unique<Viewer>(idle, programs.dashboard_port, true);
  }
  std::this_thread::sleep_for(std::chrono::seconds(3));
  const std::vector<int> images_before = crowd.Images();
  const double server = programs.server->CpuSeconds();
  const double proxy = programs.dashboard->CpuSeconds();
  const auto begin = steady_clock::now();
  std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
  const Cost cost{(programs.server->CpuSeconds() - server),
                  (programs.dashboard->CpuSeconds() - proxy)};
  const double passed =
      std::chrono::duration<double>(steady_clock::now() - begin).count();
  std::vector<double> rates;
  const std::vector<int> images = crowd.Images();
  for (std::size_t i = 0; i < images.size(); ++i) {
    rates.push_back((images[i] - images_before[i]) / passed);
  }
  const Cost percent{100.0 * cost.server_percent / passed,
                     100.0 * cost.dashboard_percent / passed};
  std::printf("%-28s server %5.1f %%  dashboard %5.1f %%  resident %.0f MiB",
              what,
              percent.server_percent,
              percent.dashboard_percent,
              programs.dashboard->ResidentMib());
  if (!rates.empty()) {
    const auto [least, most] = std::minmax_element(rates.begin(), rates.end());
    std::printf("  images/s per viewer %.1f to %.1f", *least, *most);
  }
  std::printf("\n");
  std::fflush(stdout);
  return percent;
}

// One viewer looks on and another one stalls all the time; the dashboard throws
// it out after a while, and it comes again.
void WatchMemory(const Programs& programs, double minutes) {
  const Crowd crowd(programs.dashboard_port, 1);
  asio::io_context idle;
  const auto begin = steady_clock::now();
  int images_before = 0;
  for (int half_minutes = 1; half_minutes <= 2.0 * minutes; ++half_minutes) {
    const Viewer stalled(idle, programs.dashboard_port, true);
    std::this_thread::sleep_until(begin +
                                  half_minutes * std::chrono::seconds(30));
    const int images = crowd.Images().front();
    std::printf(
        "%4.1f min: dashboard %.1f MiB, server %.1f MiB, the other "
        "viewer %.1f images/s\n",
        0.5 * half_minutes,
        programs.dashboard->ResidentMib(),
        programs.server->ResidentMib(),
        (images - images_before) / 30.0);
    std::fflush(stdout);
    images_before = images;
  }
}

absl::Status Import(const test_support::Sequence& sequence,
                    const std::string& server,
                    const fs::path& log) {
  std::vector<std::string> arguments = {GROUNDLOCK,
                                        "map",
                                        "import",
                                        kSession,
                                        sequence.reconstruction.string(),
                                        "--server",
                                        server};
  if (!sequence.align.empty()) {
    arguments.push_back("--align");
    arguments.push_back(sequence.align.string());
  }
  if (ChildProgram(std::move(arguments), log).Wait() == 0)
    return absl::OkStatus();
  const auto said = base::ReadFile(log, 1 << 20);
  return absl::InternalError(
      absl::StrCat("groundlock map import: ", said.ok() ? *said : ""));
}

absl::Status Run(const Arguments& arguments) {
  ASSIGN_OR_RETURN(const auto sequence,
                   test_support::FindSequence(arguments.sequence));
  ASSIGN_OR_RETURN(const auto camera,
                   test_support::ReadCamera(sequence.camera));
  ASSIGN_OR_RETURN(const auto truth,
                   test_support::ReadTrueFrames(sequence.truth));
  std::vector<std::string> jpegs;
  {
    ASSIGN_OR_RETURN(const auto images,
                     test_support::ReadFrames(sequence.video, 1, 240));
    for (const auto& [index, image] : images) {
      const std::vector<std::uint8_t> bytes = test_support::EncodeJpeg(image);
      jpegs.emplace_back(bytes.begin(), bytes.end());
    }
  }
  if (jpegs.size() < 2) return absl::InvalidArgumentError("too few frames");
  ASSIGN_OR_RETURN(const auto directory,
                   base::TemporaryDirectory::Create(fs::temp_directory_path()));
  const fs::path& folder = directory.path();
  ChildProgram server({GROUNDLOCK_SERVER,
                       "--listen",
                       "127.0.0.1:0",
                       "--store",
                       (folder / "store").string(),
                       "--metrics",
                       "",
                       "--port-file",
                       (folder / "server.port").string()},
                      folder / "server.log");
  ASSIGN_OR_RETURN(const std::string port, PortIn(folder / "server.port"));
  const std::string address = absl::StrCat("127.0.0.1:", port);
  RETURN_IF_ERROR(Import(sequence, address, folder / "import.log"));
  ChildProgram proxy({GROUNDLOCK_DASHBOARD,
                      "--listen",
                      "127.0.0.1:0",
                      "--server",
                      address,
                      "--data",
                      (folder / "dashboard").string(),
                      "--port-file",
                      (folder / "dashboard.port").string()},
                     folder / "dashboard.log");
  ASSIGN_OR_RETURN(const std::string page_port,
                   PortIn(folder / "dashboard.port"));

  ASSIGN_OR_RETURN(const auto client, sdk::Client::Connect(address));
  sdk::SessionSpec spec;
  spec.session_id = kSession;
  spec.map_name = kSession;
  spec.camera = camera;
  spec.options.flow_mode = sdk::FlowMode::kLive;
  spec.options.report_matches = true;
  RETURN_IF_ERROR(client->CreateSession(spec).status());
  if (const auto first = truth.find(0);
      first != truth.end() && first->second.target_px) {
    RETURN_IF_ERROR(
        client
            ->SetTarget(
                kSession, "target", *first->second.target_px, std::uint64_t{1})
            .status());
  }
  sdk::TrackingStreamOptions stream_options;
  stream_options.on_reply = [](const sdk::FrameReply&) {};
  ASSIGN_OR_RETURN(const auto stream, client->Track(kSession, stream_options));
  std::atomic<bool> stop = false;
  absl::Status streamed;
  {
    std::jthread source([&] {
      streamed = Stream(*stream, jpegs, arguments.frames_per_second, stop);
    });
    const Programs programs{&server, &proxy, page_port};
    std::this_thread::sleep_for(std::chrono::seconds(3));
    const double s = arguments.seconds;
    const int n = arguments.viewers;
    const Cost none = Measure(programs, "no viewer", 0, false, s);
    const Cost one = Measure(programs, "one viewer", 1, false, s);
    const Cost many =
        Measure(programs, absl::StrCat(n, " viewers").c_str(), n, false, s);
    Measure(programs,
            absl::StrCat(n, " viewers, one more stalls").c_str(),
            n,
            true,
            s);
    const auto added = [&none](const Cost& cost) {
      const double base = none.server_percent + none.dashboard_percent;
      return 100.0 * (cost.server_percent + cost.dashboard_percent - base) /
             base;
    };
    std::printf(
        "added to the server: %.1f %% by one, %.1f %% by %d; with the "
        "dashboard: %.1f %% and %.1f %%\n",
        100.0 * (one.server_percent / none.server_percent - 1.0),
        100.0 * (many.server_percent / none.server_percent - 1.0),
        n,
        added(one),
        added(many));
    if (arguments.stalled_minutes > 0.0) {
      WatchMemory(programs, arguments.stalled_minutes);
    }
    stop = true;
  }
  return streamed;
}

}  // namespace
}  // namespace groundlock::bench

int main(int argc, char** argv) {
  groundlock::bench::Arguments arguments;
  CLI::App app("What viewers of a session cost");
  app.add_option("--sequence", arguments.sequence);
  app.add_option("--viewers", arguments.viewers)->check(CLI::PositiveNumber);
  app.add_option("--fps", arguments.frames_per_second)
      ->check(CLI::PositiveNumber);
  app.add_option("--seconds", arguments.seconds, "of each measurement")
      ->check(CLI::PositiveNumber);
  app.add_option("--stalled-minutes",
                 arguments.stalled_minutes,
                 "then watch the memory while a viewer stalls");
  CLI11_PARSE(app, argc, argv);
  cv::setNumThreads(1);
  const absl::Status status = groundlock::bench::Run(arguments);
  if (!status.ok()) std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return status.ok() ? 0 : 1;
}
