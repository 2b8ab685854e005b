// SPDX-License-Identifier: Apache-2.0
// gRPC's health checking (proto/grpc/health/v1/health.proto).
#ifndef GROUNDLOCK_SERVER_SERVICE_HEALTH_SERVICE_H_
#define GROUNDLOCK_SERVER_SERVICE_HEALTH_SERVICE_H_

#include <grpcpp/impl/service_type.h>

#include <set>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "map_store/base/mutex.h"
#include "server/service/gate.h"

namespace groundlock::service {

// Whoever asks needs no token. gRPC has such a service of its own, whose calls
// nobody counts: one that watches without end, thousands of times, took as much
// memory as it liked. Serves until told otherwise. Thread-safe; outlives the
// gRPC server's calls.
class HealthService final : public grpc::Service {
 public:
  //   services  "package.Service", whose health is the server's.
  HealthService(const Gate& gate, std::vector<std::string> services);

  // Tells those that watch.
  void SetServing(bool serving);
  // Serves no more: those that watch are told, and let go.
  void Shutdown();

 private:
  class HealthCall;

  void Add(const char* method, bool watches);
  bool Knows(const std::string& service) const;

  const Gate gate_;
  const std::vector<std::string> services_;
  int num_methods_ = 0;
  base::Mutex mutex_;
  bool serving_ ABSL_GUARDED_BY(mutex_) = true;
  bool shut_down_ ABSL_GUARDED_BY(mutex_) = false;
  std::set<HealthCall*> watchers_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_HEALTH_SERVICE_H_
