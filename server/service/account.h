// SPDX-License-Identifier: Apache-2.0
// How much a principal uses, and how much it may.
#ifndef GROUNDLOCK_SERVER_SERVICE_ACCOUNT_H_
#define GROUNDLOCK_SERVER_SERVICE_ACCOUNT_H_

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "map_store/base/mutex.h"
#include "map_store/base/token_file.h"

namespace groundlock::service {

// Lets through `rate` units a second in the mean, and of what has been saved up
// a second's worth at once. Thread-safe with its owner's lock only.
class RateMeter {
 public:
  // Takes the units if there is anything left: what is taken may exceed it,
  // which the next ones pay for.
  bool Take(double units,
            double rate,
            std::chrono::steady_clock::time_point now);
  bool IsEmpty(double rate, std::chrono::steady_clock::time_point now);

 private:
  void Fill(double rate, std::chrono::steady_clock::time_point now);
  double left_ = 0.0;
  bool begun_ = false;
  std::chrono::steady_clock::time_point filled_;
};

// Thread-safe.
class Account : public std::enable_shared_from_this<Account> {
 public:
  // refused: counts what is; null = nobody counts.
  explicit Account(std::atomic<std::uint64_t>* refused) : refused_(refused) {}
  Account(const Account&) = delete;
  Account& operator=(const Account&) = delete;

  void SetQuotas(const base::Quotas& quotas);
  base::Quotas quotas() const;

  // Each kResourceExhausted, naming the quota.
  //
  // A frame, or an image to be localised.
  absl::Status TakeFrame(std::size_t bytes);
  // Room for a session, or a build, for as long as what is returned exists.
  absl::StatusOr<std::shared_ptr<void>> TakeSession();
  absl::StatusOr<std::shared_ptr<void>> TakeBuild();
  // there: the bytes of the maps that there are.
  absl::Status CheckStoredBytes(std::uint64_t there) const;

  // Bytes of an upload, which are never refused, but slow down the next ones.
  void AddUploaded(std::size_t bytes);
  // Whether an upload may go on.
  bool MayUpload();

 private:
  absl::Status Exceeded(std::string_view quota, std::uint64_t limit) const;
  absl::StatusOr<std::shared_ptr<void>> Take(std::string_view quota,
                                             std::uint64_t base::Quotas::*limit,
                                             std::uint64_t Account::*used);

  std::atomic<std::uint64_t>* const refused_;
  mutable base::Mutex mutex_;
  base::Quotas quotas_ ABSL_GUARDED_BY(mutex_);
  RateMeter frames_ ABSL_GUARDED_BY(mutex_);
  RateMeter bytes_ ABSL_GUARDED_BY(mutex_);
  // Guarded likewise; a pointer to a member hides that from the compiler.
  std::uint64_t sessions_ = 0;
  std::uint64_t builds_ = 0;
};

// The accounts of all principals, which outlive the calls and the tokens by
// which they are known. Thread-safe.
class Ledger {
 public:
  explicit Ledger(std::atomic<std::uint64_t>* refused) : refused_(refused) {}
  // Of whoever has the name in the tenant.
  std::shared_ptr<Account> Find(const std::string& tenant,
                                const std::string& name);

 private:
  std::atomic<std::uint64_t>* const refused_;
  base::Mutex mutex_;
  std::map<std::pair<std::string, std::string>, std::shared_ptr<Account>>
      accounts_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_ACCOUNT_H_
