// SPDX-License-Identifier: Apache-2.0
#include "map_store/base/token_file.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <openssl/rand.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/file_look.h"
#include "map_store/base/status.h"

namespace groundlock::base {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMinLength = 16;
constexpr std::size_t kMaxLength = 1024;
constexpr std::uint64_t kMaxFileBytes = 1 << 20;
constexpr std::size_t kTokenBytes = 32;
constexpr std::string_view kHash = "sha256:";

// What certificates say; longer ones are nobody's.
constexpr std::size_t kMaxSubjectBytes = 255;
constexpr std::array<std::string_view, 4> kSubjects = {
    "cn:", "dns:", "uri:", "email:"};

bool IsPrintable(std::string_view text) {
  return std::all_of(
      text.begin(), text.end(), [](char c) { return c > ' ' && c < '\x7f'; });
}

bool HasOnly(std::string_view text, std::string_view others) {
  return std::all_of(text.begin(), text.end(), [others](char c) {
    return absl::ascii_isalnum(static_cast<unsigned char>(c)) ||
           others.find(c) != std::string_view::npos;
  });
}

absl::Status CheckName(const std::string& name) {
  if (!name.empty() && name.size() <= 64 && HasOnly(name, "._@-")) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "name \"",
      absl::CEscape(name),
      "\": expected 1 to 64 letters, digits, '.', '_', '@' or '-'"));
}

absl::Status CheckScopes(const std::vector<std::string>& scopes) {
  for (const std::string& scope : scopes) {
    if (std::find(kScopes.begin(), kScopes.end(), scope) == kScopes.end()) {
      return absl::InvalidArgumentError(
          absl::StrCat("scope \"",
                       absl::CEscape(scope),
                       "\": expected maps:read, maps:write, sessions:own, "
                       "sessions:watch, sessions:all or admin"));
    }
  }
  if (scopes.empty()) return absl::InvalidArgumentError("scopes: none");
  return absl::OkStatus();
}

absl::Status CheckCredential(const std::string& credential) {
  const std::string_view text = credential;
  if (text.starts_with(kHash)) {
    const std::string_view digits = text.substr(kHash.size());
    const bool is_hash =
        digits.size() == 64 &&
        std::all_of(digits.begin(), digits.end(), [](char c) {
          return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f');
        });
    if (is_hash) return absl::OkStatus();
    return absl::InvalidArgumentError(
        "sha256: expected 64 digits of 0 to 9 and a to f");
  }
  for (const std::string_view subject : kSubjects) {
    if (text.starts_with(subject) && text.size() > subject.size() &&
        text.size() <= kMaxSubjectBytes && IsPrintable(text)) {
      return absl::OkStatus();
    }
  }
  return absl::InvalidArgumentError(
      "expected sha256:HASH of a token, or cn:NAME, dns:NAME, uri:URI or "
      "email:ADDRESS of a certificate, without blanks");
}

absl::Status Check(const TokenEntry& entry) {
  RETURN_IF_ERROR(CheckName(entry.name));
  RETURN_IF_ERROR(CheckScopes(entry.scopes));
  RETURN_IF_ERROR(ValidateTenant(entry.tenant));
  return CheckCredential(entry.credential);
}

struct QuotaName {
  std::string_view name;
  std::uint64_t Quotas::*value;
};
constexpr std::array<QuotaName, 5> kQuotas = {
    {{"sessions", &Quotas::sessions},
     {"frames-per-s", &Quotas::frames_per_s},
     {"bytes-per-s", &Quotas::bytes_per_s},
     {"builds", &Quotas::builds},
     {"stored-bytes", &Quotas::stored_bytes}}};

// N, NK, NM, NG or NT.
absl::StatusOr<std::uint64_t> ParseQuota(absl::string_view text) {
  constexpr absl::string_view kUnits = "KMGT";
  int shift = 0;
  if (!text.empty()) {
    const std::size_t unit = kUnits.find(text.back());
    if (unit != absl::string_view::npos) {
      shift = 10 * (static_cast<int>(unit) + 1);
      text.remove_suffix(1);
    }
  }
  std::uint64_t number = 0;
  if (!absl::SimpleAtoi(text, &number) ||
      number > (std::uint64_t{1} << 60 >> shift)) {
    return absl::InvalidArgumentError("expected a number, as 20, 500M or 2G");
  }
  return number << shift;
}

// tenant=NAME, or QUOTA=N. seen: the keys so far.
absl::Status ParseOption(const std::string& word,
                         std::set<std::string>& seen,
                         TokenEntry& entry) {
  const std::size_t equals = word.find('=');
  const std::string key = word.substr(0, equals);
  const std::string value =
      equals == std::string::npos ? "" : word.substr(equals + 1);
  const auto wrong = [&word](const absl::string_view why) {
    return absl::InvalidArgumentError(
        absl::StrCat("\"", absl::CEscape(word), "\": ", why));
  };
  if (value.empty() || !seen.insert(key).second) {
    return wrong("expected KEY=VALUE, each once");
  }
  if (key == "tenant") {
    entry.tenant = value;
    return absl::OkStatus();
  }
  for (const QuotaName& quota : kQuotas) {
    if (quota.name != key) continue;
    const auto number = ParseQuota(value);
    if (!number.ok()) return wrong(number.status().message());
    entry.quotas.*quota.value = *number;
    return absl::OkStatus();
  }
  return wrong(
      "expected tenant, sessions, frames-per-s, bytes-per-s, builds or "
      "stored-bytes");
}

// The entry of line `number`; a token as it is gets its line as its name.
absl::StatusOr<TokenEntry> Parse(const std::string& line,
                                 int number,
                                 const Quotas& defaults) {
  const std::vector<std::string> words =
      absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
  if (words.size() == 1 && words[0] == line) {
    if (line.size() < kMinLength || line.size() > kMaxLength ||
        !IsPrintable(line)) {
      return absl::InvalidArgumentError(
          "a token has 16 to 1024 printable characters without blanks");
    }
    return TokenEntry{absl::StrCat("line-", number),
                      "",
                      {"admin"},
                      absl::StrCat(Abseil(kHash), Sha256(line)),
                      defaults};
  }
  if (words.size() < 3) {
    return absl::InvalidArgumentError(
        "expected NAME SCOPE,SCOPE CREDENTIAL, or a token without blanks");
  }
  TokenEntry entry;
  entry.quotas = defaults;
  entry.name = words[0];
  entry.scopes = absl::StrSplit(words[1], ',');
  entry.credential = words[2];
  std::set<std::string> seen;
  for (std::size_t i = 3; i < words.size(); ++i) {
    RETURN_IF_ERROR(ParseOption(words[i], seen, entry));
  }
  RETURN_IF_ERROR(Check(entry));
  return entry;
}

std::string Format(const TokenEntry& entry) {
  std::string line = absl::StrCat(
      entry.name, " ", absl::StrJoin(entry.scopes, ","), " ", entry.credential);
  if (!entry.tenant.empty()) absl::StrAppend(&line, " tenant=", entry.tenant);
  for (const QuotaName& quota : kQuotas) {
    if (entry.quotas.*quota.value == 0) continue;
    absl::StrAppend(
        &line, " ", Abseil(quota.name), "=", entry.quotas.*quota.value);
  }
  return line + "\n";
}

bool IsDefaults(absl::string_view line) {
  return line == "*" || absl::StartsWith(line, "* ") ||
         absl::StartsWith(line, "*\t");
}

bool IsComment(absl::string_view line) {
  return line.empty() || line.front() == '#';
}

// "* QUOTA=N ...", which counts wherever it is.
absl::StatusOr<Quotas> ParseDefaults(const fs::path& path,
                                     const std::vector<std::string>& lines) {
  Quotas defaults;
  bool found = false;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    std::vector<std::string> words =
        absl::StrSplit(lines[i], absl::ByAnyChar(" \t\r"), absl::SkipEmpty());
    if (!IsDefaults(lines[i])) continue;
    TokenEntry entry;
    std::set<std::string> seen = {"tenant"};
    absl::Status status =
        found ? absl::InvalidArgumentError("a second line of defaults")
              : absl::OkStatus();
    for (std::size_t w = 1; status.ok() && w < words.size(); ++w) {
      status = ParseOption(words[w], seen, entry);
    }
    if (!status.ok()) {
      return Annotate(status, Std(absl::StrCat(path.string(), ":", i + 1)));
    }
    defaults = entry.quotas;
    found = true;
  }
  return defaults;
}

absl::StatusOr<TokenFile> ParseAll(const fs::path& path,
                                   const std::string& text) {
  TokenFile file;
  std::set<std::string> names;
  std::set<std::string> credentials;
  int number = 0;
  const std::vector<std::string> lines = absl::StrSplit(text, '\n');
  ASSIGN_OR_RETURN(file.defaults, ParseDefaults(path, lines));
  for (std::string line : lines) {
    ++number;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (IsComment(line) || IsDefaults(line)) continue;
    auto entry = Parse(line, number, file.defaults);
    if (entry.ok() && !names.insert(entry->name).second) {
      entry = absl::InvalidArgumentError(
          absl::StrCat("the name ", entry->name, " was there before"));
    }
    if (entry.ok() && !credentials.insert(entry->credential).second) {
      entry = absl::InvalidArgumentError(
          "the token or certificate was there before, under another name");
    }
    if (!entry.ok()) {
      return Annotate(entry.status(),
                      Std(absl::StrCat(path.string(), ":", number)));
    }
    file.entries.push_back(*std::move(entry));
  }
  return file;
}

// Holds off others who change files of the same folder, while it exists.
class FolderLock {
 public:
  static absl::StatusOr<FolderLock> Take(const fs::path& file) {
    const fs::path folder = file.has_parent_path() ? file.parent_path() : ".";
    FolderLock lock(open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (lock.fd_ < 0 || flock(lock.fd_, LOCK_EX) != 0) {
      return absl::ErrnoToStatus(errno, folder.string());
    }
    return lock;
  }
  FolderLock(FolderLock&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  FolderLock& operator=(FolderLock&&) = delete;
  ~FolderLock() {
    if (fd_ >= 0) close(fd_);
  }

 private:
  explicit FolderLock(int fd) : fd_(fd) {}
  int fd_;
};

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

absl::Status ValidateTenant(std::string_view tenant) {
  if (tenant.empty() ||
      (tenant.size() <= 32 && HasOnly(tenant.substr(0, 1), "") &&
       HasOnly(tenant, "._-"))) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "tenant \"",
      absl::CEscape(Abseil(tenant)),
      "\": expected 1 to 32 letters, digits, '.', '_' or '-', and a letter or "
      "digit first"));
}

absl::StatusOr<TokenFile> ReadTokenFile(const fs::path& path) {
  ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxFileBytes));
  RETURN_IF_ERROR(CheckPrivate(path));
  return ParseAll(path, text);
}

absl::StatusOr<std::string> CreateToken(const fs::path& path,
                                        TokenEntry entry) {
  std::string token;
  if (entry.credential.empty()) {
    unsigned char random[kTokenBytes];
    if (RAND_bytes(random, sizeof(random)) != 1) {
      return absl::InternalError("the system gives no random numbers");
    }
    token = absl::WebSafeBase64Escape(
        absl::string_view(reinterpret_cast<const char*>(random), kTokenBytes));
    entry.credential = absl::StrCat(Abseil(kHash), Sha256(token));
  }
  RETURN_IF_ERROR(Check(entry));
  ASSIGN_OR_RETURN(const FolderLock lock, FolderLock::Take(path));
  std::string text;
  std::error_code error;
  if (fs::exists(path, error)) {
    ASSIGN_OR_RETURN(text, ReadFile(path, kMaxFileBytes));
    RETURN_IF_ERROR(CheckPrivate(path));
  }
  ASSIGN_OR_RETURN(const TokenFile before, ParseAll(path, text));
  for (const TokenEntry& other : before.entries) {
    if (other.name == entry.name || other.credential == entry.credential) {
      return absl::AlreadyExistsError(
          absl::StrCat(path.string(),
                       ": has ",
                       other.name,
                       other.name == entry.name ? "" : " with that credential",
                       " already"));
    }
  }
  if (!text.empty() && text.back() != '\n') text += '\n';
  RETURN_IF_ERROR(Write(path, text + Format(entry)));
  return token;
}

absl::Status RevokeToken(const fs::path& path, const std::string& name) {
  ASSIGN_OR_RETURN(const FolderLock lock, FolderLock::Take(path));
  ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxFileBytes));
  std::vector<std::string> lines = absl::StrSplit(text, '\n');
  int number = 0;
  const std::size_t before = lines.size();
  std::erase_if(lines, [&](std::string line) {
    ++number;
    if (!line.empty() && line.back() == '\r') line.pop_back();
    if (IsComment(line) || IsDefaults(line)) return false;
    const auto entry = Parse(line, number, {});
    return entry.ok() && entry->name == name;
  });
  if (lines.size() == before) {
    return absl::NotFoundError(
        absl::StrCat(path.string(), ": has nobody called ", name));
  }
  return Write(path, absl::StrJoin(lines, "\n"));
}

}  // namespace groundlock::base
