// SPDX-License-Identifier: Apache-2.0
#include "client/cli/evaluate/one_pass.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <numeric>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "map_store/base/file.h"
#include "map_store/base/status.h"

namespace groundlock::cli {
namespace {

namespace fs = std::filesystem;
using geometry::Box2;

// No picture is as large.
constexpr double kMost_px = 1e6;
// A long video's truth takes 30 bytes a frame.
constexpr std::uint64_t kMaxTextBytes = std::uint64_t{64} << 20;

absl::StatusOr<std::vector<Box2>> ReadBoxes(const fs::path& path) {
  ASSIGN_OR_RETURN(const std::string text, base::ReadFile(path, kMaxTextBytes));
  auto boxes = BoxesFromText(text);
  if (!boxes.ok()) return base::Annotate(boxes.status(), path.string());
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

absl::StatusOr<std::vector<Box2>> BoxesFromText(std::string_view text) {
  std::vector<Box2> boxes;
  bool seen = false;
  int number = 0;
  for (const absl::string_view line :
       absl::StrSplit(absl::string_view(text.data(), text.size()), '\n')) {
    ++number;
    const std::vector<absl::string_view> fields =
        absl::StrSplit(line, absl::ByAnyChar(", \t\r"), absl::SkipEmpty());
    if (fields.empty()) continue;
    std::array<double, 4> values{};
    bool valid = fields.size() == values.size();
    for (std::size_t i = 0; valid && i < values.size(); ++i) {
      valid = absl::SimpleAtod(fields[i], &values[i]) &&
              !(std::abs(values[i]) > kMost_px);  // NaN is one
    }
    if (!valid) {
      return absl::InvalidArgumentError(
          absl::StrCat("line ", number, ": expected x,y,w,h in pixels"));
    }
    const auto [x, y, w, h] = values;
    Box2 box = Box2::FromXywh(x - 1.0, y - 1.0, w, h);
    if (!box.IsFinite() || !(w > 0.0 && h > 0.0)) {
      box.min_px.setConstant(std::nan(""));
      box.max_px.setConstant(std::nan(""));
    }
    seen = seen || box.IsFinite();
    boxes.push_back(box);
  }
  if (!seen) return absl::InvalidArgumentError("the target is in no frame");
  return boxes;
}

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
    if (!truth_px[i].IsFinite() || !found_px[i].IsFinite()) continue;
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

OnePassPlots PlotScores(std::vector<LabelledScore> scores) {
  std::stable_sort(scores.begin(),
                   scores.end(),
                   [](const LabelledScore& a, const LabelledScore& b) {
                     return a.score.Auc() > b.score.Auc();
                   });
  OnePassPlots plots;
  LinePlot& success = plots.success;
  success.title = "Success";
  success.x_label = "overlap threshold";
  success.y_label = "share of frames";
  LinePlot& precision = plots.precision;
  precision.title = "Precision";
  precision.x_label = "centre error threshold, px";
  precision.y_label = "share of frames";
  precision.max = {kDistanceSteps, 1.0};
  precision.legend = LinePlot::Legend::kLeft;
  for (const auto& [label, score] : scores) {
    PlotLine& s = success.lines.emplace_back();
    s.label = absl::StrFormat("%s (%.3f)", label, score.Auc());
    for (int t = 0; t <= kOverlapSteps; ++t) {
      s.points.emplace_back(t / static_cast<double>(kOverlapSteps),
                            score.success[t]);
    }
    PlotLine& p = precision.lines.emplace_back();
    p.label = absl::StrFormat("%s (%.3f)", label, score.PrecisionAt20px());
    for (int t = 0; t <= kDistanceSteps; ++t) {
      p.points.emplace_back(t, score.precision[t]);
    }
  }
  return plots;
}

}  // namespace groundlock::cli
