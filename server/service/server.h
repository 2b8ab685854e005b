// SPDX-License-Identifier: Apache-2.0
// The server: wires sessions, services and their threads to a port.
#ifndef GROUNDLOCK_SERVER_SERVICE_SERVER_H_
#define GROUNDLOCK_SERVER_SERVICE_SERVER_H_

#include <chrono>
#include <memory>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/storage/store.h"
#include "server/service/metrics.h"
#include "server/service/options.h"
#include "server/service/session_manager.h"

namespace groundlock::service {

class GroundlockServer {
 public:
  // Starts to listen. kInvalidArgument (options), kUnavailable (the address
  // cannot be bound).
  //   store, metrics  must outlive the server.
  //   factory  what tracks; empty = the real thing.
  static absl::StatusOr<std::unique_ptr<GroundlockServer>> Start(
      const ServerOptions& options,
      storage::Store* store,
      Metrics* metrics,
      CoreFactory factory = nullptr);
  // Shuts down without grace if that has not been done.
  ~GroundlockServer();
  GroundlockServer(const GroundlockServer&) = delete;
  GroundlockServer& operator=(const GroundlockServer&) = delete;

  int port() const;

  // Reads the files that say who may call again, changed or not.
  void ReloadAccess();

  // Refuses new work, reports NOT_SERVING, answers waiting frames as dropped
  // and lets frames in work finish; whatever is not over after `grace` is
  // cancelled. Returns when no call is left. Once.
  void Shutdown(std::chrono::milliseconds grace);

 private:
  struct Parts;
  explicit GroundlockServer(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_SERVER_H_
