// SPDX-License-Identifier: Apache-2.0
#include "map_store/build/internal/sub_models.h"

#include <algorithm>
#include <system_error>
#include <tuple>
#include <unordered_map>
#include <unordered_set>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"
#include "map_store/build/internal/names_list.h"
#include "map_store/formats/formats.h"

namespace groundlock::build::internal {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxSubModels = 1'000;

}  // namespace

absl::StatusOr<std::vector<SubModel>> ReadSubModels(const fs::path& folder) {
  std::vector<SubModel> models;
  for (int i = 0; i < kMaxSubModels; ++i) {
    const fs::path path = folder / absl::StrCat(i);
    std::error_code error;
    if (!fs::is_directory(path, error)) break;
    std::vector<std::string> warnings;
    const auto data = formats::Import(path, {}, &warnings);
    if (!data.ok()) continue;  // an empty model
    SubModel model{path, {}, data->landmarks.size()};
    for (const map::MapViewData& view : data->views) {
      model.images.push_back(view.name);
    }
    models.push_back(std::move(model));
  }
  return models;
}

std::size_t ChooseSubModel(std::span<const SubModel> models) {
  std::size_t best = 0;
  for (std::size_t i = 1; i < models.size(); ++i) {
    const auto size_of = [&](std::size_t index) {
      return std::make_tuple(models[index].images.size(),
                             models[index].num_landmarks);
    };
    if (size_of(i) > size_of(best)) best = i;
  }
  return best;
}

std::vector<std::string> DescribeGaps(std::span<const std::string> images,
                                      std::span<const SubModel> models,
                                      std::size_t chosen) {
  const std::unordered_set<std::string> in_map(models[chosen].images.begin(),
                                               models[chosen].images.end());
  // The other model that an image belongs to, or none.
  constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  std::unordered_map<std::string, std::size_t> others;
  for (std::size_t m = 0; m < models.size(); ++m) {
    if (m == chosen) continue;
    for (const std::string& name : models[m].images) others.emplace(name, m);
  }
  const auto place_of = [&](const std::string& name) {
    if (in_map.count(name) > 0) return chosen;
    const auto it = others.find(name);
    return it == others.end() ? kNone : it->second;
  };
  std::vector<std::string> apart;
  std::vector<std::string> missing;
  std::size_t num_apart = 0;
  std::size_t num_missing = 0;
  for (std::size_t begin = 0; begin < images.size();) {
    const std::size_t place = place_of(images[begin]);
    std::size_t end = begin + 1;
    while (end < images.size() && place_of(images[end]) == place) ++end;
    const std::string stretch =
        end - begin == 1 ? images[begin]
                         : absl::StrCat(images[begin], " to ", images[end - 1]);
    if (place == kNone) {
      missing.push_back(stretch);
      num_missing += end - begin;
    } else if (place != chosen) {
      apart.push_back(stretch);
      num_apart += end - begin;
    }
    begin = end;
  }
  std::vector<std::string> gaps;
  if (num_apart > 0) {
    gaps.push_back(absl::StrCat(
        "the walk fell apart: ",
        num_apart,
        " images (",
        NamesList(apart),
        ") hang together among themselves but not with the map; film the way "
        "between them and the rest again, more slowly"));
  }
  if (num_missing > 0) {
    gaps.push_back(absl::StrCat(
        num_missing,
        " images found no place in the map (",
        NamesList(missing),
        "): there was too little texture or overlap, or they are blurred"));
  }
  return gaps;
}

}  // namespace groundlock::build::internal
