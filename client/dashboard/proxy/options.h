// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_OPTIONS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_OPTIONS_H_

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/dashboard/proxy/server_address.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"

namespace groundlock::dashboard {

struct ViewerLimits {
  int max_viewers = 64;
  int max_subscriptions = 4;  // sessions that one viewer follows at a time
  std::uint64_t max_message_bytes = 64 << 10;  // of a request
  int max_requests_per_s = 50;                 // beyond: refused
  // What may wait for a viewer, besides one image per session.
  int max_waiting_results = 240;
  int max_waiting_replies = 256;
  // A viewer that takes nothing for so long is disconnected.
  std::chrono::milliseconds stall_timeout{15'000};
};

struct UploadLimits {
  std::uint64_t max_video_bytes = std::uint64_t{8} << 30;
  std::uint64_t max_map_bytes = std::uint64_t{16} << 30;
  std::uint32_t max_map_files = 50'000;
  std::uint64_t max_total_bytes = std::uint64_t{32} << 30;
  int max_uploads = 64;
};

// A network stream or camera device that pages may start sessions from.
struct StreamSource {
  std::string name;
  std::string input;  // as groundlock track takes it: rtsp://..., /dev/video0
  std::filesystem::path camera;  // camera.json; empty = the page tells
};

// Files in PEM form; both empty: HTTP.
struct HttpsOptions {
  std::string certificate;  // with those of its issuers
  std::string key;
  // How often the files are looked at, when somebody connects.
  std::chrono::milliseconds reload_interval{10'000};
};

struct DashboardOptions {
  std::string listen = "127.0.0.1:8080";  // HOST:PORT; port 0 = any free one
  HttpsOptions https;
  // Other machines may connect although there is no HTTPS.
  bool insecure = false;
  // HOST:PORT of a page for Prometheus, plain HTTP; empty = none. Not on
  // `listen`: what it tells is not for viewers.
  std::string metrics;
  ServerAddress server;
  std::filesystem::path web;         // the built page; empty = none
  std::filesystem::path recordings;  // empty = no recording
  std::filesystem::path uploads;     // empty = no uploads
  std::filesystem::path sources;     // empty = no folder of videos
  std::vector<StreamSource> streams;
  // Origins besides the dashboard's own whose pages may connect, such as
  // https://dashboard.example.org behind a proxy.
  std::vector<std::string> allowed_origins;
  // The cookie is sent over TLS only; for dashboards behind a TLS proxy.
  bool secure_cookie = false;
  // The dashboard's own token, for what it does by itself; empty = none.
  // Viewers log in with theirs all the same.
  std::string token;
  // Sessions that it starts and keeps running, each with a session_id.
  std::vector<groundlock::dashboard::v1::StartSession> start_sessions;
  int threads = 2;
  int max_connections = 512;
  // Of one IPv4 address, or of one IPv6 network of 64 bits; 0 = no more than in
  // total, as behind a proxy, which has one address for everybody.
  int max_connections_per_address = 128;
  int max_logins = 1'000;
  std::uint64_t max_recording_bytes = std::uint64_t{16} << 30;
  std::uint64_t max_points = 2'000'000;  // of a point cloud
  std::uint64_t point_cache_bytes = std::uint64_t{256} << 20;
  int history_results = 7'200;  // kept per session: five minutes at 24 Hz
  std::chrono::milliseconds poll_interval{1'000};
  ViewerLimits viewers;
  UploadLimits uploads_limits;

  absl::Status Validate() const;  // names field, value and bound
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_OPTIONS_H_
