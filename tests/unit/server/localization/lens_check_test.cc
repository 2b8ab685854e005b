// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/lens_check.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <vector>

#include "server/localization/search/anchor_job.h"
#include "tests/unit/server/localization/walk_test.h"

namespace groundlock::localization {
namespace {

using geometry::CameraModel;
using geometry::CameraModelId;

class LensCheckTest : public WalkTest {
 protected:
  static CameraModel Lens(double focal_ratio, double k) {
    const CameraModel& place = place_->camera();
    const double params[] = {focal_ratio * place.mean_focal_px(),
                             place.principal_point_px().x(),
                             place.principal_point_px().y(),
                             k};
    return *CameraModel::Create(CameraModelId::kSimpleRadial,
                                place.width_px(),
                                place.height_px(),
                                params);
  }
  // The landmarks as `lens` shows them, half a pixel off; every fourth is
  // somebody else's feature nearby.
  std::vector<LandmarkMatch> See(const CameraModel& lens) const {
    std::mt19937_64 engine(3);
    std::normal_distribution<double> noise_px(0.0, 0.5);
    std::uniform_real_distribution<double> elsewhere_px(-40.0, 40.0);
    std::vector<LandmarkMatch> matches;
    for (std::uint32_t i = 0; i < map_->landmarks().size(); ++i) {
      const auto pixel = lens.ImageFromCamera(truth_.Inverse() *
                                              map_->landmarks()[i].Position());
      if (!pixel || !lens.IsInsideImage(*pixel)) continue;
      const bool is_wrong = i % 4 == 0;
      const auto error_px = [&] {
        return is_wrong ? elsewhere_px(engine) : noise_px(engine);
      };
      const double dx_px = error_px();
      matches.push_back({i, *pixel + Eigen::Vector2d(dx_px, error_px())});
    }
    return matches;
  }
};

LensMeasurement Focal(double log_focal, double sigma = 0.01) {
  return {log_focal, sigma, 0.0, 0.001};
}

TEST_F(LensCheckTest, MeasuresTheFocalLength) {
  for (const double ratio : {0.6, 0.75, 0.9, 1.0, 1.1, 1.3, 1.6}) {
    const auto measured =
        MeasureLens(*map_, Lens(1.0, 0.0), See(Lens(ratio, 0.0)), truth_);
    ASSERT_TRUE(measured) << ratio;
    EXPECT_NEAR(measured->log_focal, std::log(ratio), 0.01) << ratio;
    EXPECT_LT(measured->log_focal_sigma, 0.01) << ratio;
    EXPECT_LT(std::abs(measured->corner), 0.002 + 4.0 * measured->corner_sigma)
        << ratio;
  }
}

TEST_F(LensCheckTest, MeasuresTheDistortion) {
  const CameraModel& place = place_->camera();
  const double corner =
      (place.principal_point_px() / place.mean_focal_px()).squaredNorm();
  for (const double share : {-0.06, 0.06}) {
    const auto measured = MeasureLens(
        *map_, Lens(1.0, 0.0), See(Lens(1.0, share / corner)), truth_);
    ASSERT_TRUE(measured) << share;
    EXPECT_NEAR(measured->corner, share, 0.01) << share;
    EXPECT_NEAR(measured->log_focal, 0.0, 0.01) << share;
  }
}

TEST_F(LensCheckTest, FewOrRandomMatchesSayNothing) {
  std::vector<LandmarkMatch> matches = See(Lens(1.0, 0.0));
  std::mt19937_64 engine(7);
  std::uniform_real_distribution<double> elsewhere_px(-48.0, 48.0);
  std::vector<LandmarkMatch> random = matches;
  for (LandmarkMatch& match : random) {
    match.pixel_px.x() += elsewhere_px(engine);
    match.pixel_px.y() += elsewhere_px(engine);
  }
  EXPECT_FALSE(MeasureLens(*map_, Lens(1.0, 0.0), random, truth_));
  matches.resize(30);
  EXPECT_FALSE(MeasureLens(*map_, Lens(1.0, 0.0), matches, truth_));
  EXPECT_FALSE(MeasureLens(*map_, Lens(1.0, 0.0), {}, truth_));
}

TEST_F(LensCheckTest, SaysSoOnceFramesAgree) {
  LensCheck check;
  for (int i = 0; i < 2; ++i) {
    check.Add(Focal(0.2));
    EXPECT_FALSE(check.contradiction()) << i;
  }
  check.Add(Focal(0.22));
  ASSERT_TRUE(check.contradiction());
  EXPECT_NEAR(std::log(check.contradiction()->focal_ratio), 0.2, 1e-9);
  EXPECT_EQ(check.contradiction()->corner_share, 0.0);
  // One that says the opposite takes it back, until enough others came.
  check.Add(Focal(0.0));
  EXPECT_FALSE(check.contradiction());
  for (int i = 0; i < 2; ++i) check.Add(Focal(0.2));
  EXPECT_TRUE(check.contradiction());
}

TEST_F(LensCheckTest, UnsureOrSmallDifferencesSayNothing) {
  LensCheck check;
  for (int i = 0; i < 8; ++i) {
    check.Add(Focal(0.3, /*sigma=*/0.1));
    check.Add(Focal(0.035, /*sigma=*/0.001));
  }
  EXPECT_FALSE(check.contradiction());
  while (check.WantsMore()) check.Add(Focal(0.0));
  for (int i = 0; i < 100; ++i) check.Add(Focal(0.3));
  EXPECT_FALSE(check.contradiction());
}

TEST_F(LensCheckTest, NamesOtherFocalLengthsUntilItIsKnown) {
  LensCheck check;
  std::set<double> probes;
  int named = 0;
  for (; const auto probe = check.NextProbe(); ++named) {
    ASSERT_LT(named, 20);
    probes.insert(*probe);
    EXPECT_NE(*probe, 1.0);
  }
  EXPECT_EQ(*probes.begin(), 0.5);
  EXPECT_EQ(*probes.rbegin(), 2.0);
  EXPECT_FALSE(check.NextProbe());
}

TEST_F(LensCheckTest, ProbesWhatAFrameHasShown) {
  LensCheck check;
  EXPECT_TRUE(check.NextProbe());
  check.Add(Focal(0.3));
  EXPECT_NEAR(check.NextProbe().value_or(0.0), std::exp(0.3), 1e-9);
  for (int i = 0; i < 2; ++i) check.Add(Focal(0.3));
  EXPECT_FALSE(check.NextProbe());
  LensCheck right;
  for (int i = 0; i < 3; ++i) right.Add(Focal(0.0));
  EXPECT_FALSE(right.NextProbe());
}

class WrongLensTest : public LensCheckTest {
 protected:
  // Of a session that takes the focal length for so many times the true one.
  static LocalizationResult Walk(double focal_ratio, int frames) {
    const auto localizer = Create();
    LocalizationResult result;
    for (int i = 0; i < frames; ++i) {
      image::Frame frame;
      frame.sequence = static_cast<std::uint64_t>(i);
      frame.capture_time = i * kFrame;
      frame.luma = ImageAt(i);
      auto localized =
          localizer->Localize({&frame, Lens(focal_ratio, 0.0), {}});
      EXPECT_TRUE(localized.ok()) << localized.status();
      if (!localized.ok()) return result;
      result = *std::move(localized);
    }
    return result;
  }
};

TEST_F(WrongLensTest, IsToldWhereTheCameraIsFound) {
  for (const double ratio : {0.6, 0.85, 1.2, 1.6}) {
    const LocalizationResult result = Walk(ratio, 72);
    ASSERT_TRUE(result.lens_contradiction) << ratio;
    EXPECT_NEAR(ratio * result.lens_contradiction->focal_ratio, 1.0, 0.01)
        << ratio;
  }
}

TEST_F(WrongLensTest, IsFoundByAProbeWhereTheCameraIsNot) {
  AnchorTask task;
  task.request.luma = ImageAt(0);
  task.request.camera = Lens(1.0, 0.0);
  // A wrong lens explains one of the place's panels. Of each there is no more
  // to see than too little for a pose to be believed: 16 squares of 16 px.
  constexpr int kSide_px = 16;
  std::map<std::size_t, int> squares;
  for (int y = 0; y < task.request.luma.rows; y += kSide_px) {
    for (int x = 0; x < task.request.luma.cols; x += kSide_px) {
      const auto hit = place_->Intersect(
          TruthAt(0), {x + 0.5 * kSide_px, y + 0.5 * kSide_px});
      if (hit && ++squares[hit->panel] <= 16) continue;
      task.request.masks_px.push_back(
          geometry::Box2::FromXywh(x, y, kSide_px, kSide_px));
    }
  }
  task.options.max_features = 1'000;
  const auto right = SeekAnchor(*map_, task);
  ASSERT_TRUE(right.found);
  EXPECT_FALSE(right.lens);  // nobody wanted to know
  task.request.camera = Lens(1.5, 0.0);
  task.request.wants_lens_matches = true;
  const SoughtAnchor alone = SeekAnchor(*map_, task);
  EXPECT_FALSE(alone.found);
  EXPECT_FALSE(alone.lens);
  task.probe_focal_ratio = 1.0 / 1.5;
  const SoughtAnchor probed = SeekAnchor(*map_, task);
  EXPECT_FALSE(probed.found);
  ASSERT_TRUE(probed.lens);
  EXPECT_NEAR(probed.lens->log_focal, std::log(1.0 / 1.5), 0.01);
}

TEST_F(WrongLensTest, NothingIsSaidOfTheRightOne) {
  EXPECT_FALSE(Walk(1.0, 72).lens_contradiction);
}

}  // namespace
}  // namespace groundlock::localization
