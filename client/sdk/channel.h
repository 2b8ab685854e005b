// SPDX-License-Identifier: Apache-2.0
// How the SDK connects. Internal to the SDK.
#ifndef GROUNDLOCK_CLIENT_SDK_CHANNEL_H_
#define GROUNDLOCK_CLIENT_SDK_CHANNEL_H_

#include <grpcpp/channel.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "client/sdk/client.h"

namespace groundlock::sdk {

// Does not wait for the server; connects, and connects again, when it is used.
// Every call carries options.token. Errors: files of options.tls.
absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(
    const std::string& target, const ClientOptions& options);

}  // namespace groundlock::sdk

#endif  // GROUNDLOCK_CLIENT_SDK_CHANNEL_H_
