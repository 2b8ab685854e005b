// SPDX-License-Identifier: Apache-2.0
// groundlock-dashboard: options and signals.
#include <google/protobuf/util/json_util.h>
#include <pthread.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <opencv2/core/utility.hpp>
#include <string>
#include <system_error>
#include <vector>

#include "absl/status/status.h"
#include "client/dashboard/proxy/dashboard.h"
#include "client/media/video_source.h"
#include "client/sdk/client.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"
#include "map_store/base/file.h"
#include "map_store/base/logging.h"
#include "map_store/base/status.h"
#include "map_store/base/version.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

namespace fs = std::filesystem;
namespace pb = ::groundlock::dashboard::v1;

struct Flags {
  DashboardOptions dashboard;
  std::string web;
  std::string data = "groundlock-dashboard-data";
  std::string recordings;
  std::string uploads;
  std::string sources;
  std::vector<std::string> streams;
  std::vector<std::string> starts;
  std::string token_file;
  std::string port_file;
  std::string log_level = "info";
  std::string log_format = "text";
  double stall_timeout_s = 15.0;
};

void DefineOptions(CLI::App& app, Flags& flags) {
  DashboardOptions& options = flags.dashboard;
  app.set_config("--config", "", "Read options from a TOML or INI file");
  app.add_option("--listen",
                 options.listen,
                 "Address to serve the page on, HOST:PORT; port 0 = any")
      ->capture_default_str();
  app.add_option("--metrics",
                 options.metrics,
                 "Address of the Prometheus endpoint, HOST:PORT; none without");
  app.add_option("--tls-cert",
                 options.https.certificate,
                 "Serve HTTPS with this certificate, PEM, with those of its "
                 "issuers; read again when it changes")
      ->type_name("FILE");
  app.add_option("--tls-key", options.https.key, "Its private key, PEM")
      ->type_name("FILE");
  app.add_flag("--insecure",
               options.insecure,
               "Serve other machines without HTTPS: behind a proxy that does "
               "it");
  app.add_option("--max-connections-per-address",
                 options.max_connections_per_address,
                 "HTTP connections of one IPv4 address, or one IPv6 network of "
                 "64 bits; 0 = no more than in total")
      ->check(CLI::Range(0, 100'000))
      ->capture_default_str();
  app.add_option("--server",
                 options.server.target,
                 "Groundlock server, HOST:PORT; with TLS grpcs://HOST:PORT")
      ->capture_default_str();
  sdk::ClientTls& tls = options.server.tls;
  app.add_option("--ca",
                 tls.ca,
                 "Who issued the server's certificate, PEM; without it, whom "
                 "this machine trusts")
      ->type_name("FILE");
  app.add_option("--cert",
                 tls.certificate,
                 "Certificate to show to a server that asks for one, PEM")
      ->type_name("FILE");
  app.add_option("--key", tls.key, "Its private key, PEM")->type_name("FILE");
  app.add_option("--tls-name",
                 tls.server_name,
                 "Name in the server's certificate, if it is not HOST");
  app.add_option("--web",
                 flags.web,
                 "Folder of the built page; default: beside the program");
  app.add_option("--data",
                 flags.data,
                 "Folder for recordings and uploads, created if absent")
      ->capture_default_str();
  app.add_option("--recordings",
                 flags.recordings,
                 "Folder for recordings; default: DATA/recordings");
  app.add_option(
      "--uploads", flags.uploads, "Folder for uploads; default: DATA/uploads");
  app.add_option("--sources",
                 flags.sources,
                 "Folder with videos that sessions may be started from");
  app.add_option("--stream",
                 flags.streams,
                 "NAME=INPUT[,CAMERA.json]: a network stream or camera that "
                 "sessions may be started from; may be given again");
  app.add_option("--start",
                 flags.starts,
                 "JSON file with a groundlock.dashboard.v1.StartSession: a "
                 "session that is kept running; may be given again");
  app.add_option("--token-file",
                 flags.token_file,
                 "File with the token that the server wants from the "
                 "dashboard itself; browsers log in with theirs");
  app.add_option("--allow-origin",
                 options.allowed_origins,
                 "Origin besides the dashboard's own whose pages may connect, "
                 "https://HOST[:PORT]; may be given again");
  app.add_flag("--secure-cookie",
               options.secure_cookie,
               "Log-ins over TLS only; for a dashboard behind a TLS proxy");
  app.add_option("--port-file",
                 flags.port_file,
                 "Write the port that is served on to this file");
  app.add_option(
         "--max-viewers", options.viewers.max_viewers, "Browsers at a time")
      ->capture_default_str();
  app.add_option("--stall-timeout",
                 flags.stall_timeout_s,
                 "Seconds after which a browser that takes nothing is "
                 "disconnected")
      ->check(CLI::Range(0.1, 3'600.0))
      ->capture_default_str();
  app.add_option("--max-video-bytes",
                 options.uploads_limits.max_video_bytes,
                 "Largest uploaded video")
      ->capture_default_str();
  app.add_option("--max-map-bytes",
                 options.uploads_limits.max_map_bytes,
                 "Largest uploaded map, all files")
      ->capture_default_str();
  app.add_option("--max-upload-bytes",
                 options.uploads_limits.max_total_bytes,
                 "All uploads together")
      ->capture_default_str();
  app.add_option("--max-recording-bytes",
                 options.max_recording_bytes,
                 "Largest recording")
      ->capture_default_str();
  app.add_option("--max-points",
                 options.max_points,
                 "Points of a map that are shown; beyond, a subsample")
      ->capture_default_str();
  app.add_option("--history",
                 options.history_results,
                 "Results kept per session for pages that come later")
      ->capture_default_str();
  app.add_option("--threads", options.threads, "Threads of the network")
      ->capture_default_str();
  app.add_option("--log-level",
                 flags.log_level,
                 "trace, debug, info, warning, error or off")
      ->check(
          CLI::IsMember({"trace", "debug", "info", "warning", "error", "off"}))
      ->capture_default_str();
  app.add_option("--log-format", flags.log_format, "text or json")
      ->check(CLI::IsMember({"text", "json"}))
      ->capture_default_str();
}

absl::StatusOr<pb::StartSession> ReadStart(const std::string& path) {
  constexpr std::uint64_t kMaxBytes = 64 << 10;
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(path, kMaxBytes));
  pb::StartSession start;
  const auto parsed = google::protobuf::util::JsonStringToMessage(text, &start);
  if (!parsed.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", parsed.ToString()));
  }
  return start;
}

absl::StatusOr<StreamSource> ParseStream(const std::string& text) {
  const std::size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0 || equals + 1 == text.size()) {
    // Without the text: a password may be in it.
    return absl::InvalidArgumentError(
        "--stream: expected NAME=INPUT[,CAMERA.json]");
  }
  StreamSource stream;
  stream.name = text.substr(0, equals);
  stream.input = text.substr(equals + 1);
  const std::size_t comma = stream.input.rfind(',');
  if (comma != std::string::npos && stream.input.ends_with(".json")) {
    stream.camera = stream.input.substr(comma + 1);
    stream.input.resize(comma);
  }
  return stream;
}

// PREFIX/share/groundlock/web of PREFIX/bin/groundlock-dashboard.
fs::path DefaultWeb() {
  std::error_code error;
  const auto program = fs::read_symlink("/proc/self/exe", error);
  if (error) return {};
  return program.parent_path().parent_path() / "share" / "groundlock" / "web";
}

absl::Status Run(Flags flags, const sigset_t& signals) {
  DashboardOptions& options = flags.dashboard;
  options.web = flags.web.empty() ? DefaultWeb() : fs::path(flags.web);
  const fs::path data = flags.data;
  options.recordings = flags.recordings.empty() ? data / "recordings"
                                                : fs::path(flags.recordings);
  options.uploads =
      flags.uploads.empty() ? data / "uploads" : fs::path(flags.uploads);
  options.sources = flags.sources;
  options.viewers.stall_timeout =
      std::chrono::duration_cast<std::chrono::milliseconds>(
          std::chrono::duration<double>(flags.stall_timeout_s));
  for (const std::string& text : flags.streams) {
    ASSIGN_OR_RETURN(StreamSource stream, ParseStream(text));
    options.streams.push_back(std::move(stream));
  }
  for (const std::string& path : flags.starts) {
    ASSIGN_OR_RETURN(pb::StartSession start, ReadStart(path));
    options.start_sessions.push_back(std::move(start));
  }
  if (!flags.token_file.empty()) {
    ASSIGN_OR_RETURN(options.token, sdk::FindToken(flags.token_file));
  }
  if (!fs::exists(options.web / "index.html")) {
    spdlog::warn("no page in {}: it was not built", options.web.string());
  }
  if (!options.https.certificate.empty()) options.secure_cookie = true;
  sdk::ClientTls& tls = options.server.tls;
  tls.enabled = !tls.ca.empty() || !tls.certificate.empty();
  ASSIGN_OR_RETURN(const auto dashboard, Dashboard::Start(options));
  const std::string host = options.listen.substr(0, options.listen.rfind(':'));
  spdlog::info("serving http{}://{}:{} for the server at {}",
               options.https.certificate.empty() ? "" : "s",
               host,
               dashboard->port(),
               options.server.target);
  if (dashboard->metrics_port() != 0) {
    spdlog::info("metrics on port {}", dashboard->metrics_port());
  }
  if (!flags.port_file.empty()) {
    RETURN_IF_ERROR(base::WritePortFile(flags.port_file, dashboard->port()));
  }
  int signal = 0;
  sigwait(&signals, &signal);
  spdlog::info("stopping: {}", signal == SIGTERM ? "SIGTERM" : "SIGINT");
  // From here on a second signal ends the program at once.
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("Groundlock dashboard: see what the tracker sees");
  app.set_version_flag("--version", base::Version());
  Flags flags;
  DefineOptions(app, flags);
  CLI11_PARSE(app, argc, argv);
  base::SetUpLogging(flags.log_level,
                     flags.log_format == "json" ? base::LogFormat::kJson
                                                : base::LogFormat::kText);
  media::QuietMediaLibraries();
  cv::setNumThreads(1);
  // All threads inherit the mask: sigwait alone takes them.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  const absl::Status status = Run(std::move(flags), signals);
  if (!status.ok()) {
    spdlog::error("{}", status.ToString());
    return EXIT_FAILURE;
  }
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace groundlock::dashboard

int main(int argc, char** argv) {
  return groundlock::dashboard::Main(argc, argv);
}
