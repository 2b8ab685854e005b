// SPDX-License-Identifier: Apache-2.0
// Maps' points as they go to viewers: fetched once per version, encoded once.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_POINT_CLOUDS_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_POINT_CLOUDS_H_

#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "client/dashboard/proxy/outbox.h"
#include "client/sdk/relay.h"
#include "groundlock/v1/maps.pb.h"
#include "map_store/base/mutex.h"

namespace groundlock::dashboard {

namespace gl = ::groundlock::v1;

struct EncodedCloud {
  pb::PointCloudStart start;
  std::vector<Buffer> blocks;
  std::uint64_t bytes = 0;
};

// Keeps the last used ones, up to a limit. Thread-safe.
class PointClouds {
 public:
  using Callback =
      std::function<void(absl::StatusOr<std::shared_ptr<const EncodedCloud>>)>;

  // relay: outlives the use of this.
  PointClouds(sdk::Relay* relay,
              std::uint64_t max_points,
              std::uint64_t max_bytes)
      : relay_(relay), max_points_(max_points), max_bytes_(max_bytes) {}

  // version: 0 = the newest. Calls back from a thread of gRPC's, or at once.
  // Asks the server with the token whether the map is there, also when its
  // points are known.
  void Get(const std::string& token,
           const std::string& name,
           std::uint64_t version,
           Callback callback);

 private:
  using Key = std::pair<std::string, std::string>;  // name/version, content
  struct Fetch {
    std::vector<gl::GetPointCloudResponse> blocks;
    std::uint64_t bytes = 0;
    std::vector<Callback> waiting;
  };
  void Fetched(const Key& key,
               const gl::MapInfo& map,
               const std::shared_ptr<Fetch>& fetch,
               const absl::Status& status);

  sdk::Relay* const relay_;
  const std::uint64_t max_points_;
  const std::uint64_t max_bytes_;
  base::Mutex mutex_;
  std::map<Key, std::shared_ptr<Fetch>> fetches_ ABSL_GUARDED_BY(mutex_);
  // The most recently used first.
  std::list<std::pair<Key, std::shared_ptr<const EncodedCloud>>> kept_
      ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_POINT_CLOUDS_H_
