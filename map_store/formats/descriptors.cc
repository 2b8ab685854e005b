// SPDX-License-Identifier: Apache-2.0
#include "map_store/formats/internal/descriptors.h"

#include <algorithm>

#include "absl/container/flat_hash_set.h"
#include "map_store/base/status.h"
#include "map_store/formats/internal/importers.h"

namespace groundlock::formats::internal {
namespace {

// Drops landmarks that no view observes any more.
void DropUnobserved(map::MapData* data) {
  std::vector<std::uint32_t> new_index(data->landmarks.size(), 0);
  for (const map::MapViewData& view : data->views) {
    for (const std::uint32_t landmark : view.landmarks) new_index[landmark] = 1;
  }
  std::uint32_t count = 0;
  for (std::size_t i = 0; i < data->landmarks.size(); ++i) {
    if (new_index[i] == 0) continue;
    data->landmarks[count] = data->landmarks[i];
    new_index[i] = count++;
  }
  data->landmarks.resize(count);
  for (map::MapViewData& view : data->views) {
    for (std::uint32_t& landmark : view.landmarks) {
      landmark = new_index[landmark];
    }
  }
}

std::string SomeNames(const std::vector<std::string>& names) {
  constexpr std::size_t kShown = 3;
  std::string text;
  for (std::size_t i = 0; i < std::min(names.size(), kShown); ++i) {
    absl::StrAppend(&text, i == 0 ? "" : ", ", names[i]);
  }
  if (names.size() > kShown) text += ", ...";
  return text;
}

}  // namespace

void SettleDescriptors(const std::vector<std::string>& lacking,
                       std::string_view source,
                       map::MapData* data,
                       std::vector<std::string>* warnings) {
  if (lacking.empty()) return;
  const absl::flat_hash_set<std::string> lacks(lacking.begin(), lacking.end());
  std::size_t num_with = 0;
  std::size_t num_without = 0;
  for (const map::MapViewData& view : data->views) {
    (lacks.contains(view.name) ? num_without : num_with) +=
        view.landmarks.size();
  }
  const bool keep = num_with > 0 && num_with >= num_without;
  for (map::MapViewData& view : data->views) {
    if (!keep) {
      view.descriptors.clear();
    } else if (lacks.contains(view.name)) {
      view.keypoints_px.clear();
      view.landmarks.clear();
      view.descriptors.clear();
    }
  }
  warnings->push_back(absl::StrCat(
      base::Abseil(source),
      keep ? ": left out the features of "
           : ": the map has no descriptors, so no camera can be found in it: "
             "there are none for ",
      lacking.size(),
      " of ",
      data->views.size(),
      " images (",
      SomeNames(lacking),
      keep ? "), for which there are no matching descriptors" : ")"));
  if (keep) DropUnobserved(data);
}

map::Descriptor RootSiftFromSift(std::span<const std::uint8_t, 128> sift) {
  int sum = 0;
  for (const std::uint8_t value : sift) sum += value;
  map::Descriptor root{};
  if (sum == 0) return root;
  for (std::size_t i = 0; i < root.size(); ++i) {
    const double value =
        std::round(512.0 * std::sqrt(static_cast<double>(sift[i]) / sum));
    root[i] = static_cast<std::uint8_t>(std::min(value, 255.0));
  }
  return root;
}

map::Descriptor SiftFromRootSift(const map::Descriptor& root) {
  std::array<double, 128> l1{};
  double squared_norm = 0.0;
  for (std::size_t i = 0; i < root.size(); ++i) {
    l1[i] = static_cast<double>(root[i]) * root[i];
    squared_norm += l1[i] * l1[i];
  }
  map::Descriptor sift{};
  if (squared_norm == 0.0) return sift;
  const double scale = 512.0 / std::sqrt(squared_norm);
  for (std::size_t i = 0; i < root.size(); ++i) {
    sift[i] =
        static_cast<std::uint8_t>(std::min(std::round(scale * l1[i]), 255.0));
  }
  return sift;
}

}  // namespace groundlock::formats::internal
