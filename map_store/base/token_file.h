// SPDX-License-Identifier: Apache-2.0
// The file of those who may call a server: names, what each may do, and the
// hashes of their tokens, so that whoever reads the file cannot call.
#ifndef GROUNDLOCK_MAP_STORE_BASE_TOKEN_FILE_H_
#define GROUNDLOCK_MAP_STORE_BASE_TOKEN_FILE_H_

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::base {

// What a token may be good for. "admin" is all of them, "maps:write" includes
// "maps:read", "sessions:all" includes "sessions:watch".
inline constexpr std::array<std::string_view, 5> kScopes = {
    "maps:read", "maps:write", "sessions:watch", "sessions:all", "admin"};

struct TokenEntry {
  std::string name;  // 1 to 64 of [A-Za-z0-9._@-]
  std::vector<std::string> scopes;
  std::string sha256;  // of the token, 64 hexadecimal digits
};

// One entry a line, NAME SCOPE,SCOPE sha256:HASH; or a token as it is, which
// may do everything and is called after its line. Blank lines and lines that
// start with # do not count. kInvalidArgument names the line: a token has 16 to
// 1024 printable ASCII characters without blanks, a name occurs once.
// kFailedPrecondition: others than its owner and group may read it. A file
// without entries is one by which nobody may call.
absl::StatusOr<std::vector<TokenEntry>> ReadTokenFile(
    const std::filesystem::path& path);

// Adds an entry to the file, which is made if need be, and returns the token:
// it is shown this once. kAlreadyExists (name), kInvalidArgument (name,
// scopes).
absl::StatusOr<std::string> CreateToken(const std::filesystem::path& path,
                                        const std::string& name,
                                        const std::vector<std::string>& scopes);

// Removes an entry. kNotFound.
absl::Status RevokeToken(const std::filesystem::path& path,
                         const std::string& name);

// 64 hexadecimal digits.
std::string Sha256(std::string_view bytes);

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_TOKEN_FILE_H_
