// SPDX-License-Identifier: Apache-2.0
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_ADDRESS_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_ADDRESS_H_

#include <string>
#include <string_view>

#include "absl/status/status.h"

namespace groundlock::storage::internal {

// Starts with "postgresql://" or "postgres://".
bool IsPostgresUrl(std::string_view text);

// kInvalidArgument says what libpq cannot parse, without showing a password.
absl::Status ValidatePostgresUrl(const std::string& url);

// The URL with everything that is or may be a password replaced by "***". Also
// for URLs that cannot be parsed.
std::string UrlWithoutPassword(const std::string& url);

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_POSTGRES_ADDRESS_H_
