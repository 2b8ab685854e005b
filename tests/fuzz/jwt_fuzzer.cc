// SPDX-License-Identifier: Apache-2.0
// JSON Web Tokens: the token itself, and claims that are signed as they should
// be, so that what reads them is reached. Nobody may be let in unnamed.
#include <openssl/evp.h>
#include <openssl/hmac.h>
#include <unistd.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/escaping.h"
#include "server/service/jwt_verifier.h"

namespace {

constexpr char kSecret[] = "a secret of more than thirty-two bytes";

const groundlock::service::JwtVerifier& Verifier() {
  static const auto* const verifier = [] {
    namespace fs = std::filesystem;
    const fs::path folder =
        fs::temp_directory_path() / ("jwt-keys-" + std::to_string(getpid()));
    fs::create_directories(folder);
    std::ofstream(folder / "key.secret") << kSecret;
    fs::permissions(folder / "key.secret",
                    fs::perms::owner_read | fs::perms::owner_write);
    return groundlock::service::JwtVerifier::Load({folder, "issuer", "us"})
        ->release();
  }();
  return *verifier;
}

std::string Signed(const std::string& claims) {
  const std::string text =
      absl::WebSafeBase64Escape(R"({"alg":"HS256","typ":"JWT"})") + "." +
      absl::WebSafeBase64Escape(claims);
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned size = 0;
  HMAC(EVP_sha256(),
       kSecret,
       sizeof(kSecret) - 1,
       reinterpret_cast<const unsigned char*>(text.data()),
       text.size(),
       digest,
       &size);
  return text + "." +
         absl::WebSafeBase64Escape(
             std::string(reinterpret_cast<const char*>(digest), size));
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  const std::chrono::system_clock::time_point now{
      std::chrono::seconds(2'000'000'000)};
  for (const std::string& token : {text, Signed(text)}) {
    const auto principal = Verifier().Verify(token, now);
    if (principal.ok() &&
        (principal->name.size() < 5 || principal->expires < now)) {
      __builtin_trap();
    }
  }
  return 0;
}
