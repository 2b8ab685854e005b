// SPDX-License-Identifier: Apache-2.0
// Who may call, and what for.
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
#include "server/service/call_watch.h"
#include "server/service/convert.h"

namespace groundlock::service {

// What a method asks for; see base::kScopes.
enum class Scope : unsigned {
  kMapsRead = 1,
  kMapsWrite = 2,
  kSessionsWatch = 4,
  kSessionsAll = 8,
};

// Somebody who calls.
struct Principal {
  std::string name;
  unsigned scopes = 0;  // of Scope

  bool May(Scope scope) const {
    return (scopes & static_cast<unsigned>(scope)) != 0;
  }
};

// Thread-safe.
class Access final : public WatchedCall {
 public:
  // Everybody may do everything.
  Access() = default;
  // Those of a token file, which is looked at every two seconds, and read again
  // when it has changed: a file that cannot be read then is logged, and what
  // was read before holds. Errors: base::ReadTokenFile; kFailedPrecondition (no
  // token in it).
  static absl::StatusOr<std::unique_ptr<Access>> FromFile(
      const std::filesystem::path& path);
  // Whoever knows one of the tokens may do everything.
  static std::unique_ptr<Access> FromTokens(
      const std::vector<std::string>& tokens);

  bool open_to_all() const { return is_open_; }
  // Who calls. kUnauthenticated unless the call carries "authorization: Bearer
  // TOKEN" with one of the tokens.
  absl::StatusOr<std::shared_ptr<const Principal>> Authenticate(
      const grpc::CallbackServerContext& context) const;
  // The same for the value of the "authorization" header.
  absl::StatusOr<std::shared_ptr<const Principal>> AuthenticateHeader(
      std::string_view header) const;

  // Looks at the file.
  void OnTick(std::chrono::steady_clock::time_point now) override;

 private:
  // By the token's hash, so that the time of a look-up tells nothing of it.
  using Principals =
      std::unordered_map<std::string, std::shared_ptr<const Principal>>;

  void Replace(const std::vector<base::TokenEntry>& entries);

  bool is_open_ = true;
  std::filesystem::path path_;
  // Of the watch's thread: what the file looked like when it was read.
  std::string seen_;
  std::chrono::steady_clock::time_point next_look_;

  mutable base::Mutex mutex_;
  std::shared_ptr<const Principals> principals_ ABSL_GUARDED_BY(mutex_);
};

// The reactor of a streaming call that is refused.
template <typename Reactor>
Reactor* Refuse(const absl::Status& status) {
  class Refusal final : public Reactor {
   public:
    explicit Refusal(const absl::Status& reason) {
      this->Finish(ToGrpc(reason));
    }
    void OnDone() override { delete this; }
  };
  return new Refusal(status);
}

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_ACCESS_H_
