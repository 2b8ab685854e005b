// SPDX-License-Identifier: Apache-2.0
// How many calls one connection has open. HTTP/2's own limit binds a client
// only once it has acknowledged it (gRPC 1.51), so one that never does has
// none.
#ifndef GROUNDLOCK_SERVER_SERVICE_OPEN_CALLS_H_
#define GROUNDLOCK_SERVER_SERVICE_OPEN_CALLS_H_

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"

namespace groundlock::service {

// Thread-safe. Calls may outlive it.
class OpenCalls {
 public:
  // A call that is counted for as long as somebody has it.
  using Call = std::shared_ptr<void>;

  // max_streams: what clients are told. Twice as many are counted before one is
  // held to have passed it over: what a client gave up may be ending here
  // still. end: told of the connection, as grpc::ServerContext::peer() names
  // it.
  OpenCalls(int max_streams, std::function<void(const std::string&)> end)
      : max_calls_(2 * max_streams),
        end_(std::move(end)),
        counts_(std::make_shared<Counts>()) {}

  // kResourceExhausted: too many, and `end` was called.
  //   peer  clients of a Unix socket are not told apart, and not counted
  absl::StatusOr<Call> Enter(const std::string& peer) const;

 private:
  struct Counts {
    base::Mutex mutex;
    std::map<std::string, int> calls ABSL_GUARDED_BY(mutex);
  };

  const int max_calls_;
  const std::function<void(const std::string&)> end_;
  const std::shared_ptr<Counts> counts_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_OPEN_CALLS_H_
