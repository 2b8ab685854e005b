// SPDX-License-Identifier: Apache-2.0
// Encryption of the server's port.
#ifndef GROUNDLOCK_SERVER_SERVICE_TLS_H_
#define GROUNDLOCK_SERVER_SERVICE_TLS_H_

#include <grpcpp/security/server_credentials.h>

#include <memory>

#include "absl/status/statusor.h"
#include "server/service/options.h"

namespace groundlock::service {

// TLS 1.2 or 1.3 with options.certificate, or none if that is empty. The files
// are read again when they change, so that a renewed certificate needs no
// restart; connections that are open keep theirs. kNotFound, kInvalidArgument
// (no certificate, no key, not a pair, expired), kFailedPrecondition (everybody
// may read the key); messages name the file.
absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsOptions& options);

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_TLS_H_
