// SPDX-License-Identifier: Apache-2.0
// The file of those who may call a server: names, what each may do, and the
// hashes of their tokens, so that whoever reads the file cannot call.
#ifndef GROUNDLOCK_MAP_STORE_BASE_TOKEN_FILE_H_
#define GROUNDLOCK_MAP_STORE_BASE_TOKEN_FILE_H_

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace groundlock::base {

// What somebody may do, with what is their tenant's. "maps:write" includes
// "maps:read"; "sessions:own" is sessions that one has begun oneself,
// "sessions:watch" is seeing all of them, "sessions:all" is both, and acting on
// all of them; "admin" is everything.
inline constexpr std::array<std::string_view, 6> kScopes = {"maps:read",
                                                            "maps:write",
                                                            "sessions:own",
                                                            "sessions:watch",
                                                            "sessions:all",
                                                            "admin"};

// How much somebody may use; 0 = as much as the server has.
struct Quotas {
  std::uint64_t sessions = 0;      // at a time
  std::uint64_t frames_per_s = 0;  // and images to be localised
  std::uint64_t bytes_per_s = 0;   // of these, and of uploads
  std::uint64_t builds = 0;        // at a time
  std::uint64_t stored_bytes = 0;  // of all maps of the tenant

  friend bool operator==(const Quotas&, const Quotas&) = default;
};

struct TokenEntry {
  std::string name;  // 1 to 64 of [A-Za-z0-9._@-]
  // Whose maps and sessions are seen; empty = the tenant without a name.
  std::string tenant;
  std::vector<std::string> scopes;
  // By what they are known: "sha256:" and 64 hexadecimal digits of the token's
  // hash; or what a client's certificate says, in its common name ("cn:NAME")
  // or its subject alternative names ("dns:NAME", "uri:URI", "email:ADDRESS").
  std::string credential;
  Quotas quotas = {};

  friend bool operator==(const TokenEntry&, const TokenEntry&) = default;
};

// 1 to 32 of [A-Za-z0-9._-], with a letter or a digit first; or empty.
absl::Status ValidateTenant(std::string_view tenant);

struct TokenFile {
  std::vector<TokenEntry> entries;
  Quotas defaults;  // of those who are not in the file
};

// One entry a line, NAME SCOPE,SCOPE CREDENTIAL [tenant=TENANT] [QUOTA=N ...];
// or a token as it is, which may do everything and is called after its line. A
// line "* QUOTA=N ..." has the quotas of all who have not their own: sessions,
// frames-per-s, bytes-per-s, builds, stored-bytes; numbers may end in K, M, G
// or T (powers of 1024). Blank lines and lines that start with # do not count.
// kInvalidArgument names the line: a
// token has 16 to 1024 printable ASCII characters without blanks, names and
// credentials occur once. kFailedPrecondition: others than its owner and group
// may read it. A file without entries is one by which nobody may call.
absl::StatusOr<TokenFile> ReadTokenFile(const std::filesystem::path& path);

// Adds an entry to the file, which is made if need be. If the entry has no
// credential, a token is made for it and returned: it is shown this once.
// kAlreadyExists (name, credential), kInvalidArgument (the others). Two
// programs may do this at once.
absl::StatusOr<std::string> CreateToken(const std::filesystem::path& path,
                                        TokenEntry entry);

// Removes an entry. kNotFound.
absl::Status RevokeToken(const std::filesystem::path& path,
                         const std::string& name);

// 64 hexadecimal digits.
std::string Sha256(std::string_view bytes);

}  // namespace groundlock::base

#endif  // GROUNDLOCK_MAP_STORE_BASE_TOKEN_FILE_H_
