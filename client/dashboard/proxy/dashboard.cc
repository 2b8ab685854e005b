// SPDX-License-Identifier: Apache-2.0
#include "client/dashboard/proxy/dashboard.h"

#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "client/dashboard/proxy/core.h"
#include "client/dashboard/proxy/http_connection.h"
#include "client/dashboard/proxy/http_rules.h"
#include "client/dashboard/proxy/session_start.h"
#include "client/dashboard/proxy/tls_front.h"
#include "map_store/base/http_page.h"
#include "map_store/base/loopback.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::dashboard {
namespace {

constexpr int kMaxSourceRuns = 8;
constexpr int kMaxMapJobs = 2;

absl::Status Within(const char* field,
                    std::int64_t value,
                    std::int64_t min,
                    std::int64_t max) {
  if (value >= min && value <= max) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, ": ", value, " is not between ", min, " and ", max));
}

struct Address {
  std::string host;
  int port = 0;
};

absl::StatusOr<Address> ParseAddress(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  Address address;
  if (colon == std::string::npos ||
      !absl::SimpleAtoi(text.substr(colon + 1), &address.port) ||
      address.port < 0 || address.port > 65'535) {
    return absl::InvalidArgumentError(
        absl::StrCat("listen: \"", text, "\" is not HOST:PORT"));
  }
  address.host = text.substr(0, colon);
  if (address.host.size() > 1 && address.host.front() == '[') {
    address.host = address.host.substr(1, address.host.size() - 2);
  }
  return address;
}

// Accepts until the acceptor is closed.
class Listening : public std::enable_shared_from_this<Listening> {
 public:
  explicit Listening(Core* core)
      : core_(core),
        acceptor_(asio::make_strand(core->io)),
        pause_(acceptor_.get_executor()) {}

  absl::Status Open() {
    const HttpsOptions& https = core_->options.https;
    if (!https.certificate.empty()) {
      ASSIGN_OR_RETURN(tls_,
                       TlsFront::Create(https, core_->options.max_connections));
    }
    ASSIGN_OR_RETURN(const Address address,
                     ParseAddress(core_->options.listen));
    error_code error;
    Tcp::resolver resolver(core_->io);
    const auto found = resolver.resolve(
        address.host,
        std::to_string(address.port),
        Tcp::resolver::passive | Tcp::resolver::numeric_service,
        error);
    if (!error && !found.empty()) {
      const Tcp::endpoint endpoint = *found.begin();
      acceptor_.open(endpoint.protocol(), error);
      if (!error) {
        acceptor_.set_option(asio::socket_base::reuse_address(true), error);
      }
      if (!error) acceptor_.bind(endpoint, error);
      if (!error) {
        acceptor_.listen(asio::socket_base::max_listen_connections, error);
      }
      if (!error) port_ = acceptor_.local_endpoint(error).port();
    }
    if (!error) return absl::OkStatus();
    return absl::UnavailableError(absl::StrCat(
        "listen: cannot bind ", core_->options.listen, ": ", error.message()));
  }

  void Accept() {
    acceptor_.async_accept(
        asio::make_strand(core_->io),
        [self = shared_from_this()](error_code error, Tcp::socket socket) {
          self->OnAccepted(error, std::move(socket));
        });
  }

  void Close() {
    asio::post(acceptor_.get_executor(), [self = shared_from_this()] {
      error_code ignored;
      self->acceptor_.close(ignored);
      self->pause_.cancel();
    });
  }
  int port() const { return port_; }

 private:
  void OnAccepted(error_code error, Tcp::socket socket) {
    if (!acceptor_.is_open()) return;
    if (error) {
      // Out of descriptors, say: trying again at once would only burn time.
      pause_.expires_after(std::chrono::milliseconds(100));
      pause_.async_wait([self = shared_from_this()](error_code cancelled) {
        if (!cancelled) self->Accept();
      });
      return;
    }
    error_code gone;
    const std::string network =
        NetworkOf(socket.remote_endpoint(gone).address());
    auto place = core_->connection_places.Take(network);
    if (place == nullptr) {
      socket.close(gone);
      Accept();
      return;
    }
    const auto serve = [core = core_, network, place = std::move(place)](
                           Tcp::socket plain) {
      if (core->connections >= core->options.max_connections) return;
      std::make_shared<HttpConnection>(core, std::move(plain), network, place)
          ->Run();
    };
    if (tls_ != nullptr) {
      tls_->Accept(core_->io, std::move(socket), serve);
    } else {
      serve(std::move(socket));
    }
    Accept();
  }

  Core* const core_;
  Tcp::acceptor acceptor_;
  asio::steady_timer pause_;
  std::unique_ptr<TlsFront> tls_;  // null = HTTP
  int port_ = 0;
};

}  // namespace

absl::Status DashboardOptions::Validate() const {
  RETURN_IF_ERROR(ParseAddress(listen).status());
  if (https.certificate.empty() != https.key.empty()) {
    return absl::InvalidArgumentError(
        "https: a certificate needs its key, and a key its certificate");
  }
  if (!insecure && https.certificate.empty() && !base::IsLoopback(listen)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "listen: other machines reach ",
        listen,
        ", and there is no HTTPS, so that everybody on the way reads the "
        "tokens; give a certificate and its key, or allow it (--tls-cert and "
        "--tls-key, or --insecure)"));
  }
  if (server.target.empty()) return absl::InvalidArgumentError("server: empty");
  for (const pb::StartSession& start : start_sessions) {
    RETURN_IF_ERROR(
        ValidateName(start.session().session_id(), "session.session_id"));
    if (start.source_id().empty()) {
      return absl::InvalidArgumentError("source_id: empty");
    }
  }
  RETURN_IF_ERROR(Within("threads", threads, 1, 64));
  RETURN_IF_ERROR(Within("max_connections", max_connections, 1, 100'000));
  RETURN_IF_ERROR(Within(
      "max_connections_per_address", max_connections_per_address, 0, 100'000));
  RETURN_IF_ERROR(Within("max_logins", max_logins, 1, 1'000'000));
  RETURN_IF_ERROR(Within("history_results", history_results, 1, 1'000'000));
  RETURN_IF_ERROR(Within("poll_interval", poll_interval.count(), 1, 3'600'000));
  RETURN_IF_ERROR(
      Within("viewers.max_viewers", viewers.max_viewers, 1, 100'000));
  RETURN_IF_ERROR(
      Within("viewers.max_subscriptions", viewers.max_subscriptions, 1, 1'000));
  RETURN_IF_ERROR(Within("viewers.max_message_bytes",
                         static_cast<std::int64_t>(viewers.max_message_bytes),
                         1'024,
                         64 << 20));
  RETURN_IF_ERROR(Within(
      "viewers.max_requests_per_s", viewers.max_requests_per_s, 1, 100'000));
  RETURN_IF_ERROR(Within(
      "viewers.max_waiting_results", viewers.max_waiting_results, 1, 100'000));
  RETURN_IF_ERROR(Within(
      "viewers.max_waiting_replies", viewers.max_waiting_replies, 8, 100'000));
  return Within(
      "viewers.stall_timeout", viewers.stall_timeout.count(), 10, 3'600'000);
}

struct Dashboard::Parts {
  explicit Parts(const DashboardOptions& options) : core(options) {}
  Core core;
  std::shared_ptr<Listening> listening;
  std::shared_ptr<Autostart> autostart;
  std::vector<std::thread> threads;
  std::unique_ptr<base::HttpPages> metrics;  // null = none
};

absl::StatusOr<std::unique_ptr<Dashboard>> Dashboard::Start(
    const DashboardOptions& options) {
  RETURN_IF_ERROR(options.Validate());
  auto parts = std::make_unique<Parts>(options);
  Core& core = parts->core;
  parts->listening = std::make_shared<Listening>(&core);
  RETURN_IF_ERROR(parts->listening->Open());
  sdk::ClientOptions relay_options;
  relay_options.tls = options.server.tls;
  ASSIGN_OR_RETURN(core.relay,
                   sdk::Relay::Create(options.server.target, relay_options));
  if (!options.uploads.empty()) {
    ASSIGN_OR_RETURN(core.uploads,
                     Uploads::Open(options.uploads, options.uploads_limits));
  }
  core.sources = std::make_unique<Sources>(
      options.sources, options.streams, core.uploads.get());
  core.feeds = std::make_unique<Feeds>(
      core.io, core.relay.get(), options.history_results, [&core] {
        return core.catalogue->token();
      });
  core.clouds = std::make_unique<PointClouds>(
      core.relay.get(), options.max_points, options.point_cache_bytes);
  if (!options.recordings.empty()) {
    ASSIGN_OR_RETURN(
        core.recordings,
        Recordings::Open(
            options.recordings, options.max_recording_bytes, core.feeds.get()));
  }
  core.runs = std::make_unique<SourceRuns>(options.server, kMaxSourceRuns);
  core.jobs = std::make_unique<MapJobs>(options.server, kMaxMapJobs);
  LocalLists local;
  local.complete = [&core](pb::SessionEntry* entry) {
    const std::string& id = entry->session().session_id();
    if (const auto feed = core.feeds->Find(id)) {
      entry->set_viewers(static_cast<std::uint32_t>(feed->num_sinks()));
    }
    if (core.recordings != nullptr) {
      entry->set_recording(core.recordings->NameOf(id));
      if (!entry->recording().empty() && entry->viewers() > 0) {
        entry->set_viewers(entry->viewers() - 1);  // the recording itself
      }
    }
    if (const auto run = core.runs->StateOf(id)) {
      *entry->mutable_source_run() = *run;
    }
  };
  local.sources = [&core] {
    pb::SourceList list;
    for (const Sources::Found& found : core.sources->List()) {
      *list.add_sources() = found.source;
    }
    return list;
  };
  local.recordings = [&core] {
    return core.recordings == nullptr ? pb::RecordingList()
                                      : core.recordings->List();
  };
  core.catalogue = std::make_shared<Catalogue>(core.io,
                                               core.work,
                                               core.relay.get(),
                                               &core.logins,
                                               &core.audience,
                                               std::move(local),
                                               options.token,
                                               options.poll_interval);
  core.catalogue->Start();
  parts->autostart =
      std::make_shared<Autostart>(&core, options.token, options.start_sessions);
  parts->autostart->Start();
  parts->listening->Accept();
  for (int i = 0; i < options.threads; ++i) {
    parts->threads.emplace_back([&core] {
      const auto guard = asio::make_work_guard(core.io);
      core.io.run();
    });
  }
  if (!options.metrics.empty()) {
    auto pages = base::HttpPages::Start(
        options.metrics,
        {{"/metrics", "text/plain; version=0.0.4; charset=utf-8", [&core] {
            return base::HttpPage::Content{200, MetricsText(core)};
          }}});
    // A dashboard has its threads by now, and must be ended in order.
    std::unique_ptr<Dashboard> dashboard(new Dashboard(std::move(parts)));
    if (!pages.ok()) return base::Annotate(pages.status(), "metrics");
    dashboard->parts_->metrics = *std::move(pages);
    return dashboard;
  }
  return std::unique_ptr<Dashboard>(new Dashboard(std::move(parts)));
}

Dashboard::Dashboard(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}

Dashboard::~Dashboard() {
  Core& core = parts_->core;
  parts_->metrics = nullptr;
  parts_->listening->Close();
  parts_->autostart->Stop();
  core.catalogue->Stop();
  core.feeds->StopAll();
  // No handler runs any more after this; those left are never called.
  core.io.stop();
  for (std::thread& thread : parts_->threads) thread.join();
  core.work.stop();
  core.work.join();
  core.jobs = nullptr;
  core.runs = nullptr;
  // Ends the calls under way and waits for their callbacks.
  core.relay = nullptr;
  core.recordings = nullptr;
}

int Dashboard::port() const { return parts_->listening->port(); }

int Dashboard::metrics_port() const {
  return parts_->metrics == nullptr ? 0 : parts_->metrics->port();
}

int Dashboard::num_viewers() const {
  return static_cast<int>(parts_->core.audience.size());
}

}  // namespace groundlock::dashboard
