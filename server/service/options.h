// SPDX-License-Identifier: Apache-2.0
// What the service may be told when it starts, and its limits.
#ifndef GROUNDLOCK_SERVER_SERVICE_OPTIONS_H_
#define GROUNDLOCK_SERVER_SERVICE_OPTIONS_H_

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "server/image/frame.h"
#include "server/service/jwt_verifier.h"
#include "server/service/listener.h"
#include "server/service/open_calls.h"

namespace groundlock::service {

struct SessionLimits {
  int max_sessions = 64;
  int max_targets = 16;   // per session
  int max_watchers = 16;  // per session
  // Frames that wait in front of a session. A live session keeps few, so that
  // what it answers is fresh.
  int lossless_queue_frames = 8;
  int live_queue_frames = 2;
  // Bytes of images that wait in front of a session; one always may.
  std::int64_t max_queued_bytes = 64LL << 20;
  // Of the images of all sessions, wherever they wait (FrameMemory).
  std::int64_t frame_memory_bytes = 2LL << 30;
  // Accepted frames whose answer the client has not taken; beyond, it is held
  // back until it reads.
  int max_unread_answers = 128;
  // Answers kept to be sent again; more than max_unread_answers.
  int kept_answers = 256;
  std::chrono::nanoseconds idle_timeout = std::chrono::minutes(10);
  // A stream through which nothing has come for so long does not keep its
  // session any more.
  std::chrono::nanoseconds stream_idle_timeout = std::chrono::hours(1);
  image::ImageLimits image;
};

struct MapLimits {
  int max_files = 50'000;
  std::uint64_t max_file_bytes = 16ULL << 30;
  std::uint64_t max_total_bytes = 32ULL << 30;
  int max_concurrent_uploads = 8;
  // What one import may take; 0 = half of the machine's memory.
  std::uint64_t import_memory_bytes = 0;
  // Exports that lie on the disk until their clients have them.
  int max_concurrent_exports = 8;
  // An import that takes longer is ended, before the next image that it
  // decodes.
  std::chrono::nanoseconds import_timeout = std::chrono::hours(1);
  // What an upload may last, however steadily it comes: it has one of few
  // places.
  std::chrono::nanoseconds upload_timeout = std::chrono::hours(12);
  // Left on the disk by uploads, for the catalogue and everything else.
  std::uint64_t min_free_bytes = 256ULL << 20;
  // Of maps from videos and photos, each on all cores; 0 = none are built.
  int max_concurrent_builds = 1;
  // A build that takes longer is ended.
  std::chrono::nanoseconds build_timeout = std::chrono::hours(12);
  std::string colmap = "colmap";  // the program that builds need
  // Memory of that program; 0 = as much as the machine has.
  std::uint64_t build_memory_bytes = 0;
};

// Files in PEM form. All empty: no encryption.
struct TlsOptions {
  std::string certificate;  // the server's, with those of its issuers
  std::string key;
  // Whose clients' certificates are believed; empty: none is asked for.
  std::string client_ca;
  bool require_client_certificate = false;
  // How often the files are looked at.
  std::chrono::seconds reload_interval{10};
};

struct ServerOptions {
  // host:port; port 0 = any that is free.
  std::string listen = "127.0.0.1:50551";
  TlsOptions tls;
  // Other machines may connect although there is no TLS, or nothing that tells
  // callers apart.
  bool insecure = false;
  // Where uploads and exports lie meanwhile; created if absent.
  std::string scratch_directory;
  int worker_threads = 0;  // 0 = one per core
  // For imports, exports and single images.
  int background_threads = 2;
  // For what localisers do off the frame path.
  int anchor_threads = 1;
  // Where maps are opened, which takes as long as a database needs to send one.
  int opening_threads = 4;
  // Largest message: a frame's image must fit in.
  int max_message_bytes = 64 << 20;
  // What messages on their way in may take, all clients together. Beyond it
  // gRPC reads more slowly, then breaks streams off.
  std::int64_t receive_memory_bytes = 1LL << 30;
  CallLimits calls;
  ConnectionLimits connections;
  // Images that wait for Localize, all together; one always may.
  std::int64_t max_waiting_image_bytes = 256LL << 20;
  // How long a client may keep a call waiting: for its request, for a stream's
  // first message, for the next piece of an upload, for taking a download's.
  std::chrono::nanoseconds client_silence = std::chrono::seconds(60);
  // Frames, or calls of the catalogue, that wait for so long while none is
  // finished: the server reports itself as not serving. Work that takes longer
  // by its nature is given a multiple.
  std::chrono::nanoseconds stall_timeout = std::chrono::seconds(60);
  // Who may call, and what for: base/token_file.h; read again when it changes.
  std::string token_file;
  // Whose tokens are believed besides.
  JwtOptions jwt;
  // Without that file: any that knows one of them; none = everybody.
  std::vector<std::string> tokens;
  std::string default_localizer = "fast";
  std::string default_tracker = "dcf";
  // Folder with the models of the trackers that need some; empty: none.
  std::string tracker_models;
  SessionLimits sessions;
  MapLimits maps;

  absl::Status Validate() const;  // names field, value and bound
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_OPTIONS_H_
