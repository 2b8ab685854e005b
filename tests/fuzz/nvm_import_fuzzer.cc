// SPDX-License-Identifier: Apache-2.0
// VisualSFM's .nvm text, the cameras it leads to, and its .sift files (an input
// that starts with "SIFT").
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "map_store/formats/internal/descriptors.h"
#include "map_store/formats/internal/image_size.h"
#include "map_store/formats/internal/nvm_model.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  using namespace groundlock::formats::internal;  // NOLINT: a fuzzer's main
  const std::string_view input(reinterpret_cast<const char*>(data), size);
  if (const auto sift = SiftFile::Parse(input, "a.sift"); sift.ok()) {
    // Touches every byte that a caller may, for the address sanitizer.
    volatile float sink = 0.0F;
    for (std::size_t i = 0; i < sift->size(); ++i) {
      sink = sift->KeypointPx(i).sum();
      sink = RootSiftFromSift(sift->Descriptor(i))[0];
    }
    (void)sink;
    return 0;
  }
  (void)ImageSizeFromHeader(input);
  const auto file = ParseNvm(input, "a.nvm");
  if (!file.ok()) return 0;
  for (const NvmMeasurement& m : file->model.measurements) {
    if (m.camera >= file->model.cameras.size() ||
        m.point >= file->model.points.size()) {
      __builtin_trap();
    }
  }
  for (std::size_t i = 0; i < file->model.cameras.size() && i < 4; ++i) {
    const NvmCamera& camera = file->model.cameras[i];
    const auto fitted =
        CameraFromNvm(camera.focal_px, camera.r, 640, 480, {320, 240}, 400);
    if (fitted.ok() && !std::isfinite(fitted->max_residual_px)) {
      __builtin_trap();
    }
  }
  return 0;
}
