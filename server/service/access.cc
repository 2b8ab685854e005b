// SPDX-License-Identifier: Apache-2.0
#include "server/service/access.h"

#include <sys/stat.h>

#include <utility>

#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {
namespace {

constexpr std::string_view kScheme = "Bearer ";
constexpr std::size_t kMaxTokenBytes = 1024;
constexpr std::chrono::seconds kLookInterval(2);

unsigned ScopeBits(std::string_view scope) {
  constexpr auto kMapsRead = static_cast<unsigned>(Scope::kMapsRead);
  constexpr auto kMapsWrite = static_cast<unsigned>(Scope::kMapsWrite);
  constexpr auto kWatch = static_cast<unsigned>(Scope::kSessionsWatch);
  constexpr auto kAll = static_cast<unsigned>(Scope::kSessionsAll);
  if (scope == "maps:read") return kMapsRead;
  if (scope == "maps:write") return kMapsRead | kMapsWrite;
  if (scope == "sessions:watch") return kWatch;
  if (scope == "sessions:all") return kWatch | kAll;
  return kMapsRead | kMapsWrite | kWatch | kAll;  // admin
}

// Changes when the file does, or another takes its place; empty without one.
std::string LookOf(const std::filesystem::path& path) {
  struct stat now {};
  if (stat(path.c_str(), &now) != 0) return "";
  return absl::StrCat(now.st_ino,
                      " ",
                      now.st_size,
                      " ",
                      now.st_mtim.tv_sec,
                      " ",
                      now.st_mtim.tv_nsec);
}

const std::shared_ptr<const Principal>& Anybody() {
  static const auto* const anybody = new std::shared_ptr<const Principal>(
      std::make_shared<Principal>(Principal{"anybody", ScopeBits("admin")}));
  return *anybody;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Access>> Access::FromFile(
    const std::filesystem::path& path) {
  auto access = std::make_unique<Access>();
  access->is_open_ = false;
  access->path_ = path;
  access->seen_ = LookOf(path);
  ASSIGN_OR_RETURN(const std::vector<base::TokenEntry> entries,
                   base::ReadTokenFile(path));
  if (entries.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat(path.string(), ": no token in this file"));
  }
  access->Replace(entries);
  return access;
}

std::unique_ptr<Access> Access::FromTokens(
    const std::vector<std::string>& tokens) {
  auto access = std::make_unique<Access>();
  access->is_open_ = tokens.empty();
  std::vector<base::TokenEntry> entries;
  for (const std::string& token : tokens) {
    entries.push_back({absl::StrCat("token-", entries.size() + 1),
                       {"admin"},
                       base::Sha256(token)});
  }
  access->Replace(entries);
  return access;
}

void Access::Replace(const std::vector<base::TokenEntry>& entries) {
  auto principals = std::make_shared<Principals>();
  for (const base::TokenEntry& entry : entries) {
    auto principal = std::make_shared<Principal>();
    principal->name = entry.name;
    for (const std::string& scope : entry.scopes) {
      principal->scopes |= ScopeBits(scope);
    }
    (*principals)[entry.sha256] = std::move(principal);
  }
  base::MutexLock lock(&mutex_);
  principals_ = std::move(principals);
}

void Access::OnTick(std::chrono::steady_clock::time_point now) {
  if (path_.empty() || now < next_look_) return;
  next_look_ = now + kLookInterval;
  std::string look = LookOf(path_);
  if (look == seen_) return;
  seen_ = std::move(look);
  const auto entries = base::ReadTokenFile(path_);
  if (!entries.ok()) {
    spdlog::error("tokens: those read before hold on: {}",
                  entries.status().ToString());
    return;
  }
  Replace(*entries);
  spdlog::info("tokens: {} read from {}", entries->size(), path_.string());
}

absl::StatusOr<std::shared_ptr<const Principal>> Access::AuthenticateHeader(
    std::string_view header) const {
  if (is_open_) return Anybody();
  if (header.empty()) {
    return absl::UnauthenticatedError(
        "this server wants a token: none was given");
  }
  if (header.substr(0, kScheme.size()) != kScheme) {
    return absl::UnauthenticatedError("authorization: expected Bearer TOKEN");
  }
  const std::string_view token = header.substr(kScheme.size());
  if (token.size() <= kMaxTokenBytes) {
    std::shared_ptr<const Principals> principals;
    {
      base::MutexLock lock(&mutex_);
      principals = principals_;
    }
    const auto found = principals->find(base::Sha256(token));
    if (found != principals->end()) return found->second;
  }
  return absl::UnauthenticatedError("the token is not known");
}

absl::StatusOr<std::shared_ptr<const Principal>> Access::Authenticate(
    const grpc::CallbackServerContext& context) const {
  if (is_open_) return Anybody();
  const auto& metadata = context.client_metadata();
  const auto found = metadata.find("authorization");
  if (found == metadata.end()) return AuthenticateHeader({});
  return AuthenticateHeader({found->second.data(), found->second.size()});
}

}  // namespace groundlock::service
