// SPDX-License-Identifier: Apache-2.0
// OpenSfM's reconstruction.json and, after a form feed, tracks.csv; without
// one, the whole input is also taken for positions of photos.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "map_store/formats/exif.h"
#include "map_store/formats/internal/opensfm_model.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using namespace groundlock::formats;            // NOLINT: a fuzzer's main
  using namespace groundlock::formats::internal;  // NOLINT
  const std::string_view input(reinterpret_cast<const char*>(data), size);
  const std::size_t split = std::min(input.find('\f'), input.size());
  if (split == input.size()) (void)ParsePhotoPositions(input, "gps.csv");
  const auto model =
      ParseOpenSfm(input.substr(0, split), "reconstruction.json");
  if (!model.ok()) return 0;
  for (const OpenSfmShot& shot : model->shots) {
    if (shot.camera >= model->cameras.size()) __builtin_trap();
  }
  if (split == input.size()) return 0;
  const auto tracks =
      ParseOpenSfmTracks(input.substr(split + 1), "tracks.csv", *model);
  if (!tracks.ok()) return 0;
  for (const OpenSfmObservation& o : *tracks) {
    if (o.shot >= model->shots.size() || o.point >= model->points.size()) {
      __builtin_trap();
    }
  }
  return 0;
}
