// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/token_file.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <openssl/rand.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::base {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMinLength = 16;
constexpr std::size_t kMaxLength = 1024;
constexpr std::uint64_t kMaxFileBytes = 1 << 20;
constexpr std::size_t kTokenBytes = 32;
constexpr std::string_view kHash = "sha256:";

bool IsName(std::string_view name) {
  return !name.empty() && name.size() <= 64 &&
         std::all_of(name.begin(), name.end(), [](char c) {
           return absl::ascii_isalnum(static_cast<unsigned char>(c)) ||
                  std::string_view("._@-").find(c) != std::string_view::npos;
         });
}

absl::Status CheckScopes(const std::vector<std::string>& scopes) {
  for (const std::string& scope : scopes) {
    if (std::find(kScopes.begin(), kScopes.end(), scope) == kScopes.end()) {
      return absl::InvalidArgumentError(
          absl::StrCat("scope \"",
                       scope,
                       "\": expected maps:read, maps:write, sessions:watch, "
                       "sessions:all or admin"));
    }
  }
  if (scopes.empty()) return absl::InvalidArgumentError("scopes: none");
  return absl::OkStatus();
}

// The entry of line `number`; a token as it is gets its line as its name.
absl::StatusOr<TokenEntry> Parse(const std::string& line, int number) {
  const std::vector<std::string> words =
      absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
  if (words.size() == 1 && words[0] == line) {
    const bool printable = std::all_of(
        line.begin(), line.end(), [](char c) { return c > ' ' && c < '\x7f'; });
    if (line.size() < kMinLength || line.size() > kMaxLength || !printable) {
      return absl::InvalidArgumentError(
          "a token has 16 to 1024 printable characters without blanks");
    }
    return TokenEntry{absl::StrCat("line-", number), {"admin"}, Sha256(line)};
  }
  if (words.size() != 3 || !absl::StartsWith(words[2], Abseil(kHash))) {
    return absl::InvalidArgumentError(
        "expected NAME SCOPE,SCOPE sha256:HASH, or a token without blanks");
  }
  TokenEntry entry;
  entry.name = words[0];
  if (!IsName(entry.name)) {
    return absl::InvalidArgumentError(
        "a name has 1 to 64 letters, digits, '.', '_', '@' or '-'");
  }
  entry.scopes = absl::StrSplit(words[1], ',');
  RETURN_IF_ERROR(CheckScopes(entry.scopes));
  entry.sha256 = words[2].substr(kHash.size());
  const bool is_hash =
      entry.sha256.size() == 64 &&
      std::all_of(entry.sha256.begin(), entry.sha256.end(), [](char c) {
        return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f');
      });
  if (!is_hash) {
    return absl::InvalidArgumentError(
        "a hash has 64 digits of 0 to 9 and a to f");
  }
  return entry;
}

absl::StatusOr<std::vector<TokenEntry>> ParseAll(const fs::path& path,
                                                 const std::string& text) {
  std::vector<TokenEntry> entries;
  std::set<std::string> names;
  int number = 0;
  const std::vector<std::string> lines = absl::StrSplit(text, '\n');
  for (std::string line : lines) {
    ++number;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty() || line.front() == '#') continue;
    auto entry = Parse(line, number);
    if (entry.ok() && !names.insert(entry->name).second) {
      entry = absl::InvalidArgumentError(
          absl::StrCat("the name ", entry->name, " was there before"));
    }
    if (!entry.ok()) {
      return Annotate(entry.status(),
                      Std(absl::StrCat(path.string(), ":", number)));
    }
    entries.push_back(*std::move(entry));
  }
  return entries;
}

absl::Status CheckPermissions(const fs::path& path) {
  std::error_code error;
  const fs::perms permissions = fs::status(path, error).permissions();
  if (error || (permissions & (fs::perms::others_read |
                               fs::perms::others_write)) != fs::perms::none) {
    return absl::FailedPreconditionError(absl::StrCat(
        path.string(), ": everybody on this machine can read it; chmod 600"));
  }
  return absl::OkStatus();
}

// Whole or not at all, and its owner's alone.
absl::Status Write(const fs::path& path, const std::string& text) {
  const fs::path fresh = path.string() + ".new";
  unlink(fresh.c_str());
  const int fd =
      open(fresh.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd < 0) return absl::ErrnoToStatus(errno, fresh.string());
  struct stat before {};
  // A file that a service's group may read stays so.
  bool ok = stat(path.c_str(), &before) != 0 ||
            (fchmod(fd, before.st_mode & 0640) == 0 &&
             (fchown(fd, before.st_uid, before.st_gid) == 0 || geteuid() != 0));
  ok = ok &&
       write(fd, text.data(), text.size()) == static_cast<ssize_t>(text.size());
  ok = fsync(fd) == 0 && ok;
  ok = close(fd) == 0 && ok;
  if (!ok || rename(fresh.c_str(), path.c_str()) != 0) {
    const absl::Status status = absl::ErrnoToStatus(errno, path.string());
    unlink(fresh.c_str());
    return status;
  }
  return absl::OkStatus();
}

}  // namespace

std::string Sha256(std::string_view bytes) {
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned size = 0;
  EVP_Digest(bytes.data(), bytes.size(), digest, &size, EVP_sha256(), nullptr);
  return absl::BytesToHexString(
      absl::string_view(reinterpret_cast<const char*>(digest), size));
}

absl::StatusOr<std::vector<TokenEntry>> ReadTokenFile(const fs::path& path) {
  ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxFileBytes));
  RETURN_IF_ERROR(CheckPermissions(path));
  return ParseAll(path, text);
}

absl::StatusOr<std::string> CreateToken(
    const fs::path& path,
    const std::string& name,
    const std::vector<std::string>& scopes) {
  if (!IsName(name)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "name \"",
        absl::CEscape(name),
        "\": expected 1 to 64 letters, digits, '.', '_', '@' or '-'"));
  }
  RETURN_IF_ERROR(CheckScopes(scopes));
  std::string text;
  std::error_code error;
  if (fs::exists(path, error)) {
    ASSIGN_OR_RETURN(text, ReadFile(path, kMaxFileBytes));
    RETURN_IF_ERROR(CheckPermissions(path));
  }
  ASSIGN_OR_RETURN(const std::vector<TokenEntry> entries, ParseAll(path, text));
  for (const TokenEntry& entry : entries) {
    if (entry.name == name) {
      return absl::AlreadyExistsError(
          absl::StrCat(path.string(), ": has a token of ", name));
    }
  }
  unsigned char random[kTokenBytes];
  if (RAND_bytes(random, sizeof(random)) != 1) {
    return absl::InternalError("the system gives no random numbers");
  }
  std::string token = absl::WebSafeBase64Escape(
      absl::string_view(reinterpret_cast<const char*>(random), kTokenBytes));
  if (!text.empty() && text.back() != '\n') text += '\n';
  absl::StrAppend(&text,
                  name,
                  " ",
                  absl::StrJoin(scopes, ","),
                  " ",
                  Abseil(kHash),
                  Sha256(token),
                  "\n");
  RETURN_IF_ERROR(Write(path, text));
  return token;
}

absl::Status RevokeToken(const fs::path& path, const std::string& name) {
  ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxFileBytes));
  std::vector<std::string> lines = absl::StrSplit(text, '\n');
  int number = 0;
  const std::size_t before = lines.size();
  std::erase_if(lines, [&](std::string line) {
    ++number;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (line.empty() || line.front() == '#') return false;
    const auto entry = Parse(line, number);
    return entry.ok() && entry->name == name;
  });
  if (lines.size() == before) {
    return absl::NotFoundError(
        absl::StrCat(path.string(), ": has no token of ", name));
  }
  return Write(path, absl::StrJoin(lines, "\n"));
}

}  // namespace groundlock::base
