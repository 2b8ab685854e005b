// SPDX-License-Identifier: Apache-2.0
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/storage/internal/backends.h"
#include "map_store/storage/internal/postgres_address.h"
#include "map_store/storage/store.h"

namespace groundlock::storage {
namespace internal {

absl::Status NoSuchMap(std::string_view name, std::uint64_t version) {
  return absl::NotFoundError(
      version == 0
          ? absl::StrCat("no map '", base::Abseil(name), "'")
          : absl::StrCat(
                "no version ", version, " of map '", base::Abseil(name), "'"));
}

absl::Status CheckIdentity(const map::Map& map,
                           const map::MapInfo& expected,
                           const std::string& where) {
  if (map.info().content_hash == expected.content_hash) {
    return absl::OkStatus();
  }
  return absl::DataLossError(
      absl::StrCat(where,
                   ": not the map that the catalogue knows: content hash ",
                   map.info().content_hash,
                   " instead of ",
                   expected.content_hash));
}

}  // namespace internal

absl::Status ValidateMapName(std::string_view name) {
  constexpr std::string_view kAllowed =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-";
  if (name.empty() || name.size() > 64 || name.front() == '.' ||
      name.front() == '-' ||
      name.find_first_not_of(kAllowed) != std::string_view::npos) {
    return absl::InvalidArgumentError(
        "map name: must have 1 to 64 characters of A-Z, a-z, 0-9, '.', '_', "
        "'-' and not start with '.' or '-'");
  }
  return absl::OkStatus();
}

absl::Status ValidateStoredName(std::string_view name) {
  const std::size_t at = name.find('@');
  if (at == std::string_view::npos) return ValidateMapName(name);
  const std::string_view tenant = name.substr(0, at);
  if (tenant.size() > 32 || tenant.starts_with('_')) {
    return absl::InvalidArgumentError(
        "map name: a tenant's has 1 to 32 characters, a letter or a digit "
        "first");
  }
  RETURN_IF_ERROR(ValidateMapName(tenant));
  return ValidateMapName(name.substr(at + 1));
}

absl::StatusOr<std::unique_ptr<Store>> OpenStore(const std::string& location,
                                                 const CacheOptions& cache) {
  if (location.empty()) {
    return absl::InvalidArgumentError("store: no directory given");
  }
  if (internal::IsPostgresUrl(location)) {
    return internal::OpenPostgresStore(location, cache);
  }
  if (absl::StrContains(location, "://")) {
    return absl::UnimplementedError(
        absl::StrCat("store: ",
                     location.substr(0, location.find("://")),
                     ":// is not supported; give a directory or "
                     "postgresql://USER@HOST:PORT/DATABASE"));
  }
  return internal::OpenDirectoryStore(location);
}

std::string WithoutPassword(const std::string& location) {
  return internal::IsPostgresUrl(location)
             ? internal::UrlWithoutPassword(location)
             : location;
}

}  // namespace groundlock::storage
