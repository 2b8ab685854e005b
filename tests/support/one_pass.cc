// SPDX-License-Identifier: Apache-2.0
#include "tests/support/one_pass.h"

#include <algorithm>
#include <fstream>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

#include "absl/strings/numbers.h"
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
    std::array<double, 4> values;
    for (double& value : values) {
      std::string field;
      if (!(fields >> field) || !absl::SimpleAtod(field, &value)) {
        return absl::InvalidArgumentError(
            absl::StrCat(path.string(), ":", number, ": expected x,y,w,h"));
      }
    }
    const auto [x, y, w, h] = values;
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

// All flights in one video.
absl::Status ReadFlights(const fs::path& video,
                         std::vector<OnePassSequence>& sequences) {
  const fs::path stem = fs::path(video).replace_extension();
  const auto read = [&](const fs::path& truth, int first_frame) {
    OnePassSequence sequence;
    sequence.name = truth.stem().string();
    sequence.video = video;
    sequence.first_frame = first_frame;
    auto boxes = ReadBoxes(truth);
    if (!boxes.ok()) return boxes.status();
    sequence.truth_px = *std::move(boxes);
    sequences.push_back(std::move(sequence));
    return absl::OkStatus();
  };
  const fs::path whole = stem.string() + ".txt";
  if (fs::exists(whole)) return read(whole, 0);
  int first_frame = 0;
  for (int part = 1;; ++part) {
    const fs::path truth = absl::StrCat(stem.string(), "_", part, ".txt");
    if (!fs::exists(truth)) return absl::OkStatus();
    RETURN_IF_ERROR(read(truth, first_frame));
    first_frame += static_cast<int>(sequences.back().truth_px.size()) - 1;
  }
}

}  // namespace

absl::StatusOr<std::vector<OnePassSequence>> ReadOnePassSequences(
    const fs::path& folder) {
  std::vector<OnePassSequence> sequences;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    if (entry.path().extension() == ".mp4") {
      RETURN_IF_ERROR(ReadFlights(entry.path(), sequences));
    }
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

absl::StatusOr<OnePassReader> OnePassReader::Open(
    const OnePassSequence& sequence) {
  OnePassReader reader;
  reader.sequence_ = &sequence;
  reader.frames_ = sequence.images.size();
  reader.frames_per_second_ = sequence.frames_per_second;
  if (sequence.video.empty()) return reader;
  if (!reader.video_.open(sequence.video.string())) {
    return absl::NotFoundError(
        absl::StrCat(sequence.video.string(), ": cannot read it"));
  }
  reader.frames_ = sequence.truth_px.size();
  const double frames_per_second = reader.video_.get(cv::CAP_PROP_FPS);
  if (frames_per_second > 0.0) reader.frames_per_second_ = frames_per_second;
  // One by one: seeking ends at key frames.
  for (int i = 0; i < sequence.first_frame; ++i) reader.video_.grab();
  return reader;
}

absl::StatusOr<cv::Mat> OnePassReader::Next() {
  cv::Mat image;
  if (sequence_->video.empty()) {
    image = cv::imread(sequence_->images.at(next_).string(), cv::IMREAD_COLOR);
  } else {
    video_.read(image);
  }
  if (image.empty()) {
    return absl::DataLossError(
        absl::StrCat(sequence_->name, ": frame ", next_, " cannot be read"));
  }
  ++next_;
  return image;
}

double OnePassScore::Auc() const {
  return std::accumulate(success.begin(), success.end(), 0.0) /
         static_cast<double>(success.size());
}

OnePassScore Rate(const std::vector<Box2>& found_px,
                  const std::vector<Box2>& truth_px) {
  OnePassScore score;
  const std::size_t frames = std::min(found_px.size(), truth_px.size());
  const auto rated =
      std::count_if(truth_px.begin(),
                    truth_px.begin() + static_cast<std::ptrdiff_t>(frames),
                    [](const Box2& box_px) { return box_px.IsFinite(); });
  const double share = 1.0 / static_cast<double>(std::max<long>(1, rated));
  for (std::size_t i = 0; i < frames; ++i) {
    if (!truth_px[i].IsFinite()) continue;
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
