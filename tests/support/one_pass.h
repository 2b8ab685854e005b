// SPDX-License-Identifier: Apache-2.0
// One-pass evaluation of single-object tracking as the online tracking
// benchmark does it (OTB: Y. Wu, J. Lim, M.-H. Yang, CVPR 2013).
#ifndef GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_H_
#define GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_H_

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "map_store/geometry/box.h"

namespace groundlock::test_support {

struct OnePassSequence {
  std::string name;
  std::vector<std::filesystem::path> images;  // in the order of their names
  std::vector<geometry::Box2> truth_px;       // of the first frames or all
};

// Reads FOLDER/<name>/groundtruth.txt (x,y,w,h per frame, pixels counted from
// 1) and FOLDER/<name>/img/* of every sequence; img may be a text file with the
// images' folder, which is how a symbolic link is checked out where there are
// none. Sorted by name. Errors name the file and the line.
absl::StatusOr<std::vector<OnePassSequence>> ReadOnePassSequences(
    const std::filesystem::path& folder);

inline constexpr int kOverlapSteps = 20;   // thresholds 0, 0.05, ... 1
inline constexpr int kDistanceSteps = 50;  // thresholds 0, 1, ... 50 px

// Shares of frames, of one sequence or the mean over several.
struct OnePassScore {
  std::array<double, kOverlapSteps + 1> success{};     // overlap above it
  std::array<double, kDistanceSteps + 1> precision{};  // centre within it
  double Auc() const;  // mean success over the thresholds
  double PrecisionAt20px() const { return precision[20]; }
};

// Compares frame by frame, as far as both go.
OnePassScore Rate(const std::vector<geometry::Box2>& found_px,
                  const std::vector<geometry::Box2>& truth_px);
OnePassScore Mean(const std::vector<OnePassScore>& scores);

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_ONE_PASS_H_
