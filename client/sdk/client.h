// SPDX-License-Identifier: Apache-2.0
// The C++ client of a Groundlock server. Errors carry the server's own code and
// message, which name the field, file or frame at fault.
#ifndef GROUNDLOCK_CLIENT_SDK_CLIENT_H_
#define GROUNDLOCK_CLIENT_SDK_CLIENT_H_

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/sdk/tracking_stream.h"
#include "client/sdk/types.h"

namespace groundlock::sdk {

// Which build of this client it is, version and commit: "0.1.0 (1a2b3c4d5e6f)".
const char* Version();

// Encryption towards the server. Files in PEM form.
struct ClientTls {
  bool enabled = false;      // also by a target "grpcs://HOST:PORT"
  std::filesystem::path ca;  // who issued the server's; empty = the system's
  // The client's own certificate and its key, for servers that ask for one.
  std::filesystem::path certificate;
  std::filesystem::path key;
  // The name in the server's certificate, if it is not the target's host.
  std::string server_name;
};

struct ClientOptions {
  // How long Connect waits for the server.
  std::chrono::milliseconds connect_timeout{5'000};
  // Deadline of quick calls (not of imports, exports, point clouds, Localize).
  std::chrono::milliseconds call_timeout{30'000};
  // Largest message taken from the server.
  int max_message_bytes = 64 << 20;
  ClientTls tls;
  // Sent along with every call; empty = none. Without TLS it goes over the
  // network as it is.
  std::string token;
  absl::Status Validate() const;  // names field, value and bound
};

// The token to use: the first line of `file`; if that is empty, the value of
// the environment's GROUNDLOCK_TOKEN; empty if there is none. kNotFound,
// kInvalidArgument (no token in the file).
absl::StatusOr<std::string> FindToken(const std::filesystem::path& file);

// Bytes done of bytes expected; returning false cancels the transfer
// (kCancelled). An export's `total` grows as its files are announced.
using Progress = std::function<bool(std::uint64_t done, std::uint64_t total)>;

// A build's stage ("uploading", then those of the server), how much of it is
// done (0 to 1), and perhaps a word on it; returning false cancels the build.
// Called again and again from the calling thread.
using BuildProgress = std::function<bool(
    std::string_view stage, double fraction, const std::string& note)>;

// One connection, shared by all calls. Thread-safe. Streams and watchers keep
// the connection alive by themselves and may outlive the client.
class Client {
 public:
  // target: "host:port", "grpc://host:port", or "grpcs://host:port" for TLS.
  // kUnavailable if nobody answers in time, or TLS finds no agreement;
  // kNotFound, kInvalidArgument: files of options.tls.
  static absl::StatusOr<std::unique_ptr<Client>> Connect(
      const std::string& target, const ClientOptions& options = {});
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  // Maps.
  // Uploads the files and waits for the import. kNotFound names a local file
  // that is missing. After the last byte, `progress` is called again and again
  // with done == total until the server has finished.
  absl::StatusOr<ImportReport> ImportMap(const ImportRequest& request,
                                         const Progress& progress = nullptr);
  // Uploads a video or photos, has the server build a map of them, and waits.
  // kNotFound as above; kFailedPrecondition says why they make no map.
  absl::StatusOr<BuildReport> BuildMap(const BuildRequest& request,
                                       const BuildProgress& progress = nullptr);
  absl::StatusOr<std::vector<MapInfo>> ListMaps();
  absl::StatusOr<MapInfo> GetMap(const std::string& name,
                                 std::uint64_t version = 0);
  absl::Status DeleteMap(const std::string& name);
  // max_points: 0 = all, else an even subsample.
  absl::StatusOr<PointCloud> GetPointCloud(const std::string& name,
                                           std::uint64_t version = 0,
                                           std::uint64_t max_points = 0);
  // Writes the files to `path`, as formats::Export would (a folder for COLMAP,
  // a file otherwise). kAlreadyExists if there is something; nothing is left
  // there on failure. What the format could not express exactly is added to
  // `warnings`, if given. `progress` is called with 0 of 0 while the server
  // makes the files.
  absl::Status ExportMap(const std::string& name,
                         std::uint64_t version,
                         MapExportFormat format,
                         const std::filesystem::path& path,
                         const Progress& progress = nullptr,
                         std::vector<std::string>* warnings = nullptr);

  // Publishes the map in another world, or (report_only) tells what it would
  // be.
  absl::StatusOr<AlignReport> AlignMap(const AlignRequest& request);
  absl::StatusOr<MapCheck> CheckMap(const std::string& name,
                                    std::uint64_t version = 0);

  absl::StatusOr<Caller> GetCaller();

  // Sessions.
  absl::StatusOr<SessionInfo> CreateSession(const SessionSpec& spec);
  absl::StatusOr<std::vector<SessionInfo>> ListSessions();
  absl::StatusOr<SessionInfo> GetSession(const std::string& session_id);
  absl::Status DeleteSession(const std::string& session_id);

  // Targets.
  // target_id: empty = made up by the server. sequence: the frame in which the
  // box holds, not yet processed; unset = the next that is. body: what is known
  // of it; kInvalidArgument: there is no such kind. Returns the id.
  absl::StatusOr<std::string> SetTarget(
      const std::string& session_id,
      const std::string& target_id,
      const geometry::Box2& box_px,
      std::optional<std::uint64_t> sequence = std::nullopt,
      const TargetBody& body = {});
  absl::Status MoveTarget(const std::string& session_id,
                          const std::string& target_id,
                          const geometry::Box2& box_px);
  absl::Status DropTarget(const std::string& session_id,
                          const std::string& target_id);

  // Frames.
  // kNotFound if the session does not exist.
  absl::StatusOr<std::unique_ptr<TrackingStream>> Track(
      const std::string& session_id, const TrackingStreamOptions& options = {});
  // image_width_px: how wide images are going to be shown; 0 = not known. Raw
  // frames at least twice as wide come smaller, but not narrower.
  absl::StatusOr<std::unique_ptr<SessionWatcher>> Watch(
      const std::string& session_id,
      bool include_images,
      std::uint32_t image_width_px = 0);
  absl::StatusOr<LocalizeReport> Localize(const LocalizeSpec& spec);

 private:
  struct Connection;
  explicit Client(std::shared_ptr<Connection> connection);
  std::shared_ptr<Connection> connection_;
};

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_CLIENT_H_
