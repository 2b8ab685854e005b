// SPDX-License-Identifier: Apache-2.0
// A map's info as a catalogue keeps it: what is read is written the same.
#include <cstdlib>
#include <string_view>

#include "map_store/storage/internal/map_info_json.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using groundlock::storage::internal::MapInfoFromJson;
  using groundlock::storage::internal::MapInfoToJson;
  const auto info =
      MapInfoFromJson({reinterpret_cast<const char*>(data), size});
  if (!info.ok()) return 0;
  const std::string text = MapInfoToJson(*info);
  const auto again = MapInfoFromJson(text);
  if (!again.ok() || MapInfoToJson(*again) != text) std::abort();
  return 0;
}
