// SPDX-License-Identifier: Apache-2.0
// groundlock-server: configuration, wiring, signals.
#include <pthread.h>
#include <sys/resource.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/file.h"
#include "map_store/base/logging.h"
#include "map_store/base/status.h"
#include "map_store/base/version.h"
#include "map_store/decoding/decoder.h"
#include "map_store/features/open_cv_setup.h"
#include "map_store/storage/store.h"
#include "server/app/measured_store.h"
#include "server/app/metrics_exposer.h"
#include "server/app/otlp_exporter.h"
#include "server/app/store_setup.h"
#include "server/service/server.h"
#include "spdlog/spdlog.h"

namespace groundlock::app {
namespace {

struct Options {
  service::ServerOptions server;
  StoreOptions store;
  std::string metrics;
  std::string otlp_endpoint;
  double trace_sample = 0.01;
  std::string port_file;
  std::string log_level = "info";
  std::string log_format = "text";
  double idle_timeout_s = 600.0;
  double stream_idle_timeout_s = 3'600.0;
  double client_timeout_s = 60.0;
  double import_timeout_s = 3'600.0;
  double upload_timeout_s = 43'200.0;
  double build_timeout_s = 43'200.0;
  double stall_timeout_s = 60.0;
  double grace_s = 3.0;
};

std::chrono::nanoseconds Seconds(double seconds) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
      std::chrono::duration<double>(seconds));
}

void DefineOptions(CLI::App& app, Options& options) {
  service::ServerOptions& server = options.server;
  app.set_config("--config", "", "Read options from a TOML or INI file");
  app.add_option("--listen",
                 server.listen,
                 "Address to serve on, HOST:PORT; port 0 = any free one")
      ->capture_default_str();
  DefineStoreOptions(app, options.store);
  app.add_option("--metrics",
                 options.metrics,
                 "Address of the Prometheus endpoint, HOST:PORT; none without");
  app.add_option("--otlp-endpoint",
                 options.otlp_endpoint,
                 "OpenTelemetry collector that traces are sent to, "
                 "http://HOST[:PORT][/PATH]; none without")
      ->type_name("URL");
  app.add_option("--trace-sample",
                 options.trace_sample,
                 "Share of the frames that get spans; calls all do")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--port-file",
                 options.port_file,
                 "Write the port that is served on to this file");
  app.add_option(
         "--token-file",
         options.server.token_file,
         "Who may call, and what for: tokens and certificates (groundlock "
         "token); read again when it changes, and on SIGHUP")
      ->type_name("FILE");
  app.add_option("--jwt-keys",
                 server.jwt.keys,
                 "Folder of keys, KID.pem or KID.secret, whose JSON Web Tokens "
                 "are believed; read again likewise")
      ->type_name("DIR");
  app.add_option("--jwt-issuer", server.jwt.issuer, "Who issues them (iss)");
  app.add_option("--jwt-audience",
                 server.jwt.audience,
                 "Whom they must be meant for (aud)");
  app.add_option("--tls-cert",
                 server.tls.certificate,
                 "Certificate of the server, PEM, with those of its issuers; "
                 "read again when it changes")
      ->type_name("FILE");
  app.add_option("--tls-key", server.tls.key, "Its private key, PEM")
      ->type_name("FILE");
  app.add_option("--tls-client-ca",
                 server.tls.client_ca,
                 "Certificates, PEM, of those who issue clients' certificates")
      ->type_name("FILE");
  app.add_flag("--tls-require-client-cert",
               server.tls.require_client_certificate,
               "Nobody connects without a certificate of --tls-client-ca");
  app.add_flag("--insecure",
               server.insecure,
               "Serve other machines without TLS, or without asking who they "
               "are");
  app.add_option("--workers",
                 server.worker_threads,
                 "Threads that process frames; 0 = one per core")
      ->check(CLI::Range(0, 1'024))
      ->capture_default_str();
  app.add_option("--background-threads",
                 server.background_threads,
                 "Threads for imports and single images")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  app.add_option("--anchor-threads",
                 server.anchor_threads,
                 "Threads for what localizers do off the frame path")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
  app.add_option("--max-builds",
                 server.maps.max_concurrent_builds,
                 "Maps built from videos and photos at a time; 0 = none")
      ->check(CLI::Range(0, 64))
      ->capture_default_str();
  app.add_option("--colmap",
                 server.maps.colmap,
                 "COLMAP's program, which building maps needs")
      ->capture_default_str();
  app.add_option("--import-memory",
                 server.maps.import_memory_bytes,
                 "Memory that one import may take, as its files tell "
                 "beforehand; also as 500MB, 2GB; 0 = half of the machine's")
      ->transform(CLI::AsSizeValue(/*kb_is_1000=*/false))
      ->capture_default_str();
  app.add_option("--build-memory",
                 server.maps.build_memory_bytes,
                 "Memory of each program that a build runs; also as 500MB, "
                 "2GB; 0 = as much as the machine has")
      ->transform(CLI::AsSizeValue(/*kb_is_1000=*/false))
      ->capture_default_str();
  app.add_option("--localizer",
                 server.default_localizer,
                 "Localizer of sessions that name none")
      ->capture_default_str();
  app.add_option("--tracker",
                 server.default_tracker,
                 "Target tracker of sessions that name none")
      ->capture_default_str();
  app.add_option("--tracker-models",
                 server.tracker_models,
                 "Folder with the models of the trackers goturn, dasiamrpn");
  app.add_option(
         "--max-sessions", server.sessions.max_sessions, "Sessions at a time")
      ->check(CLI::Range(1, 100'000))
      ->capture_default_str();
  app.add_option(
         "--max-targets", server.sessions.max_targets, "Targets per session")
      ->check(CLI::Range(1, 1'000))
      ->capture_default_str();
  app.add_option(
         "--max-watchers", server.sessions.max_watchers, "Watchers per session")
      ->check(CLI::Range(0, 10'000))
      ->capture_default_str();
  app.add_option("--max-calls",
                 server.calls.max_calls,
                 "Calls at a time, of all clients")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--max-calls-per-address",
                 server.calls.max_calls_per_address,
                 "Of one IPv4 address, or one IPv6 network of 64 bits; 0 = no "
                 "more than in total")
      ->check(CLI::Range(0, 1'000'000))
      ->capture_default_str();
  app.add_option("--max-connections",
                 server.connections.max_connections,
                 "Connections at a time, of all clients; at most three "
                 "quarters of the files that the process may have open")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--max-connections-per-address",
                 server.connections.max_connections_per_address,
                 "Of one IPv4 address, or one IPv6 network of 64 bits; 0 = no "
                 "more than in total")
      ->check(CLI::Range(0, 1'000'000))
      ->capture_default_str();
  app.add_option("--max-message-bytes",
                 server.max_message_bytes,
                 "Largest message, and so largest image, taken from a client")
      ->check(CLI::Range(2 << 20, 1 << 30))
      ->capture_default_str();
  app.add_option("--max-image-pixels",
                 server.sessions.image.max_pixels,
                 "Largest image that is decoded")
      ->check(CLI::Range(std::int64_t{1}, std::int64_t{1} << 30))
      ->capture_default_str();
  app.add_option("--idle-timeout",
                 options.idle_timeout_s,
                 "Seconds after which a session without a stream expires")
      ->check(CLI::Range(0.001, 1e9))
      ->capture_default_str();
  app.add_option("--stream-idle-timeout",
                 options.stream_idle_timeout_s,
                 "Seconds after which a session expires although it has a "
                 "stream, when nothing comes through it")
      ->check(CLI::Range(0.001, 1e9))
      ->capture_default_str();
  app.add_option("--client-timeout",
                 options.client_timeout_s,
                 "Seconds for which a client may keep a call, an upload or a "
                 "download waiting")
      ->check(CLI::Range(0.001, 1e9))
      ->capture_default_str();
  app.add_option("--upload-timeout",
                 options.upload_timeout_s,
                 "Seconds that sending the files of an import or a build may "
                 "take")
      ->check(CLI::Range(0.001, 1e9))
      ->capture_default_str();
  app.add_option("--import-timeout",
                 options.import_timeout_s,
                 "Seconds after which an import is ended, its upload not "
                 "counted")
      ->check(CLI::Range(0.001, 1e9))
      ->capture_default_str();
  app.add_option("--build-timeout",
                 options.build_timeout_s,
                 "Seconds after which the building of a map is ended")
      ->check(CLI::Range(0.001, 1e9))
      ->capture_default_str();
  app.add_option("--stall-timeout",
                 options.stall_timeout_s,
                 "Seconds without progress after which the server reports "
                 "that it does not serve")
      ->check(CLI::Range(0.001, 1e9))
      ->capture_default_str();
  app.add_option("--frame-memory",
                 server.sessions.frame_memory_bytes,
                 "Memory for the images of all sessions while they wait, half "
                 "of it shared out among them; also as 500MB, 2GB")
      ->transform(CLI::AsSizeValue(/*kb_is_1000=*/false))
      ->capture_default_str();
  app.add_option("--receive-memory",
                 server.receive_memory_bytes,
                 "Memory for messages on their way in, all clients together; "
                 "also as 500MB, 2GB")
      ->transform(CLI::AsSizeValue(/*kb_is_1000=*/false))
      ->capture_default_str();
  app.add_option("--grace",
                 options.grace_s,
                 "Seconds that open calls get to end after SIGTERM")
      ->check(CLI::Range(0.0, 3'600.0))
      ->capture_default_str();
  app.add_option("--log-level",
                 options.log_level,
                 "trace, debug, info, warning, error or off")
      ->check(
          CLI::IsMember({"trace", "debug", "info", "warning", "error", "off"}))
      ->capture_default_str();
  app.add_option("--log-format", options.log_format, "text or json")
      ->check(CLI::IsMember({"text", "json"}))
      ->capture_default_str();
}

// SIGTERM and SIGINT are taken by sigwait in the main thread; all threads
// started later inherit the mask, so that no other one is interrupted.
sigset_t BlockSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGHUP);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  return signals;
}

// An import in work cannot be interrupted, and it need not be: publishing is
// atomic, and what it leaves in the scratch directory goes at the next start.
class ExitGuard {
 public:
  explicit ExitGuard(std::chrono::duration<double> limit)
      : thread_([this, limit] {
          const auto end = std::chrono::steady_clock::now() + limit;
          while (!done_ && std::chrono::steady_clock::now() < end) {
            std::this_thread::sleep_for(std::chrono::milliseconds(20));
          }
          if (done_) return;
          spdlog::warn("work in the background goes on: leaving without it");
          std::_Exit(EXIT_SUCCESS);
        }) {}
  ~ExitGuard() {
    done_ = true;
    thread_.join();
  }
  ExitGuard(const ExitGuard&) = delete;
  ExitGuard& operator=(const ExitGuard&) = delete;

 private:
  std::atomic<bool> done_{false};
  std::thread thread_;
};

// How often what nobody needs any more is looked for.
constexpr std::chrono::minutes kTidyInterval(1);

// Some megabytes: what a collector that is away for a moment may miss.
constexpr std::size_t kMaxWaitingSpans = 8'192;

// What tells this server from others in a collector.
std::string InstanceName() {
  char host[256] = "";
  gethostname(host, sizeof(host) - 1);
  return absl::StrCat(host, ":", getpid());
}

// As many files as the system allows: a shell's 1,024 are few connections, and
// the lower limit is only there for programs that use select().
void RaiseFileLimit() {
  rlimit files{};
  if (getrlimit(RLIMIT_NOFILE, &files) != 0) return;
  files.rlim_cur = files.rlim_max;
  setrlimit(RLIMIT_NOFILE, &files);
}

absl::Status Run(Options options, const sigset_t& signals) {
  RaiseFileLimit();
  ASSIGN_OR_RETURN(auto opened, OpenStore(options.store));
  const auto store = std::make_unique<MeasuredStore>(std::move(opened));
  spdlog::info("store: {}", store->Description());
  if (options.store.check) return CheckStore(*store);
  options.server.scratch_directory = ScratchDirectory(options.store);
  service::ServerOptions& limits = options.server;
  limits.sessions.idle_timeout = Seconds(options.idle_timeout_s);
  limits.sessions.stream_idle_timeout = Seconds(options.stream_idle_timeout_s);
  limits.client_silence = Seconds(options.client_timeout_s);
  limits.maps.import_timeout = Seconds(options.import_timeout_s);
  limits.maps.upload_timeout = Seconds(options.upload_timeout_s);
  limits.maps.build_timeout = Seconds(options.build_timeout_s);
  limits.stall_timeout = Seconds(options.stall_timeout_s);
  service::Metrics metrics;
  service::SpanQueue spans(options.trace_sample, kMaxWaitingSpans);
  std::unique_ptr<OtlpExporter> exporter;
  if (!options.otlp_endpoint.empty()) {
    ASSIGN_OR_RETURN(
        exporter,
        OtlpExporter::Start(options.otlp_endpoint, InstanceName(), &spans));
    metrics.spans = &spans;
  }
  std::unique_ptr<MetricsExposer> exposer;
  if (!options.metrics.empty()) {
    ASSIGN_OR_RETURN(
        exposer,
        MetricsExposer::Start(options.metrics,
                              {&metrics, store.get(), exporter.get()}));
  }
  ASSIGN_OR_RETURN(
      auto server,
      service::GroundlockServer::Start(options.server, store.get(), &metrics));
  auto janitor = std::make_unique<StoreJanitor>(
      store.get(), &metrics, options.store.keep_versions, kTidyInterval);
  const std::string host =
      options.server.listen.substr(0, options.server.listen.rfind(':'));
  if (exposer != nullptr) {
    spdlog::info("metrics on port {}", exposer->port());
  }
  spdlog::info("listening on {}:{}", host, server->port());
  if (!options.port_file.empty()) {
    RETURN_IF_ERROR(base::WritePortFile(options.port_file, server->port()));
  }

  int signal = 0;
  for (sigwait(&signals, &signal); signal == SIGHUP;
       sigwait(&signals, &signal)) {
    spdlog::info("SIGHUP: reading again who may call");
    server->ReloadAccess();
  }
  spdlog::info("stopping: {}", signal == SIGTERM ? "SIGTERM" : "SIGINT");
  // From here on a second signal ends the program at once.
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  const std::chrono::duration<double> grace(options.grace_s);
  {
    const ExitGuard guard(grace + std::chrono::seconds(2));
    server->Shutdown(
        std::chrono::duration_cast<std::chrono::milliseconds>(grace));
    server = nullptr;
    janitor = nullptr;
  }
  spdlog::info("stopped");
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  CLI::App app("Groundlock server: keeps a lock on things that move");
  app.set_version_flag("--version", base::Version());
  Options options;
  DefineOptions(app, options);
  CLI11_PARSE(app, argc, argv);
  base::SetUpLogging(options.log_level,
                     options.log_format == "json" ? base::LogFormat::kJson
                                                  : base::LogFormat::kText);
  const sigset_t signals = BlockSignals();
  const absl::Status status = Run(options, signals);
  if (!status.ok()) {
    spdlog::error("{}", status.ToString());
    return EXIT_FAILURE;
  }
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace groundlock::app

int main(int argc, char** argv) {
  groundlock::features::SetUpOpenCv();
  // What decodes strangers' media is this program, too.
  if (const auto status = groundlock::decoding::RunDecoderIfAsked(argc, argv)) {
    return *status;
  }
  return groundlock::app::Main(argc, argv);
}
