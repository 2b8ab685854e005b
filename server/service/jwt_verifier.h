// SPDX-License-Identifier: Apache-2.0
// JSON Web Tokens (RFC 7519, signed as of RFC 7515) of an issuer that the
// server was told to believe.
#ifndef GROUNDLOCK_SERVER_SERVICE_JWT_VERIFIER_H_
#define GROUNDLOCK_SERVER_SERVICE_JWT_VERIFIER_H_

#include <atomic>
#include <chrono>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/service/principal.h"

namespace groundlock::service {

struct JwtOptions {
  // Folder of keys, each called after the "kid" of the tokens that it signs:
  // KID.pem, a public key, for RS256 (RSA of 2048 bits at least) or ES256
  // (P-256); KID.secret, 32 to 1024 bytes that nobody else may read, for HS256.
  // Empty: no such tokens.
  std::filesystem::path keys;
  std::string issuer;    // "iss" must be it
  std::string audience;  // "aud" must have it
};

// Immutable, so thread-safe.
class JwtVerifier {
 public:
  // Reads the keys. Errors name the file: kNotFound, kInvalidArgument (no key,
  // too weak, of another kind), kFailedPrecondition (no key at all; a secret
  // that others may read).
  static absl::StatusOr<std::unique_ptr<JwtVerifier>> Load(
      const JwtOptions& options);
  // Changes when something in the folder does.
  static std::string LookOf(const std::filesystem::path& folder);

  // Whose token it is. The key decides on the algorithm, the token has to agree
  // with it. Of the claims it takes iss, aud, exp (which must be there), nbf;
  // sub as the name, behind "jwt:"; scope, with blanks between scopes, those of
  // other services left out; tenant. kUnauthenticated says why not.
  absl::StatusOr<Principal> Verify(
      std::string_view token, std::chrono::system_clock::time_point now) const;

  // Those whose tokens were signed with a key that `next` does not have are not
  // let go on.
  void Withdraw(const JwtVerifier* next) const;

 private:
  enum class Algorithm { kHs256, kRs256, kEs256 };
  struct Key {
    Algorithm algorithm = Algorithm::kHs256;
    std::string material;
    std::shared_ptr<std::atomic<bool>> withdrawn =
        std::make_shared<std::atomic<bool>>(false);
  };

  explicit JwtVerifier(const JwtOptions& options) : options_(options) {}
  static absl::StatusOr<Key> ReadKey(const std::filesystem::path& path);
  // The keys that may have signed it: of its kid, or without one all of its
  // algorithm.
  absl::StatusOr<std::vector<const Key*>> KeysFor(
      std::string_view header_base64) const;
  absl::StatusOr<Principal> FromClaims(
      const std::string& json, std::chrono::system_clock::time_point now) const;

  const JwtOptions options_;
  std::map<std::string, Key> keys_;  // by kid
};

// Whether it has the three parts of one.
bool LooksLikeJwt(std::string_view token);

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_JWT_VERIFIER_H_
