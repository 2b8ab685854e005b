// SPDX-License-Identifier: Apache-2.0
// Any bytes as COLMAP's database.db of a small model: its descriptors are read,
// or it is refused.
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

#include "map_store/formats/internal/importers.h"

namespace {

using groundlock::formats::internal::LinkedModel;

// Two views of three features, of which two are kept.
LinkedModel SmallModel() {
  LinkedModel model;
  model.data.cameras.emplace_back();
  model.data.landmarks.resize(2);
  for (const char* name : {"a.jpg", "b.jpg"}) {
    auto& view = model.data.views.emplace_back();
    view.name = name;
    view.keypoints_px.resize(2, Eigen::Vector2f(1.0F, 2.0F));
    view.landmarks = {0, 1};
    model.origins.push_back({.num_features = 3, .index = {0, 2}});
  }
  return model;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data,
                                      std::size_t size) {
  static const std::string path =
      "/tmp/colmap_database_fuzzer." + std::to_string(getpid()) + ".db";
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(reinterpret_cast<const char*>(data),
             static_cast<std::streamsize>(size));
  LinkedModel model = SmallModel();
  std::vector<std::string> lacking;
  const bool read = groundlock::formats::internal::ReadColmapDescriptors(
                        path, &model, &lacking)
                        .ok();
  unlink(path.c_str());
  if (!read) return 0;
  for (const auto& view : model.data.views) {
    if (!view.descriptors.empty() && view.descriptors.size() != 2) {
      std::abort();
    }
  }
  return 0;
}
