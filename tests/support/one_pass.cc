// SPDX-License-Identifier: Apache-2.0
#include "tests/support/one_pass.h"

#include <algorithm>
#include <fstream>
#include <numeric>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "map_store/base/status.h"

namespace groundlock::test_support {
namespace {

namespace fs = std::filesystem;
using geometry::Box2;

absl::StatusOr<std::vector<Box2>> ReadBoxes(const fs::path& path) {
  std::ifstream file(path);
  std::vector<Box2> boxes;
  int number = 0;
  for (std::string line; std::getline(file, line);) {
    ++number;
    std::replace_if(
        line.begin(),
        line.end(),
        [](char c) { return c == ',' || c == '\t'; },
        ' ');
    if (line.find_first_not_of(" \r") == std::string::npos) continue;
    std::istringstream fields(line);
    double x, y, w, h;
    if (!(fields >> x >> y >> w >> h)) {
      return absl::InvalidArgumentError(
          absl::StrCat(path.string(), ":", number, ": expected x,y,w,h"));
    }
    boxes.push_back(Box2::FromXywh(x - 1.0, y - 1.0, w, h));
  }
  if (boxes.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path.string(), ": no boxes"));
  }
  return boxes;
}

absl::StatusOr<OnePassSequence> ReadSequence(const fs::path& folder) {
  OnePassSequence sequence;
  sequence.name = folder.filename().string();
  ASSIGN_OR_RETURN(sequence.truth_px, ReadBoxes(folder / "groundtruth.txt"));
  fs::path images = folder / "img";
  if (fs::is_regular_file(images)) {
    std::string target;
    std::getline(std::ifstream(images), target);
    images = folder / target;
  }
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(images, error)) {
    sequence.images.push_back(entry.path());
  }
  if (sequence.images.empty()) {
    return absl::NotFoundError(
        absl::StrCat(images.string(), ": no images ", error.message()));
  }
  std::sort(sequence.images.begin(), sequence.images.end());
  return sequence;
}

}  // namespace

absl::StatusOr<std::vector<OnePassSequence>> ReadOnePassSequences(
    const fs::path& folder) {
  std::vector<OnePassSequence> sequences;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    if (!fs::exists(entry.path() / "groundtruth.txt")) continue;
    ASSIGN_OR_RETURN(OnePassSequence sequence, ReadSequence(entry.path()));
    sequences.push_back(std::move(sequence));
  }
  if (sequences.empty()) {
    return absl::NotFoundError(
        absl::StrCat(folder.string(), ": no sequences ", error.message()));
  }
  std::sort(sequences.begin(),
            sequences.end(),
            [](const auto& a, const auto& b) { return a.name < b.name; });
  return sequences;
}

double OnePassScore::Auc() const {
  return std::accumulate(success.begin(), success.end(), 0.0) /
         static_cast<double>(success.size());
}

OnePassScore Rate(const std::vector<Box2>& found_px,
                  const std::vector<Box2>& truth_px) {
  OnePassScore score;
  const std::size_t frames = std::min(found_px.size(), truth_px.size());
  if (frames == 0) return score;
  const double share = 1.0 / static_cast<double>(frames);
  for (std::size_t i = 0; i < frames; ++i) {
    const double overlap =
        geometry::IntersectionOverUnion(found_px[i], truth_px[i]);
    for (int t = 0; t <= kOverlapSteps; ++t) {
      if (overlap > t / static_cast<double>(kOverlapSteps)) {
        score.success[t] += share;
      }
    }
    const double error_px =
        (found_px[i].center_px() - truth_px[i].center_px()).norm();
    for (int t = 0; t <= kDistanceSteps; ++t) {
      if (error_px <= t) score.precision[t] += share;
    }
  }
  return score;
}

OnePassScore Mean(const std::vector<OnePassScore>& scores) {
  OnePassScore mean;
  for (const OnePassScore& score : scores) {
    for (std::size_t t = 0; t < mean.success.size(); ++t) {
      mean.success[t] += score.success[t] / static_cast<double>(scores.size());
    }
    for (std::size_t t = 0; t < mean.precision.size(); ++t) {
      mean.precision[t] +=
          score.precision[t] / static_cast<double>(scores.size());
    }
  }
  return mean;
}

}  // namespace groundlock::test_support
