// SPDX-License-Identifier: Apache-2.0
#include "server/localization/search/one_surface.h"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <vector>

#include "server/localization/solvers/agreement.h"
#include "tests/support/perturbation.h"
#include "tests/support/synthetic_scene.h"

namespace groundlock::localization {
namespace {

// A wall 10 m away in the left half of the image and things at all depths in
// the right half, as a camera in the origin sees them that looks along z.
class OneSurfaceTest : public testing::Test {
 protected:
  struct Seen {
    std::vector<SeenPoint> agreeing;
    std::vector<SeenPoint> expected;
  };

  // Of so many places each, the first ones agree.
  Seen See(int wall, int of_wall, int beside, int of_beside) const {
    Seen seen;
    const auto add = [&](int found, int all, int first_column, bool on_wall) {
      for (int i = 0; i < all; ++i) {
        // A square of 32 px each, by columns of 20.
        const Eigen::Vector2d pixel_px(
            32.0 * (first_column + i / 20 % 20) + 16.0, 32.0 * (i % 20) + 16.0);
        const double depth =
            on_wall ? 10.0 : 3.0 + 12.0 * std::fmod(0.618 * i, 1.0);
        const auto normalized = camera_.NormalizedFromImage(pixel_px);
        const SeenPoint point{depth * normalized->homogeneous(), pixel_px};
        seen.expected.push_back(point);
        if (i < found) seen.agreeing.push_back(point);
      }
    };
    add(wall, of_wall, 0, true);
    add(beside, of_beside, 20, false);
    return seen;
  }
  double LogLikelier(
      const Seen& seen,
      const std::optional<Eigen::Vector3d>& up_world = std::nullopt) const {
    return LogLikelierBesideSurface(seen.agreeing,
                                    seen.expected,
                                    Eigen::Vector3d::Zero(),
                                    up_world,
                                    camera_,
                                    test_support::PerturbedSeed(3));
  }

  const geometry::CameraModel camera_ = test_support::MakeCamera();
};

TEST_F(OneSurfaceTest, ASceneIsFoundBesideTheWallAsWell) {
  ASSERT_EQ(camera_.width_px(), 1280);
  EXPECT_GT(LogLikelier(See(40, 100, 40, 100)), 5.0);
  // Half as often, and a third.
  EXPECT_GT(LogLikelier(See(40, 100, 20, 100)), 5.0);
  EXPECT_GT(LogLikelier(See(40, 100, 13, 100)), 1.0);
}

TEST_F(OneSurfaceTest, APictureOfTheWallIsFoundAlone) {
  EXPECT_LT(LogLikelier(See(40, 100, 0, 60)), -5.0);
  EXPECT_LT(LogLikelier(See(40, 100, 2, 200)), -5.0);
  // Something may hide all else: that is never told from a picture.
  EXPECT_NEAR(
      LogLikelier(See(40, 100, 0, 400)), std::log(kFalseAlarmsPerFrame), 1e-9);
}

TEST_F(OneSurfaceTest, WhereNothingElseMustBeInViewNothingIsSaid) {
  EXPECT_EQ(LogLikelier(See(40, 100, 0, 0)), 0.0);
  EXPECT_EQ(LogLikelier(See(0, 100, 0, 100)), 0.0);
  // Where the wall is hardly found itself, the rest need not be.
  EXPECT_EQ(LogLikelier(See(4, 200, 0, 200)), 0.0);
}

TEST_F(OneSurfaceTest, TheGroundHangsNowhereElse) {
  const Seen seen = See(40, 100, 0, 60);
  EXPECT_EQ(LogLikelier(seen, Eigen::Vector3d::UnitZ()), 0.0);
  EXPECT_EQ(LogLikelier(seen, -Eigen::Vector3d::UnitZ()), 0.0);
  EXPECT_LT(LogLikelier(seen, -Eigen::Vector3d::UnitY()), -5.0);
}

}  // namespace
}  // namespace groundlock::localization
