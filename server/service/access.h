// SPDX-License-Identifier: Apache-2.0
// Who may call, and how one tells.
#ifndef GROUNDLOCK_SERVER_SERVICE_ACCESS_H_
#define GROUNDLOCK_SERVER_SERVICE_ACCESS_H_

#include <grpcpp/server_context.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "map_store/base/token_file.h"
#include "server/service/account.h"
#include "server/service/call_watch.h"
#include "server/service/jwt_verifier.h"
#include "server/service/principal.h"

namespace groundlock::service {

// Where principals come from. Nothing set: everybody may do everything.
struct AccessOptions {
  // Tokens and clients' certificates: base/token_file.h.
  std::filesystem::path token_file;
  // Whoever knows one of them may do everything; not with a token_file.
  std::vector<std::string> tokens;
  JwtOptions jwt;
};

// The files are looked at every two seconds and read again when they have
// changed; if they cannot be read then, that is logged, and what was read
// before holds. Thread-safe.
class Access final : public WatchedCall {
 public:
  // Errors: base::ReadTokenFile, JwtVerifier::Load; kFailedPrecondition (nobody
  // in the token file).
  //   over_quota  counts what is refused for a quota; null = nobody counts.
  static absl::StatusOr<std::unique_ptr<Access>> Create(
      AccessOptions options, std::atomic<std::uint64_t>* over_quota = nullptr);

  bool open_to_all() const { return is_open_; }
  // Who calls: by the metadata "authorization: Bearer TOKEN" if the call has
  // any, else by the certificate that the client has shown and that one of the
  // authorities believed has signed. kUnauthenticated.
  absl::StatusOr<std::shared_ptr<const Principal>> Authenticate(
      const grpc::CallbackServerContext& context) const;
  // By the value of "authorization".
  absl::StatusOr<std::shared_ptr<const Principal>> AuthenticateHeader(
      std::string_view header) const;
  // By what a verified certificate says: "cn:NAME", "dns:NAME" and so on.
  absl::StatusOr<std::shared_ptr<const Principal>> AuthenticateSubjects(
      const std::vector<std::string>& subjects) const;

  // Reads the files now, changed or not. Waits for the disk.
  void Reload();
  void OnTick(std::chrono::steady_clock::time_point now) override;

 private:
  // One of the token file, and what it was made of.
  struct Known {
    base::TokenEntry entry;
    std::shared_ptr<const Principal> principal;
    std::shared_ptr<std::atomic<bool>> withdrawn;
  };
  // By credential: of a token that is its hash, so that the time of a look-up
  // tells nothing of it.
  using Book = std::unordered_map<std::string, Known>;

  Access(AccessOptions options, std::atomic<std::uint64_t>* over_quota);
  void Replace(base::TokenFile file);
  absl::Status ReadTokens() ABSL_EXCLUSIVE_LOCKS_REQUIRED(files_mutex_);
  absl::Status ReadJwtKeys() ABSL_EXCLUSIVE_LOCKS_REQUIRED(files_mutex_);
  void Look(bool always) ABSL_LOCKS_EXCLUDED(files_mutex_);
  std::shared_ptr<const Book> book() const ABSL_LOCKS_EXCLUDED(mutex_);

  const AccessOptions options_;
  const bool is_open_;
  std::chrono::steady_clock::time_point next_look_;  // of the watch's thread

  // Held while files are read.
  base::Mutex files_mutex_;
  // What they looked like.
  std::string tokens_look_ ABSL_GUARDED_BY(files_mutex_);
  std::string jwt_look_ ABSL_GUARDED_BY(files_mutex_);

  mutable Ledger ledger_;
  mutable base::Mutex mutex_;
  base::Quotas default_quotas_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const Book> book_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const JwtVerifier> jwt_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_ACCESS_H_
