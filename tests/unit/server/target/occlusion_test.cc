// SPDX-License-Identifier: Apache-2.0
// Our trackers' confidence on a rendered drive with truth: high while the
// target is seen, low while it is hidden behind an obstacle, high again
// afterwards.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/videoio.hpp>
#include <random>
#include <sstream>
#include <string>
#include <tuple>
#include <vector>

#include "server/target/target_tracker.h"
#include "tests/support/perturbation.h"

namespace groundlock::target {
namespace {

namespace fs = std::filesystem;
using geometry::Box2;

using Row = std::map<std::string, double>;

// Numeric columns by name; an empty field is NaN.
std::vector<Row> ReadCsv(const fs::path& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  std::vector<std::string> names;
  std::istringstream header(line);
  for (std::string field; std::getline(header, field, ',');) {
    names.push_back(field);
  }
  std::vector<Row> rows;
  while (std::getline(file, line)) {
    std::istringstream fields(line);
    Row row;
    for (const std::string& name : names) {
      std::string field;
      std::getline(fields, field, ',');
      row[name] = field.empty() ? std::nan("") : std::stod(field);
    }
    rows.push_back(std::move(row));
  }
  return rows;
}

struct Shares {
  int seen = 0, seen_confident = 0;
  int hidden = 0, hidden_unsure = 0;
};

// Placed on the true box with 5 % jitter of its size, as a motion model would;
// learns when confident, as a session does.
Shares Measure(const std::string& name,
               const fs::path& video,
               const std::vector<Row>& truth) {
  cv::VideoCapture capture(video.string());
  auto created = CreateTargetTracker({name, ""});
  if (!created.ok()) {
    ADD_FAILURE() << created.status();
    return {};
  }
  TargetTracker& tracker = **created;
  std::mt19937 generator(
      static_cast<std::uint32_t>(test_support::PerturbedSeed(1)));
  std::normal_distribution<double> jitter(0.0, 0.05);
  Shares shares;
  bool started = false;
  cv::Mat image;
  for (const Row& row : truth) {
    if (!capture.read(image)) break;
    image = test_support::Perturbed(image);
    Box2 box = Box2::FromXywh(
        row.at("box_x"), row.at("box_y"), row.at("box_w"), row.at("box_h"));
    if (!box.IsFinite()) continue;
    if (!started) {
      started = tracker.Initialize(image, box).ok();
      continue;
    }
    const Eigen::Vector2d shift = box.size_px().cwiseProduct(
        Eigen::Vector2d{jitter(generator), jitter(generator)});
    tracker.Place({box.min_px + shift, box.max_px + shift});
    const auto seen = tracker.Detect(image, /*fixed_size=*/true);
    if (!seen.ok()) {
      ADD_FAILURE() << seen.status();
      break;
    }
    const bool confident = seen->confidence >= 0.5;
    if (confident) tracker.Learn(image);
    if (row.at("seen_fraction") > 0.7) {
      ++shares.seen;
      shares.seen_confident += confident ? 1 : 0;
    } else if (row.at("seen_fraction") == 0.0) {
      ++shares.hidden;
      shares.hidden_unsure += confident ? 0 : 1;
    }
  }
  return shares;
}

struct Drive {
  const char* name;
  // At least as many frames with the car mostly seen, or not at all.
  int seen, hidden;
};

class Occlusion
    : public ::testing::TestWithParam<std::tuple<const char*, Drive>> {};

TEST_P(Occlusion, ConfidenceTellsSeenFromHidden) {
  const auto& [tracker, drive] = GetParam();
  const char* data = std::getenv("GROUNDLOCK_DATA");
  const fs::path stem = fs::path(data != nullptr ? data : "../shared/data") /
                        "sim/lot" / drive.name;
  const fs::path video = stem.string() + ".mp4";
  if (!fs::exists(video)) {
    GTEST_SKIP() << video << " is not there; set GROUNDLOCK_DATA";
  }
  const Shares shares =
      Measure(tracker, video, ReadCsv(stem.string() + "_truth.csv"));
  std::printf("confident in %d of %d seen, unsure in %d of %d hidden frames\n",
              shares.seen_confident,
              shares.seen,
              shares.hidden_unsure,
              shares.hidden);
  ASSERT_GE(shares.seen, drive.seen);
  ASSERT_GE(shares.hidden, drive.hidden);
  // 0.98 and 0.95 in nine draws of noise out of ten; in one it learns a wrong
  // frame.
  EXPECT_GE(shares.seen_confident,
            test_support::Bound(0.98, 0.9) * shares.seen);
  EXPECT_GE(shares.hidden_unsure,
            test_support::Bound(0.95, 0.8) * shares.hidden);
}

INSTANTIATE_TEST_SUITE_P(
    Lot,
    Occlusion,
    ::testing::Combine(::testing::Values("act", "dcf"),
                       ::testing::Values(Drive{"occlusion", 80, 40},
                                         Drive{"outofview", 40, 20},
                                         Drive{"srun", 80, 0},
                                         Drive{"scale", 100, 0})),
    [](const auto& instance) {
      return std::string(std::get<0>(instance.param)) + "_" +
             std::get<1>(instance.param).name;
    });

}  // namespace
}  // namespace groundlock::target
