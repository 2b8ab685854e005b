// SPDX-License-Identifier: Apache-2.0
// Movers of rendered sequences, the camera known: a car is found while it
// drives, and nothing else is.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include "client/cli/evaluate/truth_csv.h"
#include "server/ground/ground_surface.h"
#include "server/image/frame.h"
#include "server/movers/movers.h"
#include "tests/support/perturbation.h"
#include "tests/support/recorded_data.h"

namespace groundlock::movers {
namespace {

struct Score {
  int due = 0;    // frames in which most of the driving car is seen
  int found = 0;  // a mover's box holds the middle of what is seen of it
  int wrong = 0;  // movers elsewhere, in all frames
  int watched = 0;
  int first_found = -1;
  std::vector<double> place_error_m;
  std::vector<double> velocity_error;  // of the true speed
};

void Watch(const std::string& name, Score& score) {
  const auto sequence = test_support::FindSequence(name);
  if (!sequence.ok()) GTEST_SKIP() << "SKIPPED: " << sequence.status();
  const auto camera = test_support::ReadCamera(sequence->camera);
  ASSERT_TRUE(camera.ok()) << camera.status();
  const auto truth = cli::ReadTruth(sequence->truth);
  ASSERT_TRUE(truth.ok()) << truth.status();
  const auto frames = test_support::ReadFrames(sequence->video, 1);
  ASSERT_TRUE(frames.ok()) << frames.status();
  const auto ground = ground::MakePlaneSurface({}, {.height_sigma_m = 0.01});
  MoverFinder finder;
  for (std::size_t i = 0; i < truth->size(); ++i) {
    const cli::TruthRow& row = (*truth)[i];
    const image::Frame picture =
        image::Frame::FromBgr(frames->at(static_cast<int>(row.frame)));
    MoversFrame frame;
    frame.pyramid = picture.Pyramid();
    frame.time = row.time;
    frame.camera = &*camera;
    frame.world_from_camera = row.world_from_camera;
    frame.ground = ground.get();
    const MoversReport report = finder.Process(frame);
    score.watched += report.state == MoversState::kWatching ? 1 : 0;
    const cli::TruthRow& before = (*truth)[std::max<std::size_t>(i, 3) - 3];
    const cli::TruthRow& after = (*truth)[std::min(i + 3, truth->size() - 1)];
    const Eigen::Vector3d velocity =
        (*after.target_world - *before.target_world) /
        std::chrono::duration<double>(after.time - before.time).count();
    const bool due = velocity.norm() > 0.2 && row.seen_fraction > 0.7;
    score.due += due ? 1 : 0;
    bool found = false;
    for (const Mover& mover : report.movers) {
      geometry::Box2 car_px = row.visible_box_px.value_or(geometry::Box2());
      car_px = geometry::Box2::FromCenter(car_px.center_px(),
                                          1.5 * car_px.size_px());
      if (!car_px.Contains(mover.box_px.center_px())) {
        ++score.wrong;
        continue;
      }
      if (!due || found) continue;
      found = true;
      score.place_error_m.push_back(
          (mover.ground_world - *row.target_world).norm());
      score.velocity_error.push_back(
          (mover.velocity_world_m_s - velocity).norm() / velocity.norm());
    }
    score.found += found ? 1 : 0;
    if (found && score.first_found < 0) score.first_found = static_cast<int>(i);
  }
}

TEST(RenderedMovers, ACarThatPassesIsFoundWithinASecondAndNothingElseIs) {
  Score score;
  ASSERT_NO_FATAL_FAILURE(Watch("occlusion", score));
  if (score.watched == 0) return;
  std::printf("found in %d of %d frames, wrong ones %d in %d\n",
              score.found,
              score.due,
              score.wrong,
              score.watched);
  EXPECT_LE(score.first_found, 24);
  EXPECT_GT(score.found, 0.7 * score.due);
  // None or one, for four to six frames, as noise has it.
  EXPECT_LE(score.wrong, test_support::Bound(0.02, 0.05) * score.watched);
  // The car is 0.9 m long, and seen from 5 to 7 m.
  EXPECT_LT(test_support::Quantile(score.place_error_m, 0.5), 0.45);
  EXPECT_LT(test_support::Quantile(score.velocity_error, 0.5), 0.15);
}

TEST(RenderedMovers, NothingIsFoundWhereACarStandsAndTheCameraPans) {
  Score score;
  ASSERT_NO_FATAL_FAILURE(Watch("outofview", score));
  if (score.watched == 0) return;
  EXPECT_GT(score.watched, 100);
  EXPECT_EQ(score.due, 0);
  EXPECT_EQ(score.wrong, 0);
}

}  // namespace
}  // namespace groundlock::movers
