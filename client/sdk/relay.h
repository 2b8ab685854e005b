// SPDX-License-Identifier: Apache-2.0
// The service's calls in its own messages and without waiting: for programs
// that pass messages on for several callers, such as the dashboard.
#ifndef GROUNDLOCK_CLIENT_SDK_RELAY_H_
#define GROUNDLOCK_CLIENT_SDK_RELAY_H_

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/sdk/client.h"
#include "groundlock/v1/maps.pb.h"
#include "groundlock/v1/tracking.pb.h"

namespace groundlock::sdk {

// Called once, from a thread of gRPC's: it must not wait, nor destroy the
// relay.
template <typename Response>
using Reply = std::function<void(absl::StatusOr<Response>)>;

// A session that is being watched. Thread-safe.
class RelayedWatch {
 public:
  virtual ~RelayedWatch() = default;
  // Asks for the next message, once the last one has been dealt with: whoever
  // does not ask holds the server back, which then leaves results out.
  virtual void Continue() = 0;
  virtual void Cancel() = 0;
};

// One connection for all callers, each of which brings its own token (empty =
// none). Connects when it is used and again when the connection is lost; calls
// fail with kUnavailable meanwhile. Thread-safe.
class Relay {
 public:
  // target: as for Client::Connect. Does not wait for the server. options.token
  // must be empty. kInvalidArgument (options).
  static absl::StatusOr<std::unique_ptr<Relay>> Create(
      const std::string& target, const ClientOptions& options = {});
  // Cancels what goes on and waits until the last callback has returned.
  ~Relay();
  Relay(const Relay&) = delete;
  Relay& operator=(const Relay&) = delete;

  void Call(const std::string& token,
            const groundlock::v1::CreateSessionRequest& request,
            Reply<groundlock::v1::CreateSessionResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::ListSessionsRequest& request,
            Reply<groundlock::v1::ListSessionsResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::GetSessionRequest& request,
            Reply<groundlock::v1::GetSessionResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::GetCallerRequest& request,
            Reply<groundlock::v1::GetCallerResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::DeleteSessionRequest& request,
            Reply<groundlock::v1::DeleteSessionResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::SetTargetRequest& request,
            Reply<groundlock::v1::SetTargetResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::MoveTargetRequest& request,
            Reply<groundlock::v1::MoveTargetResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::DropTargetRequest& request,
            Reply<groundlock::v1::DropTargetResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::ListMapsRequest& request,
            Reply<groundlock::v1::ListMapsResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::GetMapRequest& request,
            Reply<groundlock::v1::GetMapResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::DeleteMapRequest& request,
            Reply<groundlock::v1::DeleteMapResponse> reply);
  // Without a deadline: they take as long as the map is large.
  void Call(const std::string& token,
            const groundlock::v1::AlignMapRequest& request,
            Reply<groundlock::v1::AlignMapResponse> reply);
  void Call(const std::string& token,
            const groundlock::v1::CheckMapRequest& request,
            Reply<groundlock::v1::CheckMapResponse> reply);

  // Follows a session. on_start is called when the server watches; on_message
  // is called for one message at a time; the next
  // comes after Continue(). on_end is called once and last: OK or kNotFound
  // when the session has ended, kUnavailable when the connection was lost.
  // Does not reconnect. All as Reply.
  std::shared_ptr<RelayedWatch> Watch(
      const std::string& token,
      const groundlock::v1::WatchSessionRequest& request,
      std::function<void()> on_start,
      std::function<void(groundlock::v1::WatchSessionResponse)> on_message,
      std::function<void(absl::Status)> on_end);

  // on_block returns false to cancel. on_end is called once and last.
  void GetPointCloud(
      const std::string& token,
      const groundlock::v1::GetPointCloudRequest& request,
      std::function<bool(groundlock::v1::GetPointCloudResponse)> on_block,
      std::function<void(absl::Status)> on_end);

 private:
  struct Parts;
  explicit Relay(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_RELAY_H_
