// SPDX-License-Identifier: Apache-2.0
#include "server/service/jwt_verifier.h"

#include <jwt.h>
#include <openssl/bio.h>
#include <openssl/ec.h>
#include <openssl/evp.h>
#include <openssl/pem.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <optional>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/file_look.h"
#include "map_store/base/status.h"
#include "map_store/base/token_file.h"

namespace groundlock::service {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::size_t kMaxKeys = 64;
constexpr std::uint64_t kMaxKeyBytes = 16 << 10;
constexpr std::size_t kMaxNameBytes = 128;
// RFC 7518, sections 3.2 and 3.3.
constexpr std::size_t kMinSecretBytes = 32;
constexpr std::size_t kMaxSecretBytes = 1024;
constexpr int kMinRsaBits = 2048;
// Clocks of issuers and servers differ a little (RFC 7519, section 4.1.4).
constexpr std::chrono::seconds kLeeway(30);
// Seconds since 1970, of the year 9999; and what a clock of nanoseconds can
// hold, with some to spare: for ever, as far as anybody here is concerned.
constexpr double kMaxTime = 253'402'300'799.0;
constexpr double kLatest = 9'000'000'000.0;

absl::Status Refused(std::string_view why) {
  return absl::UnauthenticatedError(
      absl::StrCat("the token: ", base::Abseil(why)));
}

struct JwtDeleter {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
  void operator()(jwt_t* jwt) const { jwt_free(jwt); }
  void operator()(char* text) const { std::free(text); }
};
template <typename T>
using JwtOwned = std::unique_ptr<T, JwtDeleter>;

// nullopt: not there, or no text.
std::optional<std::string> Text(const json& object, const char* field) {
  const auto found = object.find(field);
  if (found == object.end() || !found->is_string()) return std::nullopt;
  return found->get<std::string>();
}

bool HasText(const json& value, const std::string& wanted) {
  if (value.is_string()) return value.get<std::string>() == wanted;
  return value.is_array() &&
         std::any_of(value.begin(), value.end(), [&](const json& one) {
           return one.is_string() && one.get<std::string>() == wanted;
         });
}

absl::StatusOr<std::optional<std::chrono::system_clock::time_point>> Time(
    const json& claims, const char* field) {
  std::optional<std::chrono::system_clock::time_point> time;
  const auto found = claims.find(field);
  if (found == claims.end()) return time;
  if (!found->is_number()) {
    return Refused(absl::StrCat(field, " is not a number"));
  }
  const auto seconds = found->get<double>();
  if (!(seconds >= 0.0 && seconds <= kMaxTime)) {
    return Refused(absl::StrCat(field, " is out of range"));
  }
  time = std::chrono::system_clock::time_point(std::chrono::seconds(
      static_cast<std::int64_t>(std::min(seconds, kLatest))));
  return time;
}

}  // namespace

bool LooksLikeJwt(std::string_view token) {
  return std::count(token.begin(), token.end(), '.') == 2;
}

std::string JwtVerifier::LookOf(const fs::path& folder) {
  std::vector<std::string> looks;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    const std::string look = base::LookOf(it->path());
    if (look.empty()) continue;
    looks.push_back(
        absl::StrCat(it->path().filename().string(), " ", look, "\n"));
    if (looks.size() > 4 * kMaxKeys) break;
  }
  std::sort(looks.begin(), looks.end());
  return absl::StrJoin(looks, "");
}

absl::StatusOr<JwtVerifier::Key> JwtVerifier::ReadKey(const fs::path& path) {
  Key key;
  ASSIGN_OR_RETURN(key.material, base::ReadFile(path, kMaxKeyBytes));
  const auto wrong = [&path](std::string_view why) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": ", base::Abseil(why)));
  };
  if (path.extension() == ".secret") {
    RETURN_IF_ERROR(base::CheckPrivate(path));
    if (!key.material.empty() && key.material.back() == '\n') {
      key.material.pop_back();
    }
    if (key.material.size() < kMinSecretBytes ||
        key.material.size() > kMaxSecretBytes) {
      return wrong("a secret has 32 to 1024 bytes");
    }
    key.algorithm = Algorithm::kHs256;
    return key;
  }
  const JwtOwned<BIO> bio(BIO_new_mem_buf(
      key.material.data(), static_cast<int>(key.material.size())));
  const JwtOwned<EVP_PKEY> parsed(
      PEM_read_bio_PUBKEY(bio.get(), nullptr, nullptr, nullptr));
  if (parsed == nullptr) return wrong("no public key in PEM form");
  if (EVP_PKEY_is_a(parsed.get(), "RSA") == 1) {
    if (EVP_PKEY_get_bits(parsed.get()) < kMinRsaBits) {
      return wrong("an RSA key of fewer than 2048 bits");
    }
    key.algorithm = Algorithm::kRs256;
    return key;
  }
  char group[32] = "";
  std::size_t size = 0;
  if (EVP_PKEY_is_a(parsed.get(), "EC") == 1 &&
      EVP_PKEY_get_group_name(parsed.get(), group, sizeof(group), &size) == 1 &&
      std::string_view(group) == "prime256v1") {
    key.algorithm = Algorithm::kEs256;
    return key;
  }
  return wrong("neither an RSA key nor an elliptic one on P-256");
}

absl::StatusOr<std::unique_ptr<JwtVerifier>> JwtVerifier::Load(
    const JwtOptions& options) {
  std::unique_ptr<JwtVerifier> verifier(new JwtVerifier(options));
  std::error_code error;
  for (fs::directory_iterator it(options.keys, error), end; !error && it != end;
       it.increment(error)) {
    const fs::path& path = it->path();
    const bool is_key =
        path.extension() == ".pem" || path.extension() == ".secret";
    if (!is_key || path.filename().string().front() == '.') continue;
    const std::string kid = path.stem().string();
    if (verifier->keys_.contains(kid)) {
      return absl::InvalidArgumentError(
          absl::StrCat(options.keys.string(), ": two keys are called ", kid));
    }
    if (verifier->keys_.size() >= kMaxKeys) {
      return absl::InvalidArgumentError(absl::StrCat(
          options.keys.string(), ": more than ", kMaxKeys, " keys"));
    }
    ASSIGN_OR_RETURN(Key key, ReadKey(path));
    verifier->keys_.emplace(kid, std::move(key));
  }
  if (error) {
    return absl::NotFoundError(
        absl::StrCat(options.keys.string(), ": ", error.message()));
  }
  if (verifier->keys_.empty()) {
    return absl::FailedPreconditionError(absl::StrCat(
        options.keys.string(), ": no key in it, KID.pem or KID.secret"));
  }
  return verifier;
}

void JwtVerifier::Withdraw(const JwtVerifier* next) const {
  for (const auto& [kid, key] : keys_) {
    const auto found = next->keys_.find(kid);
    if (found != next->keys_.end() &&
        found->second.algorithm == key.algorithm &&
        found->second.material == key.material) {
      continue;
    }
    *key.withdrawn = true;
  }
}

absl::StatusOr<std::vector<const JwtVerifier::Key*>> JwtVerifier::KeysFor(
    std::string_view header_base64) const {
  std::string text;
  if (!absl::WebSafeBase64Unescape(base::Abseil(header_base64), &text)) {
    return Refused("its header is no base64");
  }
  const json header = json::parse(text, nullptr, false);
  if (!header.is_object()) return Refused("its header is no JSON object");
  // RFC 7515, section 4.1.11: whoever does not know it must not go on.
  if (header.contains("crit")) return Refused("its header wants extensions");
  const auto name = Text(header, "alg").value_or("");
  Algorithm algorithm = Algorithm::kHs256;
  if (name == "RS256") {
    algorithm = Algorithm::kRs256;
  } else if (name == "ES256") {
    algorithm = Algorithm::kEs256;
  } else if (name != "HS256") {
    return Refused("its algorithm is none of HS256, RS256 and ES256");
  }
  const auto kid = Text(header, "kid");
  std::vector<const Key*> keys;
  for (const auto& [id, key] : keys_) {
    if (key.algorithm == algorithm && (!kid || *kid == id)) {
      keys.push_back(&key);
    }
  }
  if (keys.empty()) return Refused("no key is known that could have signed it");
  return keys;
}

absl::StatusOr<Principal> JwtVerifier::FromClaims(
    const std::string& text, std::chrono::system_clock::time_point now) const {
  const json claims = json::parse(text, nullptr, false);
  if (!claims.is_object()) return Refused("its claims are no JSON object");
  if (Text(claims, "iss") != options_.issuer) {
    return Refused("it is of another issuer");
  }
  if (!claims.contains("aud") || !HasText(claims["aud"], options_.audience)) {
    return Refused("it is for another audience");
  }
  Principal principal;
  ASSIGN_OR_RETURN(const auto expires, Time(claims, "exp"));
  if (!expires) return Refused("it has no exp, and would last for ever");
  principal.expires = *expires + kLeeway;
  if (now > principal.expires) return Refused("it has expired");
  ASSIGN_OR_RETURN(const auto begins, Time(claims, "nbf"));
  if (begins && now + kLeeway < *begins) return Refused("it is not valid yet");
  const std::string subject = Text(claims, "sub").value_or("");
  const bool printable =
      std::all_of(subject.begin(), subject.end(), [](char c) {
        return c > ' ' && c < '\x7f';
      });
  if (subject.empty() || subject.size() > kMaxNameBytes || !printable) {
    return Refused("sub: expected 1 to 128 ASCII characters without blanks");
  }
  principal.name = absl::StrCat("jwt:", subject);
  if (claims.contains("tenant")) {
    const auto tenant = Text(claims, "tenant");
    if (!tenant || !base::ValidateTenant(*tenant).ok()) {
      return Refused("tenant: not the name of one");
    }
    principal.tenant = *tenant;
  }
  const std::string scopes = Text(claims, "scope").value_or("");
  for (const absl::string_view scope : absl::StrSplit(scopes, ' ')) {
    principal.scopes |= ScopesOf(base::Std(scope));
  }
  return principal;
}

absl::StatusOr<Principal> JwtVerifier::Verify(
    std::string_view token, std::chrono::system_clock::time_point now) const {
  if (!LooksLikeJwt(token)) return Refused("it has not three parts");
  ASSIGN_OR_RETURN(const auto keys, KeysFor(token.substr(0, token.find('.'))));
  const std::string text(token);
  for (const Key* key : keys) {
    jwt_t* decoded = nullptr;
    if (jwt_decode(&decoded,
                   text.c_str(),
                   reinterpret_cast<const unsigned char*>(key->material.data()),
                   static_cast<int>(key->material.size())) != 0) {
      continue;
    }
    const JwtOwned<jwt_t> jwt(decoded);
    // It took the algorithm from the token: a public key must not have served
    // as a secret.
    const jwt_alg_t wanted = key->algorithm == Algorithm::kHs256 ? JWT_ALG_HS256
                             : key->algorithm == Algorithm::kRs256
                                 ? JWT_ALG_RS256
                                 : JWT_ALG_ES256;
    if (jwt_get_alg(jwt.get()) != wanted) continue;
    const JwtOwned<char> claims(jwt_get_grants_json(jwt.get(), nullptr));
    if (claims == nullptr) return Refused("it has no claims");
    ASSIGN_OR_RETURN(Principal principal, FromClaims(claims.get(), now));
    principal.withdrawn = key->withdrawn;
    return principal;
  }
  return Refused("its signature is wrong");
}

}  // namespace groundlock::service
