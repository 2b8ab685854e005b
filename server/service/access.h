// SPDX-License-Identifier: Apache-2.0
// Who may call: those who know a token.
#ifndef GROUNDLOCK_SERVER_SERVICE_ACCESS_H_
#define GROUNDLOCK_SERVER_SERVICE_ACCESS_H_

#include <grpcpp/server_context.h>

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/convert.h"

namespace groundlock::service {

// Thread-safe: it never changes.
class Access {
 public:
  // tokens: none = everybody may call.
  explicit Access(std::vector<std::string> tokens)
      : tokens_(std::move(tokens)) {}

  bool open_to_all() const { return tokens_.empty(); }
  // kUnauthenticated unless the call carries "authorization: Bearer TOKEN" with
  // one of the tokens. Takes as long for a wrong token as for a right one.
  absl::Status Check(const grpc::CallbackServerContext& context) const;
  // The same for the value of the "authorization" header.
  absl::Status CheckHeader(std::string_view header) const;

 private:
  std::vector<std::string> tokens_;
};

// One token a line; blank lines and lines that start with # do not count.
// kInvalidArgument names the line: a token has 16 to 1024 printable ASCII
// characters without blanks. kFailedPrecondition: no token in the file, or
// others than its owner may read it.
absl::StatusOr<std::vector<std::string>> ReadTokenFile(
    const std::filesystem::path& path);

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
