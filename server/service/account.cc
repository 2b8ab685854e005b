// SPDX-License-Identifier: Apache-2.0
#include "server/service/account.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::service {
namespace {

// Beyond it, those of principals that have nothing under way are forgotten.
constexpr std::size_t kMaxAccounts = 10'000;

}  // namespace

void RateMeter::Fill(double rate, std::chrono::steady_clock::time_point now) {
  const std::chrono::duration<double> passed =
      begun_ ? now - filled_ : std::chrono::seconds(1);
  begun_ = true;
  filled_ = now;
  left_ = std::min(rate, left_ + rate * passed.count());
}

bool RateMeter::IsEmpty(double rate,
                        std::chrono::steady_clock::time_point now) {
  Fill(rate, now);
  return left_ <= 0.0;
}

bool RateMeter::Take(double units,
                     double rate,
                     std::chrono::steady_clock::time_point now) {
  if (IsEmpty(rate, now)) return false;
  left_ -= units;
  return true;
}

absl::Status Account::Exceeded(std::string_view quota,
                               std::uint64_t limit) const {
  if (refused_ != nullptr) ++*refused_;
  return absl::ResourceExhaustedError(absl::StrCat("quota ",
                                                   base::Abseil(quota),
                                                   ": the caller is allowed ",
                                                   limit,
                                                   ", and has used them up"));
}

void Account::SetQuotas(const base::Quotas& quotas) {
  base::MutexLock lock(&mutex_);
  quotas_ = quotas;
}

base::Quotas Account::quotas() const {
  base::MutexLock lock(&mutex_);
  return quotas_;
}

absl::Status Account::TakeFrame(std::size_t bytes) {
  const auto now = std::chrono::steady_clock::now();
  base::MutexLock lock(&mutex_);
  const auto frames = static_cast<double>(quotas_.frames_per_s);
  const auto rate = static_cast<double>(quotas_.bytes_per_s);
  if (quotas_.bytes_per_s != 0 && bytes_.IsEmpty(rate, now)) {
    return Exceeded("bytes-per-s", quotas_.bytes_per_s);
  }
  if (quotas_.frames_per_s != 0 && !frames_.Take(1.0, frames, now)) {
    return Exceeded("frames-per-s", quotas_.frames_per_s);
  }
  if (quotas_.bytes_per_s != 0) {
    bytes_.Take(static_cast<double>(bytes), rate, now);
  }
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<void>> Account::Take(
    std::string_view quota,
    std::uint64_t base::Quotas::*limit,
    std::uint64_t Account::*used) {
  base::MutexLock lock(&mutex_);
  const std::uint64_t allowed = quotas_.*limit;
  if (allowed != 0 && this->*used >= allowed) return Exceeded(quota, allowed);
  ++(this->*used);
  return std::shared_ptr<void>(nullptr,
                               [self = shared_from_this(), used](void*) {
                                 base::MutexLock return_lock(&self->mutex_);
                                 --(self.get()->*used);
                               });
}

absl::StatusOr<std::shared_ptr<void>> Account::TakeSession() {
  return Take("sessions", &base::Quotas::sessions, &Account::sessions_);
}

absl::StatusOr<std::shared_ptr<void>> Account::TakeBuild() {
  return Take("builds", &base::Quotas::builds, &Account::builds_);
}

absl::Status Account::CheckStoredBytes(std::uint64_t there) const {
  base::MutexLock lock(&mutex_);
  if (quotas_.stored_bytes == 0 || there < quotas_.stored_bytes) {
    return absl::OkStatus();
  }
  return Exceeded("stored-bytes", quotas_.stored_bytes);
}

void Account::AddUploaded(std::size_t bytes) {
  base::MutexLock lock(&mutex_);
  if (quotas_.bytes_per_s == 0) return;
  bytes_.Take(static_cast<double>(bytes),
              static_cast<double>(quotas_.bytes_per_s),
              std::chrono::steady_clock::now());
}

bool Account::MayUpload() {
  base::MutexLock lock(&mutex_);
  return quotas_.bytes_per_s == 0 ||
         !bytes_.IsEmpty(static_cast<double>(quotas_.bytes_per_s),
                         std::chrono::steady_clock::now());
}

std::shared_ptr<Account> Ledger::Find(const std::string& tenant,
                                      const std::string& name) {
  base::MutexLock lock(&mutex_);
  std::shared_ptr<Account>& account = accounts_[{tenant, name}];
  if (account == nullptr) account = std::make_shared<Account>(refused_);
  const std::shared_ptr<Account> found = account;
  if (accounts_.size() > kMaxAccounts) {
    std::erase_if(accounts_, [](const auto& entry) {
      return entry.second.use_count() == 1;
    });
  }
  return found;
}

}  // namespace groundlock::service
