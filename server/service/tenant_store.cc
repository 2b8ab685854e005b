// SPDX-License-Identifier: Apache-2.0
#include "server/service/tenant_store.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "map_store/base/status.h"

namespace groundlock::service {

std::string NameOfTenant(const std::string& tenant, const std::string& name) {
  return tenant.empty() ? name : absl::StrCat(tenant, "@", name);
}

TenantStore::TenantStore(storage::Store* all,
                         const std::string& tenant,
                         std::shared_ptr<const Account> account)
    : all_(all),
      prefix_(NameOfTenant(tenant, "")),
      account_(std::move(account)) {}

// Of all versions.
absl::StatusOr<std::uint64_t> TenantStore::StoredBytes() {
  std::uint64_t bytes = 0;
  ASSIGN_OR_RETURN(const auto newest, List());
  for (const storage::MapVersion& map : newest) {
    const auto versions = ListVersions(map.name);
    if (absl::IsNotFound(versions.status())) continue;  // deleted just now
    RETURN_IF_ERROR(versions.status());
    for (const storage::MapVersion& version : *versions) {
      bytes += version.info.file_bytes;
    }
  }
  return bytes;
}

// A name with a tenant in it is not one that a client may say.
absl::StatusOr<std::string> TenantStore::Stored(std::string_view name) const {
  RETURN_IF_ERROR(storage::ValidateMapName(name));
  return absl::StrCat(prefix_, base::Abseil(name));
}

absl::Status TenantStore::Shown(const absl::Status& status) const {
  if (status.ok() || prefix_.empty()) return status;
  return absl::Status(status.code(),
                      absl::StrReplaceAll(status.message(), {{prefix_, ""}}));
}

storage::MapVersion TenantStore::Shown(storage::MapVersion version) const {
  version.name.erase(0, prefix_.size());
  return version;
}

absl::Status TenantStore::CheckRoom() {
  if (account_ == nullptr || account_->quotas().stored_bytes == 0) {
    return absl::OkStatus();
  }
  ASSIGN_OR_RETURN(const std::uint64_t bytes, StoredBytes());
  return account_->CheckStoredBytes(bytes);
}

absl::StatusOr<storage::MapVersion> TenantStore::Publish(
    std::string_view name,
    const map::MapData& data,
    const std::function<absl::Status()>& ready) {
  ASSIGN_OR_RETURN(const std::string stored, Stored(name));
  RETURN_IF_ERROR(CheckRoom());
  auto version = all_->Publish(stored, data, ready);
  if (!version.ok()) return Shown(version.status());
  return Shown(*std::move(version));
}

absl::StatusOr<std::vector<storage::MapVersion>> TenantStore::List() {
  ASSIGN_OR_RETURN(std::vector<storage::MapVersion> all, all_->List());
  std::vector<storage::MapVersion> ours;
  for (storage::MapVersion& version : all) {
    const bool is_ours = prefix_.empty()
                             ? version.name.find('@') == std::string::npos
                             : version.name.starts_with(prefix_);
    if (is_ours) ours.push_back(Shown(std::move(version)));
  }
  return ours;
}

absl::StatusOr<std::vector<storage::MapVersion>> TenantStore::ListVersions(
    std::string_view name) {
  ASSIGN_OR_RETURN(const std::string stored, Stored(name));
  auto versions = all_->ListVersions(stored);
  if (!versions.ok()) return Shown(versions.status());
  for (storage::MapVersion& version : *versions) {
    version = Shown(std::move(version));
  }
  return versions;
}

absl::StatusOr<storage::MapVersion> TenantStore::Get(std::string_view name,
                                                     std::uint64_t version) {
  ASSIGN_OR_RETURN(const std::string stored, Stored(name));
  auto found = all_->Get(stored, version);
  if (!found.ok()) return Shown(found.status());
  return Shown(*std::move(found));
}

absl::StatusOr<std::shared_ptr<const map::Map>> TenantStore::Open(
    std::string_view name, std::uint64_t version) {
  ASSIGN_OR_RETURN(const std::string stored, Stored(name));
  auto map = all_->Open(stored, version);
  if (!map.ok()) return Shown(map.status());
  return map;
}

absl::Status TenantStore::Check(std::string_view name, std::uint64_t version) {
  ASSIGN_OR_RETURN(const std::string stored, Stored(name));
  return Shown(all_->Check(stored, version));
}

absl::Status TenantStore::Delete(std::string_view name) {
  ASSIGN_OR_RETURN(const std::string stored, Stored(name));
  return Shown(all_->Delete(stored));
}

absl::StatusOr<storage::GarbageReport> TenantStore::CollectGarbage(
    std::uint64_t /*keep_newest*/) {
  return absl::UnimplementedError("a tenant's store collects no garbage");
}

}  // namespace groundlock::service
