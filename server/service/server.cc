// SPDX-License-Identifier: Apache-2.0
#include "server/service/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/resource_quota.h>

#include <algorithm>
#include <thread>
#include <utility>

#include "map_store/base/loopback.h"
#include "map_store/base/status.h"
#include "server/service/access.h"
#include "server/service/background_executor.h"
#include "server/service/call_watch.h"
#include "server/service/gate.h"
#include "server/service/health_service.h"
#include "server/service/listener.h"
#include "server/service/map_service.h"
#include "server/service/open_calls.h"
#include "server/service/scratch_space.h"
#include "server/service/tls.h"
#include "server/service/tracking_service.h"
#include "server/service/watchdog.h"
#include "server/service/whole_messages.h"
#include "server/service/worker_pool.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {
namespace {

// Calls that may wait for an executor; each holds at most one message.
constexpr int kMaxWaitingCalls = 256;

absl::Status AtLeast(const char* field, std::int64_t value, std::int64_t min) {
  if (value >= min) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, ": ", value, " is below ", min));
}

}  // namespace

absl::Status ServerOptions::Validate() const {
  if (listen.empty()) return absl::InvalidArgumentError("listen: empty");
  if (scratch_directory.empty()) {
    return absl::InvalidArgumentError("scratch_directory: empty");
  }
  if (tls.certificate.empty() != tls.key.empty()) {
    return absl::InvalidArgumentError(
        "tls: a certificate needs its key, and a key its certificate");
  }
  if (tls.certificate.empty() && !tls.client_ca.empty()) {
    return absl::InvalidArgumentError(
        "tls.client_ca: needs a certificate of the server's own");
  }
  if (tls.client_ca.empty() && tls.require_client_certificate) {
    return absl::InvalidArgumentError(
        "tls.require_client_certificate: needs a client_ca");
  }
  RETURN_IF_ERROR(
      AtLeast("tls.reload_interval", tls.reload_interval.count(), 1));
  if (!insecure && !base::IsLoopback(listen)) {
    if (tls.certificate.empty()) {
      return absl::InvalidArgumentError(absl::StrCat(
          "listen: other machines reach ",
          listen,
          ", and there is no TLS; give a certificate and its key, or allow it "
          "(--tls-cert and --tls-key, or --insecure)"));
    }
    if (tokens.empty() && token_file.empty() && jwt.keys.empty() &&
        !tls.require_client_certificate) {
      return absl::InvalidArgumentError(absl::StrCat(
          "listen: other machines reach ",
          listen,
          ", and everybody there may do everything; want tokens or clients' "
          "certificates, or allow it (--token-file, or --jwt-keys, or "
          "--tls-client-ca and --tls-require-client-cert, or --insecure)"));
    }
  }
  if (!tokens.empty() && !token_file.empty()) {
    return absl::InvalidArgumentError("tokens: not with a token_file");
  }
  if (jwt.keys.empty() != jwt.issuer.empty() ||
      jwt.keys.empty() != jwt.audience.empty()) {
    return absl::InvalidArgumentError(
        "jwt: keys, issuer and audience go together");
  }
  RETURN_IF_ERROR(AtLeast("worker_threads", worker_threads, 0));
  RETURN_IF_ERROR(AtLeast("background_threads", background_threads, 1));
  RETURN_IF_ERROR(AtLeast("max_message_bytes", max_message_bytes, 2 << 20));
  RETURN_IF_ERROR(AtLeast("anchor_threads", anchor_threads, 1));
  RETURN_IF_ERROR(AtLeast("max_sessions", sessions.max_sessions, 1));
  RETURN_IF_ERROR(AtLeast("max_targets", sessions.max_targets, 1));
  RETURN_IF_ERROR(AtLeast("max_watchers", sessions.max_watchers, 0));
  RETURN_IF_ERROR(
      AtLeast("lossless_queue_frames", sessions.lossless_queue_frames, 1));
  RETURN_IF_ERROR(AtLeast("live_queue_frames", sessions.live_queue_frames, 1));
  RETURN_IF_ERROR(
      AtLeast("max_unread_answers", sessions.max_unread_answers, 1));
  RETURN_IF_ERROR(AtLeast(
      "kept_answers", sessions.kept_answers, sessions.max_unread_answers + 1));
  RETURN_IF_ERROR(AtLeast("idle_timeout", sessions.idle_timeout.count(), 1));
  RETURN_IF_ERROR(
      AtLeast("stream_idle_timeout", sessions.stream_idle_timeout.count(), 1));
  RETURN_IF_ERROR(AtLeast("opening_threads", opening_threads, 1));
  RETURN_IF_ERROR(AtLeast("receive_memory_bytes",
                          receive_memory_bytes,
                          std::int64_t{2} * max_message_bytes));
  // A frame as large as a message may be, one before it and one in work.
  RETURN_IF_ERROR(AtLeast("frame_memory_bytes",
                          sessions.frame_memory_bytes,
                          std::int64_t{6} * max_message_bytes));
  RETURN_IF_ERROR(AtLeast("max_calls", calls.max_calls, 1));
  RETURN_IF_ERROR(
      AtLeast("max_calls_per_address", calls.max_calls_per_address, 0));
  RETURN_IF_ERROR(AtLeast("max_connections", connections.max_connections, 1));
  RETURN_IF_ERROR(AtLeast("max_connections_per_address",
                          connections.max_connections_per_address,
                          0));
  RETURN_IF_ERROR(
      AtLeast("max_waiting_image_bytes", max_waiting_image_bytes, 0));
  RETURN_IF_ERROR(AtLeast("client_silence", client_silence.count(), 1));
  RETURN_IF_ERROR(AtLeast("stall_timeout", stall_timeout.count(), 1));
  RETURN_IF_ERROR(AtLeast("max_files", maps.max_files, 1));
  RETURN_IF_ERROR(
      AtLeast("max_concurrent_uploads", maps.max_concurrent_uploads, 1));
  RETURN_IF_ERROR(
      AtLeast("max_concurrent_builds", maps.max_concurrent_builds, 0));
  RETURN_IF_ERROR(
      AtLeast("max_concurrent_exports", maps.max_concurrent_exports, 1));
  RETURN_IF_ERROR(AtLeast("import_timeout", maps.import_timeout.count(), 1));
  RETURN_IF_ERROR(AtLeast("upload_timeout", maps.upload_timeout.count(), 1));
  RETURN_IF_ERROR(AtLeast("build_timeout", maps.build_timeout.count(), 1));
  return absl::OkStatus();
}

// In the order of their making; gone in the opposite one, after Shutdown.
struct GroundlockServer::Parts {
  std::unique_ptr<Access> access;
  std::unique_ptr<ScratchSpace> scratch;
  // Before the pool: frames wait for what it does.
  // Of cameras without a pose, and of those that are followed.
  std::unique_ptr<BackgroundExecutor> searches;
  std::unique_ptr<BackgroundExecutor> anchors;
  std::unique_ptr<WorkerPool> pool;

  std::unique_ptr<SessionManager> sessions;
  std::unique_ptr<BackgroundExecutor> disk;
  std::unique_ptr<BackgroundExecutor> opening;
  std::unique_ptr<BackgroundExecutor> heavy;
  std::unique_ptr<BackgroundExecutor> builds;
  std::unique_ptr<CallWatch> calls;
  std::unique_ptr<OpenCalls> open_calls;
  std::unique_ptr<WholeMessages> whole_messages;
  std::unique_ptr<TrackingService> tracking;
  std::unique_ptr<MapService> maps;
  std::unique_ptr<HealthService> health;
  std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> connections;
  std::unique_ptr<grpc::Server> server;
  std::unique_ptr<Listener> listener;
  std::unique_ptr<Watchdog> watchdog;
  Metrics* metrics = nullptr;
  int port = 0;
  bool shut_down = false;

  std::unique_ptr<Watchdog> MakeWatchdog(const ServerOptions& options);
};

std::unique_ptr<Watchdog> GroundlockServer::Parts::MakeWatchdog(
    const ServerOptions& options) {
  // A year of it is for ever, and a multiple of that still a number.
  const auto patience = std::min<std::chrono::nanoseconds>(
      options.stall_timeout, std::chrono::hours(24 * 365));
  const auto charge =
      [](const char* name, const auto& work, std::chrono::nanoseconds limit) {
        return Watchdog::Charge{
            name, [work = work.get()] { return work->progress(); }, limit};
      };
  // Anchors give way to frames; maps come from a database; an import may take
  // as long as it may, and is no stall. Builds wait for nobody: what is not
  // begun at once is refused.
  return std::make_unique<Watchdog>(
      std::vector<Watchdog::Charge>{
          charge("frames", pool, patience),
          charge("disk", disk, patience),
          charge("searches", searches, patience),
          charge("anchors", anchors, 10 * patience),
          charge("opening", opening, 10 * patience),
          charge("heavy", heavy, options.maps.import_timeout + 10 * patience)},
      [this](const std::string& standing) {
        if (standing.empty()) {
          spdlog::warn("watchdog: all work goes on again");
        } else {
          spdlog::error("watchdog: not serving: {}", standing);
        }
        metrics->stalled = standing.empty() ? 0 : 1;
        metrics->serving = standing.empty() ? 1 : 0;
        health->SetServing(standing.empty());
      });
}

absl::StatusOr<std::unique_ptr<GroundlockServer>> GroundlockServer::Start(
    const ServerOptions& options,
    storage::Store* store,
    Metrics* metrics,
    CoreFactory factory) {
  RETURN_IF_ERROR(options.Validate());
  ASSIGN_OR_RETURN(const auto credentials, MakeServerCredentials(options.tls));
  auto parts = std::make_unique<Parts>();
  ASSIGN_OR_RETURN(
      parts->access,
      Access::Create({options.token_file, options.tokens, options.jwt},
                     &metrics->over_quota));
  parts->searches = std::make_unique<BackgroundExecutor>(
      "gl-searches", options.anchor_threads, kMaxWaitingCalls);
  parts->anchors =
      std::make_unique<BackgroundExecutor>("gl-anchors",
                                           options.anchor_threads,
                                           kMaxWaitingCalls,
                                           BackgroundExecutor::Priority::kLow);
  if (factory == nullptr) {
    factory = [searches = parts->searches.get(),
               anchors = parts->anchors.get()](
                  std::shared_ptr<const map::Map> map,
                  const geometry::CameraModel& camera,
                  const tracking::SessionOptions& session) {
      return tracking::TrackingSession::Create(
          std::move(map),
          camera,
          session,
          [=](localization::Urgency urgency, auto task) {
            const bool is_urgent = urgency == localization::Urgency::kNow;
            (is_urgent ? searches : anchors)->Post(std::move(task));
          });
    };
  }

  ASSIGN_OR_RETURN(parts->scratch,
                   ScratchSpace::Open(options.scratch_directory));
  const int workers = options.worker_threads > 0
                          ? options.worker_threads
                          : std::max(1U, std::thread::hardware_concurrency());
  parts->pool = std::make_unique<WorkerPool>(workers);
  parts->sessions = std::make_unique<SessionManager>(
      options.sessions, std::move(factory), parts->pool.get(), metrics);
  parts->disk =
      std::make_unique<BackgroundExecutor>("gl-disk", 2, kMaxWaitingCalls);
  parts->opening = std::make_unique<BackgroundExecutor>(
      "gl-opening", options.opening_threads, kMaxWaitingCalls);
  parts->heavy =
      std::make_unique<BackgroundExecutor>("gl-heavy",
                                           options.background_threads,
                                           kMaxWaitingCalls,
                                           BackgroundExecutor::Priority::kLow);
  parts->builds =
      std::make_unique<BackgroundExecutor>("gl-builds",
                                           options.maps.max_concurrent_builds,
                                           kMaxWaitingCalls,
                                           BackgroundExecutor::Priority::kLow);
  // Often enough that a silent client gets a quarter more time at most.
  parts->calls = std::make_unique<CallWatch>(std::min<std::chrono::nanoseconds>(
      options.client_silence / 4, std::chrono::seconds(1)));
  parts->open_calls = std::make_unique<OpenCalls>(
      options.calls, &metrics->calls, &metrics->calls_over_limit);
  parts->whole_messages = std::make_unique<WholeMessages>();
  const Gate gate{parts->access.get(),
                  parts->calls.get(),
                  parts->open_calls.get(),
                  parts->whole_messages.get(),
                  metrics,
                  store,
                  options.client_silence};
  parts->calls->Add(parts->access.get());
  parts->tracking = std::make_unique<TrackingService>(
      options,
      gate,
      parts->sessions.get(),
      Executors{parts->disk.get(), parts->opening.get(), parts->heavy.get()},
      metrics);
  ImportContext import;
  import.limits = options.maps;
  import.scratch = parts->scratch.get();
  import.disk = parts->disk.get();
  import.heavy = parts->heavy.get();
  import.metrics = metrics;
  parts->maps = std::make_unique<MapService>(
      import, gate, parts->builds.get(), parts->opening.get());

  parts->health = std::make_unique<HealthService>(
      gate,
      std::vector<std::string>{"groundlock.v1.TrackingService",
                               "groundlock.v1.MapService"});
  // It cannot be asked for a token.
  if (parts->access->open_to_all()) {
    grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  }
  // What a sender is held back with, whole messages among it, counts as sent
  // half: nobody has read it. The other half is for what comes between two
  // looks, and for messages that are being read.
  const PartialMessageLimit partial{parts->whole_messages.get(),
                                    options.receive_memory_bytes / 2,
                                    options.client_silence};
  grpc::ServerBuilder builder;
  if (options.listen.starts_with("unix:")) {
    // Bounded by who may open the file.
    builder.AddListeningPort(options.listen, credentials, &parts->port);
  } else {
    ASSIGN_OR_RETURN(parts->listener,
                     Listener::Bind(options.listen,
                                    options.connections,
                                    partial,
                                    {&metrics->connections,
                                     &metrics->connections_over_limit,
                                     &metrics->connections_ended}));
    parts->port = parts->listener->port();
  }
  parts->connections = builder.experimental().AddExternalConnectionAcceptor(
      grpc::ServerBuilder::experimental_type::ExternalConnectionType::FROM_FD,
      credentials);
  builder.RegisterService(parts->tracking.get());
  builder.RegisterService(parts->maps.get());
  builder.RegisterService(parts->health.get());
  builder.SetMaxReceiveMessageSize(options.max_message_bytes);
  builder.SetMaxSendMessageSize(options.max_message_bytes);
  // A client that vanished without a word is noticed within half a minute.
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  builder.AddChannelArgument(
      GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, 5'000);
  // A connection that does not get beyond its handshake.
  builder.AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, 20'000);
  // One on which nobody calls any more; clients make another when they do.
  builder.AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, 5 * 60'000);
  builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS,
                             options.calls.StreamsPerConnection());
  builder.SetResourceQuota(
      grpc::ResourceQuota("groundlock-server")
          .Resize(static_cast<std::size_t>(options.receive_memory_bytes)));
  parts->server = builder.BuildAndStart();
  if (parts->server == nullptr || parts->port == 0) {
    return absl::UnavailableError(
        absl::StrCat("listen: cannot bind ", options.listen));
  }
  if (parts->listener != nullptr) {
    parts->listener->Start([connections = parts->connections.get()](
                               int listener_fd, int fd) {
      grpc::experimental::ExternalConnectionAcceptor::NewConnectionParameters
          connection;
      connection.listener_fd = listener_fd;
      connection.fd = fd;
      connections->HandleNewConnection(&connection);
    });
  }
  parts->metrics = metrics;
  const auto progress = [](const auto& work) {
    return [work = work.get()] { return work->progress(); };
  };
  metrics->queues.Set({{"frames", progress(parts->pool)},
                       {"searches", progress(parts->searches)},
                       {"anchors", progress(parts->anchors)},
                       {"disk", progress(parts->disk)},
                       {"opening", progress(parts->opening)},
                       {"heavy", progress(parts->heavy)},
                       {"builds", progress(parts->builds)}});
  metrics->serving = 1;
  parts->watchdog = parts->MakeWatchdog(options);
  return std::unique_ptr<GroundlockServer>(
      new GroundlockServer(std::move(parts)));
}

GroundlockServer::GroundlockServer(std::unique_ptr<Parts> parts)
    : parts_(std::move(parts)) {}

GroundlockServer::~GroundlockServer() {
  Shutdown(std::chrono::milliseconds(0));
  parts_->server = nullptr;
  // What still waits finds its calls cancelled.
  parts_->calls = nullptr;
  parts_->builds = nullptr;
  parts_->heavy = nullptr;
  parts_->opening = nullptr;
  parts_->disk = nullptr;
  parts_->sessions = nullptr;
  parts_->pool = nullptr;
}

void GroundlockServer::ReloadAccess() { parts_->access->Reload(); }

int GroundlockServer::port() const { return parts_->port; }

void GroundlockServer::Shutdown(std::chrono::milliseconds grace) {
  if (std::exchange(parts_->shut_down, true)) return;
  parts_->watchdog = nullptr;
  parts_->metrics->queues.Set({});
  parts_->metrics->serving = 0;
  parts_->listener = nullptr;
  parts_->health->Shutdown();
  parts_->sessions->Drain();
  parts_->server->Shutdown(std::chrono::system_clock::now() + grace);
}

}  // namespace groundlock::service
