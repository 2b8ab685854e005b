// SPDX-License-Identifier: Apache-2.0
// What a catalogue keeps of a map's info, so that listing maps opens none.
#ifndef GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_MAP_INFO_JSON_H_
#define GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_MAP_INFO_JSON_H_

#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "map_store/map/map.h"

namespace groundlock::storage::internal {

// A JSON object; numbers are written so that they read back the same.
std::string MapInfoToJson(const map::MapInfo& info);

// Members that are not known are ignored. kDataLoss names the member that is
// absent or of another type.
absl::StatusOr<map::MapInfo> MapInfoFromJson(std::string_view text);

}  // namespace groundlock::storage::internal

#endif  // GROUNDLOCK_MAP_STORE_STORAGE_INTERNAL_MAP_INFO_JSON_H_
