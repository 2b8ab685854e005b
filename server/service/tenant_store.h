// SPDX-License-Identifier: Apache-2.0
// The maps of one tenant: a store in which there are no others.
#ifndef GROUNDLOCK_SERVER_SERVICE_TENANT_STORE_H_
#define GROUNDLOCK_SERVER_SERVICE_TENANT_STORE_H_

#include <memory>
#include <string>
#include <vector>

#include "map_store/storage/store.h"
#include "server/service/account.h"

namespace groundlock::service {

// What is a tenant's, as one names it where tenants meet: "TENANT@NAME", which
// is no name that a client may choose; for the tenant without a name, NAME.
std::string NameOfTenant(const std::string& tenant, const std::string& name);

// Adds the tenant to names on their way in, and takes it off on their way out,
// messages of errors included. Thread-safe.
class TenantStore final : public storage::Store {
 public:
  // all: must outlive it. account: of whoever uses it; null = nobody looks.
  TenantStore(storage::Store* all,
              const std::string& tenant,
              std::shared_ptr<const Account> account = nullptr);

  std::string Description() const override { return all_->Description(); }
  // kResourceExhausted too: the tenant's maps take what the account may store.
  // kResourceExhausted: what is stored has reached the account's quota, so that
  // nothing more will be published.
  absl::Status CheckRoom();

  using Store::Publish;
  absl::StatusOr<storage::MapVersion> Publish(
      std::string_view name,
      const map::MapData& data,
      const std::function<absl::Status()>& ready) override;
  absl::StatusOr<std::vector<storage::MapVersion>> List() override;
  absl::StatusOr<std::vector<storage::MapVersion>> ListVersions(
      std::string_view name) override;
  absl::StatusOr<storage::MapVersion> Get(std::string_view name,
                                          std::uint64_t version) override;
  absl::StatusOr<std::shared_ptr<const map::Map>> Open(
      std::string_view name, std::uint64_t version) override;
  absl::Status Check(std::string_view name, std::uint64_t version) override;
  absl::Status Delete(std::string_view name) override;
  // kUnimplemented: it is done for all at once.
  absl::StatusOr<storage::GarbageReport> CollectGarbage(
      std::uint64_t keep_newest) override;

 private:
  absl::StatusOr<std::string> Stored(std::string_view name) const;
  absl::Status Shown(const absl::Status& status) const;
  storage::MapVersion Shown(storage::MapVersion version) const;

  absl::StatusOr<std::uint64_t> StoredBytes();

  storage::Store* const all_;
  const std::string prefix_;  // "TENANT@", or empty
  const std::shared_ptr<const Account> account_;
};

}  // namespace groundlock::service

#endif  // GROUNDLOCK_SERVER_SERVICE_TENANT_STORE_H_
