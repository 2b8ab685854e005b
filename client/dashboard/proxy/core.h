// SPDX-License-Identifier: Apache-2.0
// What the connections share. Internal to the proxy.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_CORE_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_CORE_H_

#include <atomic>
#include <memory>

#include "client/dashboard/proxy/address_places.h"
#include "client/dashboard/proxy/asio.h"
#include "client/dashboard/proxy/audience.h"
#include "client/dashboard/proxy/catalogue.h"
#include "client/dashboard/proxy/dashboard_metrics.h"
#include "client/dashboard/proxy/logins.h"
#include "client/dashboard/proxy/map_jobs.h"
#include "client/dashboard/proxy/options.h"
#include "client/dashboard/proxy/point_clouds.h"
#include "client/dashboard/proxy/recordings.h"
#include "client/dashboard/proxy/session_feed.h"
#include "client/dashboard/proxy/source_runs.h"
#include "client/dashboard/proxy/sources.h"
#include "client/dashboard/proxy/uploads.h"
#include "client/sdk/relay.h"

namespace groundlock::dashboard {

// Outlives every handler that runs. Parts that point to others come after them.
struct Core {
  explicit Core(const DashboardOptions& o)
      : options(o),
        connection_places(o.max_connections_per_address),
        logins(o.max_logins),
        audience(static_cast<std::size_t>(o.viewers.max_viewers)) {}

  // Under way at a time.
  static constexpr int kMaxLoginsOfAddress = 4;
  static constexpr int kMaxLogins = 64;

  const DashboardOptions options;
  // Before what runs: the last connections are counted when it goes.
  std::atomic<int> connections{0};
  std::atomic<int> logins_under_way{0};
  AddressPlaces connection_places;
  AddressPlaces login_places{kMaxLoginsOfAddress};
  DashboardCounters counters;
  asio::io_context io;
  asio::thread_pool work{2};  // what reads and writes files
  Logins logins;
  Audience audience;
  std::unique_ptr<sdk::Relay> relay;
  std::unique_ptr<Uploads> uploads;  // null = none are taken
  std::unique_ptr<Sources> sources;
  std::unique_ptr<Feeds> feeds;
  std::unique_ptr<PointClouds> clouds;
  std::unique_ptr<Recordings> recordings;  // null = nothing is recorded
  std::unique_ptr<SourceRuns> runs;
  std::unique_ptr<MapJobs> jobs;
  std::shared_ptr<Catalogue> catalogue;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_CORE_H_
