// SPDX-License-Identifier: Apache-2.0
// How many calls are open, in total and by where they come from.
//
// HTTP/2's own limit of a connection (RFC 9113, section 5.1.2) binds a client
// in gRPC 1.51 only once it has acknowledged the server's settings: one that
// never does, or that opens many connections, has none. So calls are counted
// where they are let in, whatever the client has said.
#ifndef GROUNDLOCK_SERVER_SERVICE_OPEN_CALLS_H_
#define GROUNDLOCK_SERVER_SERVICE_OPEN_CALLS_H_

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"

namespace groundlock::service {

struct CallLimits {
  // Calls at a time, of all clients.
  int max_calls = 8'000;
  // Of one IPv4 address, or of one IPv6 network of 64 bits, which one
  // subscriber has for himself; 0 = no more than in total. Who stands before
  // the server as a proxy has one address for everybody.
  int max_calls_per_address = 2'000;

  // What a connection is told that it may have: half of an address's, as a call
  // that is over for its client may still be ending here. gRPC's clients hold
  // back what is more.
  int StreamsPerConnection() const;
};

// What clients of one address have in common, of a peer as
// grpc::ServerContext::peer() names it: "ipv4:192.0.2.1:40000",
// "ipv6:%5B2001:db8::1%5D:40000". Empty if peers are not told apart, as at a
// Unix socket.
std::string NetworkOf(std::string_view peer);

// Thread-safe. Calls may outlive it, though not what it counts into.
class OpenCalls {
 public:
  // A call that is counted for as long as somebody has it.
  using Call = std::shared_ptr<void>;

  //   open     how many there are now
  //   refused  how many there have been too many
  OpenCalls(const CallLimits& limits,
            std::atomic<std::int64_t>* open,
            std::atomic<std::uint64_t>* refused);

  // kResourceExhausted: there are too many, and this one is not counted.
  absl::StatusOr<Call> Enter(std::string_view peer) const;
  // The same for calls of which nobody asks who makes them: they have an eighth
  // of the total, so that strangers from many addresses leave room to those who
  // are known.
  absl::StatusOr<Call> EnterUnknown(std::string_view peer) const;

 private:
  struct Counts {
    base::Mutex mutex;
    int total ABSL_GUARDED_BY(mutex) = 0;
    int unknown ABSL_GUARDED_BY(mutex) = 0;  // of the total
    // By network; none that has no calls.
    std::map<std::string, int> networks ABSL_GUARDED_BY(mutex);
  };
  // Which of the limits forbids one more; if none, it is counted.
  static absl::Status Count(Counts& counts,
                            const CallLimits& limits,
                            const std::string& network,
                            bool is_unknown);
  static void Leave(Counts& counts,
                    const std::string& network,
                    bool is_unknown);
  absl::StatusOr<Call> EnterAs(std::string_view peer, bool is_unknown) const;

  const CallLimits limits_;
  std::atomic<std::int64_t>* const open_;
  std::atomic<std::uint64_t>* const refused_;
  const std::shared_ptr<Counts> counts_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_OPEN_CALLS_H_
