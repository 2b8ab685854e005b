// SPDX-License-Identifier: Apache-2.0
// What a client and its streams share. Internal to the SDK.
#ifndef GROUNDLOCK_CLIENT_SDK_CONNECTION_H_
#define GROUNDLOCK_CLIENT_SDK_CONNECTION_H_

#include <grpcpp/channel.h>

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "client/sdk/client.h"
#include "groundlock/v1/maps.grpc.pb.h"
#include "groundlock/v1/tracking.grpc.pb.h"

namespace groundlock::sdk {

struct Client::Connection {
  ClientOptions options;
  std::shared_ptr<grpc::Channel> channel;
  std::unique_ptr<groundlock::v1::MapService::Stub> maps;
  std::unique_ptr<groundlock::v1::TrackingService::Stub> tracking;

  // A context with the deadline of quick calls.
  std::unique_ptr<grpc::ClientContext> Context() const;
};

// Makes the stream and waits until it is attached for the first time.
absl::StatusOr<std::unique_ptr<TrackingStream>> OpenTrackingStream(
    std::shared_ptr<groundlock::v1::TrackingService::Stub> tracking,
    const std::string& session_id,
    const TrackingStreamOptions& options);

absl::StatusOr<std::unique_ptr<SessionWatcher>> OpenWatcher(
    std::shared_ptr<groundlock::v1::TrackingService::Stub> tracking,
    const std::string& session_id,
    bool include_images,
    std::uint32_t image_width_px);

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_CONNECTION_H_
