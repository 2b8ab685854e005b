// SPDX-License-Identifier: Apache-2.0
#include "server/service/access.h"

#include <grpc/grpc_security_constants.h>

#include <utility>

#include "map_store/base/file_look.h"
#include "map_store/base/status.h"
#include "spdlog/spdlog.h"

namespace groundlock::service {
namespace {

constexpr std::string_view kScheme = "Bearer ";
// gRPC's own limit of all metadata is as large.
constexpr std::size_t kMaxTokenBytes = 8 << 10;
constexpr std::chrono::seconds kLookInterval(2);

const std::shared_ptr<const Principal>& Anybody() {
  static const auto* const anybody = new std::shared_ptr<const Principal>([] {
    auto principal = std::make_shared<Principal>();
    principal->name = "anybody";
    principal->scopes = ScopesOf("admin");
    return principal;
  }());
  return *anybody;
}

// What the client's certificate says, if it has shown one: gRPC has checked
// that an authority which we believe has signed it.
std::vector<std::string> SubjectsOf(const grpc::CallbackServerContext& call) {
  std::vector<std::string> subjects;
  const auto auth = call.auth_context();
  if (auth == nullptr || !auth->IsPeerAuthenticated()) return subjects;
  for (const auto& [property, prefix] :
       {std::pair(GRPC_PEER_DNS_PROPERTY_NAME, "dns:"),
        std::pair(GRPC_PEER_URI_PROPERTY_NAME, "uri:"),
        std::pair(GRPC_PEER_EMAIL_PROPERTY_NAME, "email:"),
        std::pair(GRPC_X509_CN_PROPERTY_NAME, "cn:")}) {
    for (const grpc::string_ref& value : auth->FindPropertyValues(property)) {
      subjects.push_back(
          absl::StrCat(prefix, absl::string_view(value.data(), value.size())));
    }
  }
  return subjects;
}

}  // namespace

Access::Access(AccessOptions options, std::atomic<std::uint64_t>* over_quota)
    : options_(std::move(options)),
      is_open_(options_.token_file.empty() && options_.tokens.empty() &&
               options_.jwt.keys.empty()),
      ledger_(over_quota) {}

absl::StatusOr<std::unique_ptr<Access>> Access::Create(
    AccessOptions options, std::atomic<std::uint64_t>* over_quota) {
  std::unique_ptr<Access> access(new Access(std::move(options), over_quota));
  base::TokenFile given;
  for (const std::string& token : access->options_.tokens) {
    given.entries.push_back({absl::StrCat("token-", given.entries.size() + 1),
                             "",
                             {"admin"},
                             absl::StrCat("sha256:", base::Sha256(token))});
  }
  access->Replace(std::move(given));
  base::MutexLock lock(&access->files_mutex_);
  if (!access->options_.token_file.empty()) {
    RETURN_IF_ERROR(access->ReadTokens());
    if (access->book()->empty()) {
      return absl::FailedPreconditionError(
          absl::StrCat(access->options_.token_file.string(),
                       ": no token and no certificate in this file"));
    }
  }
  if (!access->options_.jwt.keys.empty()) {
    RETURN_IF_ERROR(access->ReadJwtKeys());
  }
  return access;
}

std::shared_ptr<const Access::Book> Access::book() const {
  base::MutexLock lock(&mutex_);
  return book_;
}

// Whoever is in the file as before stays the same principal, and calls that
// others have under way end.
void Access::Replace(base::TokenFile file) {
  const std::shared_ptr<const Book> before = book();
  auto book = std::make_shared<Book>();
  for (base::TokenEntry& entry : file.entries) {
    const std::string credential = entry.credential;
    Known& known = (*book)[credential];
    // Whoever may do less at a time from now on is the same for all that.
    const auto account = ledger_.Find(entry.tenant, entry.name);
    account->SetQuotas(std::exchange(entry.quotas, {}));
    if (before != nullptr) {
      const auto found = before->find(credential);
      if (found != before->end() && found->second.entry == entry) {
        known = found->second;
        continue;
      }
    }
    auto principal = std::make_shared<Principal>();
    principal->name = entry.name;
    principal->tenant = entry.tenant;
    for (const std::string& scope : entry.scopes) {
      principal->scopes |= ScopesOf(scope);
    }
    known.withdrawn = std::make_shared<std::atomic<bool>>(false);
    principal->withdrawn = known.withdrawn;
    principal->account = account;
    known.principal = std::move(principal);
    known.entry = std::move(entry);
  }
  {
    base::MutexLock lock(&mutex_);
    book_ = book;
    default_quotas_ = file.defaults;
  }
  if (before == nullptr) return;
  for (const auto& [credential, known] : *before) {
    const auto found = book->find(credential);
    if (found == book->end() || found->second.principal != known.principal) {
      *known.withdrawn = true;
    }
  }
}

absl::Status Access::ReadTokens() {
  tokens_look_ = base::LookOf(options_.token_file);
  ASSIGN_OR_RETURN(base::TokenFile file,
                   base::ReadTokenFile(options_.token_file));
  Replace(std::move(file));
  return absl::OkStatus();
}

absl::Status Access::ReadJwtKeys() {
  jwt_look_ = JwtVerifier::LookOf(options_.jwt.keys);
  ASSIGN_OR_RETURN(std::shared_ptr<const JwtVerifier> next,
                   JwtVerifier::Load(options_.jwt));
  std::shared_ptr<const JwtVerifier> before;
  {
    base::MutexLock lock(&mutex_);
    before = std::exchange(jwt_, next);
  }
  if (before != nullptr) before->Withdraw(next.get());
  return absl::OkStatus();
}

void Access::Look(bool always) {
  base::MutexLock lock(&files_mutex_);
  if (!options_.token_file.empty() &&
      (always || base::LookOf(options_.token_file) != tokens_look_)) {
    const absl::Status read = ReadTokens();
    if (read.ok()) {
      spdlog::info("access: {} tokens and certificates read from {}",
                   book()->size(),
                   options_.token_file.string());
    } else {
      spdlog::error("access: the tokens read before hold on: {}",
                    read.ToString());
    }
  }
  if (!options_.jwt.keys.empty() &&
      (always || JwtVerifier::LookOf(options_.jwt.keys) != jwt_look_)) {
    const absl::Status read = ReadJwtKeys();
    if (read.ok()) {
      spdlog::info("access: keys read from {}", options_.jwt.keys.string());
    } else {
      spdlog::error("access: the keys read before hold on: {}",
                    read.ToString());
    }
  }
}

void Access::Reload() { Look(/*always=*/true); }

void Access::OnTick(std::chrono::steady_clock::time_point now) {
  if (now < next_look_) return;
  next_look_ = now + kLookInterval;
  Look(/*always=*/false);
}

absl::StatusOr<std::shared_ptr<const Principal>> Access::AuthenticateHeader(
    std::string_view header) const {
  if (is_open_) return Anybody();
  if (header.substr(0, kScheme.size()) != kScheme) {
    return absl::UnauthenticatedError("authorization: expected Bearer TOKEN");
  }
  const std::string_view token = header.substr(kScheme.size());
  if (token.size() > kMaxTokenBytes) {
    return absl::UnauthenticatedError("the token is too long");
  }
  std::shared_ptr<const Book> book;
  std::shared_ptr<const JwtVerifier> jwt;
  base::Quotas quotas;
  {
    base::MutexLock lock(&mutex_);
    book = book_;
    quotas = default_quotas_;
    jwt = jwt_;
  }
  const auto found = book->find(absl::StrCat("sha256:", base::Sha256(token)));
  if (found != book->end()) return found->second.principal;
  if (jwt != nullptr && LooksLikeJwt(token)) {
    ASSIGN_OR_RETURN(Principal principal,
                     jwt->Verify(token, std::chrono::system_clock::now()));
    principal.account = ledger_.Find(principal.tenant, principal.name);
    principal.account->SetQuotas(quotas);
    return std::make_shared<const Principal>(std::move(principal));
  }
  return absl::UnauthenticatedError("the token is not known");
}

absl::StatusOr<std::shared_ptr<const Principal>> Access::AuthenticateSubjects(
    const std::vector<std::string>& subjects) const {
  if (is_open_) return Anybody();
  if (subjects.empty()) {
    return absl::UnauthenticatedError(
        "this server wants to know who calls: no token was given");
  }
  const std::shared_ptr<const Book> book = this->book();
  std::shared_ptr<const Principal> principal;
  for (const std::string& subject : subjects) {
    const auto found = book->find(subject);
    if (found == book->end() || found->second.principal == principal) continue;
    if (principal != nullptr) {
      return absl::UnauthenticatedError(
          absl::StrCat("the certificate is that of both ",
                       principal->name,
                       " and ",
                       found->second.principal->name));
    }
    principal = found->second.principal;
  }
  if (principal != nullptr) return principal;
  return absl::UnauthenticatedError(
      "the certificate is nobody's that is known, and no token was given");
}

absl::StatusOr<std::shared_ptr<const Principal>> Access::Authenticate(
    const grpc::CallbackServerContext& context) const {
  if (is_open_) return Anybody();
  const auto& metadata = context.client_metadata();
  const auto found = metadata.find("authorization");
  if (found == metadata.end()) return AuthenticateSubjects(SubjectsOf(context));
  return AuthenticateHeader({found->second.data(), found->second.size()});
}

}  // namespace groundlock::service
