// SPDX-License-Identifier: Apache-2.0
// What sessions may be started from: the operator's videos and streams, and
// uploaded videos.
#ifndef GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SOURCES_H_
#define GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SOURCES_H_

#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/dashboard/proxy/options.h"
#include "client/dashboard/proxy/uploads.h"
#include "groundlock/dashboard/v1/dashboard.pb.h"

namespace groundlock::dashboard {

namespace pb = ::groundlock::dashboard::v1;

// Looks at the disk each time. Thread-safe.
class Sources {
 public:
  // uploads: null = none; else outlives this.
  Sources(std::filesystem::path folder,
          std::vector<StreamSource> streams,
          const Uploads* uploads)
      : folder_(std::move(folder)),
        streams_(std::move(streams)),
        uploads_(uploads) {}

  struct Found {
    pb::Source source;
    std::string input;  // for media::OpenVideoSource
  };
  std::vector<Found> List() const;
  // kNotFound. Nothing but what List returns can be opened.
  absl::StatusOr<Found> Find(const std::string& source_id) const;

 private:
  const std::filesystem::path folder_;  // empty = none
  const std::vector<StreamSource> streams_;
  const Uploads* const uploads_;
};

}  // namespace groundlock::dashboard

#endif  // GROUNDLOCK_CLIENT_DASHBOARD_PROXY_SOURCES_H_
